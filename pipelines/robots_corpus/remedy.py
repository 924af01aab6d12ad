"""Follows the remedy that a refusal prints: its options on the next command line, or its edit on a copy of the model.

A remedy is followed to the letter. Options are read by the rules of a shell; of alternatives that ``or`` joins, the first one
counts. An edit is done by the function whose wording the message has; options beside it are added where the message says so.
What neither has is not followed.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError, fromstring, parse, tostring

from robots_corpus.mirror import Mirror

#: Options of ``sysid init`` that a remedy may name.
OPTIONS = ("kind", "base", "tip", "tool", "assets")
_OPTION = re.compile(rf"--({'|'.join(OPTIONS)})(?=[\s=])")
#: Words in capitals stand for a value that the message does not give.
_PLACEHOLDER = re.compile(r"DIR|FILE|NAME|FOLDER")
#: Options beside an edit.
_BESIDE = re.compile(r"\b(?:and|then) (?:add|use) --", re.IGNORECASE)
_ONE = r"(?:'[^']*'|\"[^\"]*\"|[\w.:/+-]+)"
_LISTED = rf"{_ONE}(?:(?:,| and|, and) {_ONE})*"


def remedy_of(message: str) -> str:
    """The part of a refusal behind what was expected; the whole message where it states none."""
    head, mark, tail = message.partition("; expected ")
    return tail if mark else head


def options_of(message: str) -> tuple[str, ...]:
    """Options with their values in the first sentence of a remedy that names any: ``("--tip", "hand")``."""
    for sentence in _sentences(remedy_of(message)):
        first = re.split(r"\bor\b(?=[^'\"]*--)", sentence)
        for part in first:
            found: dict[str, str] = {}
            for match in _OPTION.finditer(part):
                value = _value(part[match.end() :])
                if value is not None and not _PLACEHOLDER.fullmatch(value):
                    found.setdefault(f"--{match[1]}", value)
            if found:
                return tuple(word for pair in found.items() for word in pair)
    return ()


def _sentences(text: str) -> list[str]:
    """Parts that end with a full stop before a space or the end."""
    return [part for part in re.split(r"(?<=\.)\s+", text) if part]


def _value(text: str) -> str | None:
    """The word at the start of ``text``, read as a shell reads it; None without one."""
    lexer = shlex.shlex(text, posix=True)
    lexer.whitespace_split, lexer.commenters = True, ""
    try:
        word = next(lexer, None)
    except ValueError:  # an apostrophe of the sentence behind the word
        word = (text.split() or [None])[0]  # type: ignore[list-item]
    word = None if word is None else word.rstrip(".,;:)")
    return word or None


def follow(message: str, robot_file: str, mirror: Mirror) -> tuple[tuple[str, ...], str]:
    """Do what a message asks for.

    Returns:
        Options for the next command line, and a sentence on the edit that was made in the mirror; both empty for nothing.
    """
    edit, options = edit_of(message, robot_file, mirror), options_of(message)
    return options if not edit or _BESIDE.search(message) else (), edit


def edit_of(message: str, robot_file: str, mirror: Mirror) -> str:
    """Do the edit that a message asks for; returns a sentence on it; nothing where no wording is known or nothing changed."""
    for wording, edit in EDITS:
        match = re.search(wording, message)
        if match is None:
            continue
        for file in _parts(robot_file, mirror):
            path = mirror.editable(file)
            before = path.read_text("utf-8")
            after = edit(before, match)
            if after != before:
                path.write_text(after, "utf-8")
                words = re.search(r"\b(?:Remove|Change|Swap|Write|Add)\b.*", match[0])
                return f"{(words or match)[0]} ({Path(file).name})"
    return ""


def _parts(file: str, mirror: Mirror) -> list[str]:
    """The model file and the files that it includes."""
    found = [file]
    for each in found:
        try:
            root = parse(_present(each, mirror)).getroot()
        except (ParseError, OSError):
            continue
        for include in root.iter("include"):
            beside = [(Path(base).parent / include.get("file", "")).as_posix() for base in (each, file)]
            present = (_normal(path) for path in beside if (mirror.root / path).is_file())
            found += [path for path in present if path not in found][:1]
    return found


def _normal(path: str) -> str:
    """``a/../b`` → ``b``."""
    parts: list[str] = []
    for part in Path(path).parts:
        if part == ".." and parts:
            parts.pop()
        else:
            parts.append(part)
    return "/".join(parts)


def _present(file: str, mirror: Mirror) -> Path:
    return mirror.copy / file if (mirror.copy / file).exists() else mirror.root / file


Edit = Callable[[str, re.Match[str]], str]


def _tree_edit(change: Callable[[Element, re.Match[str]], bool]) -> Edit:
    """An edit of the elements of a file; ``change`` returns whether it did anything."""

    def edit(text: str, match: re.Match[str]) -> str:
        try:
            root = fromstring(text)
        except ParseError:
            return text
        return tostring(root, encoding="unicode") + "\n" if change(root, match) else text

    return edit


def names_in(text: str) -> list[str]:
    """``b``, ``b and c``, ``'b', 'c' and 'd'`` → the names."""
    found = re.split(r",\s*(?:and\s+)?|\s+and\s+", text.strip().rstrip("."))
    return [name.strip().strip("'\"") for name in found if name.strip()]


def _remove_actuators(root: Element, match: re.Match[str]) -> bool:
    unwanted, changed, number = {*names_in(match["names"])}, False, 0
    for group in root.findall("actuator"):
        for element in list(group):
            if (element.get("name") or f"actuator_{number}") in unwanted:
                group.remove(element)
                changed = True
            number += 1
    return changed


def _remove_free_joint(root: Element, match: re.Match[str]) -> bool:
    changed = False
    for body in root.iter("body"):
        for joint in [*body.findall("freejoint"), *body.findall("joint")]:
            free = joint.tag == "freejoint" or joint.get("type") == "free"
            if free and match["body"] in (body.get("name"), joint.get("name")):
                body.remove(joint)
                changed = True
    if changed:
        for key in root.iter("key"):
            for values, count in (("qpos", 7), ("qvel", 6)):
                if key.get(values):
                    key.set(values, " ".join(str(key.get(values)).split()[count:]))
    return changed


def _change_type(root: Element, match: re.Match[str]) -> bool:
    joints = [j for j in root.findall("joint") if j.get("name") in names_in(match["joints"]) and j.get("type") != match["type"]]
    for joint in joints:
        joint.set("type", match["type"])
    return bool(joints)


def _swap_limits(root: Element, match: re.Match[str]) -> bool:
    limit = next((j.find("limit") for j in root.findall("joint") if j.get("name") == match["joint"]), None)
    if limit is None:
        return False
    limit.attrib |= {"lower": limit.get("upper", "0"), "upper": limit.get("lower", "0")}
    return True


def _element(xml: str) -> Element:
    """``<tag key="value">``, closed or not."""
    return fromstring(xml if xml.endswith("/>") else f"{xml[:-1]}/>")


def _add_element(root: Element, match: re.Match[str]) -> bool:
    group = root if not match["parent"] else root.find(match["parent"])
    if group is None:
        return False
    group.append(_element(match["xml"]))
    return True


def _write_element(root: Element, match: re.Match[str]) -> bool:
    """Attributes of all elements of that tag; a child of the root where there is none."""
    wanted = _element(match["xml"])
    found = list(root.iter(wanted.tag))
    for element in found:
        element.attrib |= wanted.attrib
    if not found and root.tag in ("mujoco", "robot"):
        root.append(wanted)
    return True


def _remove_elements(root: Element, match: re.Match[str]) -> bool:
    """The attributes that are given, of elements of that tag: ``<flag gravity="disable">``; elements without any left go."""
    wanted, changed = _element(match["xml"]), False
    for parent in [root, *root.iter()]:
        for child in list(parent):
            if child.tag == wanted.tag and all(child.get(key) == value for key, value in wanted.items()):
                for key in wanted.attrib:
                    del child.attrib[key]
                if not child.attrib and not len(child):
                    parent.remove(child)
                changed = True
    return changed


def _remove_attribute(root: Element, match: re.Match[str]) -> bool:
    changed = False
    for element in root.iter():
        if match["key"] in element.attrib and element.tag in ("body", "geom", "joint"):
            del element.attrib[match["key"]]
            changed = True
    return changed


def _write_attribute(text: str, match: re.Match[str]) -> str:
    """``key='found' … Write key="value"``: the same text in the file."""
    new = f'{match["key"]}="{match["value"]}"'
    return re.sub(rf"""{match["key"]}\s*=\s*["']{re.escape(match["found"])}["']""", lambda _: new, text)


def _without_commas(text: str, match: re.Match[str]) -> str:
    """No commas in attributes that hold numbers only."""
    number = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
    return re.sub(rf'="\s*{number}(?:[\s,]+{number})+\s*"', lambda found: found[0].replace(",", " "), text)


_XML = r"(?P<xml><\w+(?: [\w:]+=\"[^\"]*\")+ ?/?>)"
#: Wording of a message → the edit that it asks for. The first one that changes a file counts.
EDITS: Sequence[tuple[str, Edit]] = (
    (rf"Remove (?P<names>{_LISTED}) from <actuator>", _tree_edit(_remove_actuators)),
    (rf"Remove from <actuator> [^.]*such as (?P<names>{_LISTED})", _tree_edit(_remove_actuators)),
    (r"actuator (?P<names>'[^']+').*Remove it from <actuator>", _tree_edit(_remove_actuators)),
    (r"Remove the joint and its values in keyframes: (?P<body>\S+) is fixed to the world", _tree_edit(_remove_free_joint)),
    (rf"joints? (?P<joints>{_LISTED}): .*?Change (?:its|their) type to (?P<type>\w+)", _tree_edit(_change_type)),
    (r"joint '(?P<joint>[^']+)'.*?Swap lower and upper", _tree_edit(_swap_limits)),
    (r"(?P<key>\w+)='(?P<found>[^']*)'.*Write (?P=key)=\"(?P<value>[^\"]*)\"", _write_attribute),
    (r"without commas", _without_commas),
    (rf"Remove {_XML}", _tree_edit(_remove_elements)),
    (r"Remove (?P<key>\w+) from its bodies", _tree_edit(_remove_attribute)),
    (rf"Write {_XML}", _tree_edit(_write_element)),
    (rf"Add {_XML}(?: (?:to|in|into) <(?P<parent>\w+)>)?", _tree_edit(_add_element)),
)  # fmt: skip
