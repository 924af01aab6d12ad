"""Checked parsing of a URDF: joints form a tree, size is bounded, numbers are valid.

Readers of parts of it (kinematics, bodies of the PyBullet world, drawn shapes) rely on these checks.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from xml.etree.ElementTree import Element

from sysid.errors import SettingsError
from sysid.foreign import shown
from sysid.numbers import Finite, NonNegative, Positive, number
from sysid.parse import MAX_DEPTH

#: The largest URDF of the ROS drivers has 900 elements.
MAX_ELEMENTS = 50_000
MAX_JOINTS = 500

#: Element → attribute → number of values and their type.
NUMBERS: Mapping[str, Mapping[str, tuple[int, Any]]] = {
    "origin": {"xyz": (3, Finite), "rpy": (3, Finite)},
    "axis": {"xyz": (3, Finite)},
    "mass": {"value": (1, NonNegative)},
    "inertia": {**dict.fromkeys(("ixx", "iyy", "izz"), (1, NonNegative)), **dict.fromkeys(("ixy", "ixz", "iyz"), (1, Finite))},
    "limit": {**dict.fromkeys(("lower", "upper"), (1, Finite)), **dict.fromkeys(("effort", "velocity"), (1, NonNegative))},
    "mimic": {"multiplier": (1, Finite), "offset": (1, Finite)},
    "dynamics": {"damping": (1, NonNegative), "friction": (1, NonNegative)},
    "box": {"size": (3, Positive)},
    "cylinder": {"radius": (1, Positive), "length": (1, Positive)},
    "sphere": {"radius": (1, Positive)},
    "mesh": {"scale": (3, Finite)},
}


def urdf_tree(text: str) -> Element:
    """The root element of a URDF.

    Raises:
        SettingsError: not XML, a DTD, another root; too deep or too large; a number that is invalid, not finite or of the wrong
            sign; a name that is not printable; two joints or links of one name; joints that do not form a tree.
    """
    from defusedxml.common import DefusedXmlException
    from defusedxml.ElementTree import ParseError, fromstring

    try:
        root: Element = fromstring(text, forbid_dtd=True)
    except (ParseError, DefusedXmlException, ValueError, LookupError, RecursionError) as error:
        raise SettingsError("urdf", f"not readable as XML ({error})", "a URDF without DTD or entities") from None
    if root.tag != "robot":
        raise SettingsError("urdf", f"root element <{shown(root.tag)[1:-1]}>", "<robot>")
    _check_size(root)
    for element in root.iter():
        _check_numbers(element)
        name = element.get("name", "")
        if not name.isprintable() or len(name) > 200:
            raise SettingsError("urdf", f"name {shown(name)}", "at most 200 characters, none of them a control character")
    _check_joints(root)
    return root


def _check_size(root: Element) -> None:
    level, count = [root], 0
    for _ in range(MAX_DEPTH):
        level = [child for element in level for child in element]
        count += len(level)
        if count > MAX_ELEMENTS:
            raise SettingsError("urdf", f"more than {MAX_ELEMENTS} elements", "the description of one machine")
        if not level:
            return
    raise SettingsError("urdf", f"nested deeper than {MAX_DEPTH} levels", "the description of one machine")


def _check_numbers(element: Element) -> None:
    for key, (count, kind) in NUMBERS.get(str(element.tag), {}).items():
        text = element.get(key)
        if text is None:
            continue
        where = f"urdf: <{element.tag}>: {key}={shown(text)}"
        words = text.split()
        if len(words) != count:
            raise SettingsError(where, f"{len(words)} numbers", "three numbers" if count == 3 else "one number")
        for word in words:
            number(word, kind, where)


def _check_joints(root: Element) -> None:
    for tag in ("joint", "link"):
        names = [str(element.get("name")) for element in root.findall(tag)]
        twice = next((name for name in names if names.count(name) > 1), None) if len({*names}) < len(names) else None
        if twice is not None:
            raise SettingsError("urdf", f"two {tag}s are named {twice!r}", f"a name of its own for every {tag}")
    joints = root.findall("joint")
    if len(joints) > MAX_JOINTS:
        raise SettingsError("urdf", f"{len(joints)} joints", f"at most {MAX_JOINTS}")
    parent_of: dict[str, str] = {}
    for joint in joints:
        parent, child = joint.find("parent"), joint.find("child")
        if parent is None or child is None:
            continue  # reported when the joint is read
        link = str(child.get("link"))
        if link in parent_of:
            raise SettingsError("urdf", f"link {shown(link)} has two parents", "a tree")
        parent_of[link] = str(parent.get("link"))
    for start in parent_of:
        seen, link = {start}, start
        while link in parent_of:
            link = parent_of[link]
            if link in seen:
                raise SettingsError("urdf", f"link {shown(link)} is its own ancestor", "a tree")
            seen.add(link)
