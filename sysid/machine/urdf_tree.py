"""Checked parsing of a URDF: joints form one tree, size is bounded, numbers are valid, data without meaning is removed; and
passive joints, ``<mimic joint="m" multiplier="r" offset="z"/>``, which make a joint follow another, ``q = r·q_m + z``.

Readers of parts of it (kinematics, bodies of the PyBullet world, drawn shapes, exports) rely on these checks. Prefixes of names
(``gazebo:``, ``drake:``) are part of the name whether they are declared or not, as in ``urdfdom``.

Parallel linkages (palletisers, excavator buckets) are written with passive joints in a URDF, which only has trees. A passive
joint may follow another passive one.

Source: URDF specification (ROS wiki, ``urdf/XML``): a fixed joint has neither axis, limits, dynamics nor mimic, a continuous
one no end stops.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NoReturn
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError, nearest
from sysid.foreign import shown
from sysid.names import listed
from sysid.numbers import LARGEST, Finite, NonNegative, Positive, number
from sysid.parse import MAX_DEPTH

Array = npt.NDArray[np.float64]

#: The largest URDF of the ROS drivers has 900 elements.
MAX_ELEMENTS = 50_000
MAX_JOINTS = 500
#: The link that is the ground where it is not described (Drake, *Parsing models*: the reserved link ``world``).
GROUND = "world"
#: Kinds of joint that an axis can move; a ``floating`` or ``planar`` one is no single motion.
MOVING = ("revolute", "continuous", "prismatic")
KINDS = (*MOVING, "fixed", "floating", "planar")
ENDS = ("lower", "upper")
MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
#: A negative principal moment below this share of the largest one, or below this value [kg·m²], is rounding.
ROUNDING, TINY_MOMENT = 1e-6, 1e-12

#: Element → attribute → number of values and their type.
NUMBERS: Mapping[str, Mapping[str, tuple[int, Any]]] = {
    "origin": {"xyz": (3, Finite), "rpy": (3, Finite)},
    "axis": {"xyz": (3, Finite)},
    "mass": {"value": (1, NonNegative)},
    "inertia": dict.fromkeys(MOMENTS, (1, Finite)),
    "limit": {**dict.fromkeys(ENDS, (1, Finite)), **dict.fromkeys(("effort", "velocity"), (1, NonNegative))},
    "mimic": {"multiplier": (1, Finite), "offset": (1, Finite)},
    "dynamics": {"damping": (1, NonNegative), "friction": (1, NonNegative)},
    "mesh": {"scale": (3, Finite)},
}
#: Kind of shape → attributes that it needs, and their values.
SHAPES: Mapping[str, Mapping[str, tuple[int, Any]]] = {
    "box": {"size": (3, Positive)},
    "cylinder": {"radius": (1, Positive), "length": (1, Positive)},
    "sphere": {"radius": (1, Positive)},
}
#: Element → children of which the first one counts, as in ``urdfdom``.
ONCE: Mapping[str, tuple[str, ...]] = {
    "joint": ("origin", "axis", "limit", "dynamics", "mimic"),
    "link": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry"),
    "collision": ("origin", "geometry"),
}
_XACRO = "Run xacro first: xacro FILE > robot.urdf."


def xml_root(text: str) -> Element:
    """The root element of an XML text, without namespaces: names are as written.

    Raises:
        ValueError: not well-formed, or with a document type or entities.
    """
    builder = TreeBuilder()
    parser = expat.ParserCreate("utf-8")
    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = builder.start, builder.end, builder.data
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = _no_document_type
    try:
        parser.Parse(text.encode("utf-8"), True)
    except expat.ExpatError as error:
        raise ValueError(str(error)) from None
    return builder.close()


def urdf_tree(text: str) -> Element:
    """The root element of a URDF.

    Removed are axis, limits, dynamics and mimic of joints that do not move, shapes without an extent, repeated elements, and
    end stops of more than 10⁹ rad or m, as of exporters that write ±10¹⁶ or ±inf for none: such a revolute joint becomes
    continuous. An axis without a direction is along x, the default of URDF. A parent ``world`` that is not described is added:
    the ground, as in Drake.

    Raises:
        SettingsError: not XML, a DTD, another root, a xacro; too deep or too large; a number that is invalid, not finite or of
            the wrong sign; a name that is missing or not printable; two joints or links of one name; links that are not one
            tree.
    """
    try:
        root = xml_root(text)
    except ValueError as error:
        raise SettingsError("urdf", f"not readable as XML ({error})", "a URDF without DTD or entities") from None
    if root.tag != "robot":
        raise SettingsError("urdf", f"root element <{shown(root.tag)[1:-1]}>", "<robot>")
    _check_size(root)
    _check_names(root)
    for parent, element in repeated(root):
        parent.remove(element)
    for joint in root.findall("joint"):
        _remove_meaningless(joint)
    for link, shape in invalid_shapes(root):
        link.remove(shape)
    for part in root:
        where = f"urdf: {part.tag} {shown(part.get('name', ''))}" if part.tag in ("joint", "link") else "urdf"
        for element in part.iter():
            _check_numbers(element, where)
    if is_bare_ground(root):
        root.insert(0, Element("link", {"name": GROUND}))
    _check_tree(root)
    return root


def moments_of(inertia: Element | None) -> Array:
    """The tensor (3, 3) [kg·m²] of an ``<inertia>`` element, zeros without one; negative principal moments are zero."""
    tensor = _tensor(inertia)
    values, axes = np.linalg.eigh(tensor)
    return tensor if values[0] >= 0.0 else np.asarray(axes * np.maximum(values, 0.0) @ axes.T)


def indefinite_links(text: str) -> list[str]:
    """Links of a URDF with a principal moment that is negative beyond rounding: no body has such an inertia."""
    found = []
    for link in urdf_tree(text).findall("link"):
        values = np.linalg.eigvalsh(_tensor(link.find("inertial/inertia")))
        if values[0] < -max(TINY_MOMENT, ROUNDING * values[-1]):
            found.append(link.get("name", ""))
    return found


def _tensor(inertia: Element | None) -> Array:
    tensor = np.zeros((3, 3))
    for key in () if inertia is None else MOMENTS:
        i, j = ("xyz".index(letter) for letter in key[1:])
        tensor[i, j] = tensor[j, i] = float(inertia.get(key, "0"))  # type: ignore[union-attr]
    return tensor


def _no_document_type(*_: object) -> NoReturn:
    raise ValueError("a document type or an entity")


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


def repeated(root: Element) -> list[tuple[Element, Element]]:
    """Elements that follow one of the same kind where :data:`ONCE` takes the first, each with its parent."""
    parts = [part for part in (*root.findall("joint"), *root.findall("link")) for part in part.iter()]
    return [(part, child) for part in parts for tag in ONCE.get(str(part.tag), ()) for child in part.findall(tag)[1:]]


def _check_names(root: Element) -> None:
    for element in root.iter():
        name = element.get("name", "")
        if not name.isprintable() or len(name) > 200:
            raise SettingsError("urdf", f"name {shown(name)}", "at most 200 characters, none of them a control character")
        if element.tag.startswith("xacro:"):
            raise SettingsError("urdf", f"<{shown(element.tag)[1:-1]}>", "a URDF, not a xacro", _XACRO)
    for element in root:
        if element.tag in ("joint", "link") and not element.get("name"):
            raise SettingsError("urdf", f"a <{element.tag}> without a name", f'<{element.tag} name="…">')


def is_bare_ground(root: Element) -> bool:
    """Whether joints hang on the link :data:`GROUND` and nothing describes it."""
    parents = {part.get("link") for joint in root.findall("joint") for part in joint.findall("parent")}
    return GROUND in parents and all(link.get("name") != GROUND for link in root.findall("link"))


def _remove_meaningless(joint: Element) -> None:
    """Data that the kind of a joint gives no meaning, and end stops that stand for none."""
    kind, limit, axis = joint.get("type", ""), joint.find("limit"), joint.find("axis")
    if axis is not None:
        axis.attrib.setdefault("xyz", "1 0 0")
    if kind not in MOVING:
        for part in [part for part in joint if part.tag in ("axis", "limit", "dynamics", "mimic", "safety_controller")]:
            joint.remove(part)
    elif limit is not None:
        unlimited = [end for end in ENDS if not _is_stop(limit.get(end))]
        if kind == "continuous" or (kind == "revolute" and len(unlimited) == 2):
            joint.set("type", "continuous")
            for end in ENDS:
                limit.attrib.pop(end, None)
        else:
            for end in unlimited:
                limit.set(end, repr(-LARGEST if end == "lower" else LARGEST))


def invalid_shapes(root: Element) -> list[tuple[Element, Element]]:
    """Visual and collision elements without an extent or a place, each with its link: nothing can be drawn of them."""
    shapes = [(link, shape) for link in root.findall("link") for shape in link if shape.tag in ("visual", "collision")]
    return [(link, shape) for link, shape in shapes if not _has_extent(shape)]


def _has_extent(shape: Element) -> bool:
    try:
        for element in shape.iter():
            _check_numbers(element, "")
            for key, (count, kind) in SHAPES.get(str(element.tag), {}).items():
                words = element.get(key, "").split()
                if len(words) != count:
                    return False
                for word in words:
                    number(word, kind, "")
    except SettingsError:
        return False
    return True


def _is_stop(text: str | None) -> bool:
    """Whether an end of a range (zero where it is not stated) is a place, or no number, which is refused later."""
    try:
        value = float(text or "0")
    except ValueError:
        return True
    return math.isnan(value) or abs(value) < LARGEST


def _check_numbers(element: Element, where: str) -> None:
    for key, (count, kind) in NUMBERS.get(str(element.tag), {}).items():
        text = element.get(key)
        if text is None:
            continue
        place = f"{where}: <{element.tag}>: {key}={shown(text)}"
        words, expected = text.split(), "three numbers, separated by spaces" if count == 3 else "one number"
        if "${" in text or "$(" in text:
            raise SettingsError(place, "an expression of xacro", expected, _XACRO)
        if "," in text:
            remedy = f'Write {key}="{" ".join(text.replace(",", " ").split())}".' if count == 3 else "Write a decimal point."
            raise SettingsError(place, "a comma", expected, remedy)
        if len(words) != count:
            raise SettingsError(place, f"{len(words)} numbers", expected)
        for word in words:
            number(word, kind, place)


def _check_tree(root: Element) -> None:
    """Names are unique, every joint connects two links that exist, and one link is the root of all.

    Raises:
        SettingsError: where not.
    """
    names: dict[str, list[str]] = {tag: [str(each.get("name")) for each in root.findall(tag)] for tag in ("joint", "link")}
    for tag, named in names.items():
        twice = next((name for name in named if named.count(name) > 1), None) if len({*named}) < len(named) else None
        if twice is not None:
            raise SettingsError("urdf", f"two {tag}s are named {twice!r}", f"a name of its own for every {tag}")
    if len(names["joint"]) > MAX_JOINTS:
        raise SettingsError("urdf", f"{len(names['joint'])} joints", f"at most {MAX_JOINTS}")
    links, parent_of = {*names["link"]}, dict[str, str]()
    for joint in root.findall("joint"):
        where, ends = f"urdf: joint {shown(joint.get('name', ''))}", []
        for role in ("parent", "child"):
            found = joint.findall(role)
            if len(found) != 1 or not found[0].get("link"):
                stated = f"{len(found)} elements <{role}>" if len(found) > 1 else f"no <{role} link=…>"
                raise SettingsError(where, stated, "one parent and one child")
            ends.append(str(found[0].get("link")))
            if ends[-1] not in links:
                remedy = f'Add <link name="{ends[-1]}"/>, or remove the joint.'
                raise SettingsError(where, f"{role} link {shown(ends[-1])}, which is not described", "a link", remedy)
        if ends[1] in parent_of:
            raise SettingsError("urdf", f"link {shown(ends[1])} has two parents", "a tree")
        parent_of[ends[1]] = ends[0]
    for start in parent_of:
        seen, link = {start}, start
        while link in parent_of:
            link = parent_of[link]
            if link in seen:
                raise SettingsError("urdf", f"link {shown(link)} is its own ancestor", "a tree")
            seen.add(link)
    roots = [link for link in names["link"] if link not in parent_of]
    if len(roots) > 1:
        without = f"{len(roots)} links without a parent: {listed([shown(link) for link in roots], most=6)}"
        remedy = "Connect them by fixed joints, or remove the links (and what hangs on them) that are not part of the machine."
        raise SettingsError("urdf", without, "one root link", remedy)
    if not roots:
        raise SettingsError("urdf", "no link", "the links of a machine")


#: Attributes of the element and their default values.
_NUMBERS = (("multiplier", "1"), ("offset", "0"))


@dataclass(frozen=True)
class Mimic:
    """``q = ratio·q_master + offset`` [rad or m]."""

    master: str
    ratio: float = 1.0
    offset: float = 0.0


def parse_mimic(element: Element, joint: str) -> Mimic | None:
    """The ``mimic`` of a joint element; None without one.

    Raises:
        SettingsError: no master, or a multiplier or offset that is not a finite number.
    """
    found = element.find("mimic")
    if found is None:
        return None
    where = f"urdf: joint {joint!r}: mimic"
    if not found.get("joint"):
        raise SettingsError(where, "no joint", 'joint="<the joint that it follows>"')
    ratio, offset = (number(found.get(key, default), Finite, f"{where}: {key}") for key, default in _NUMBERS)
    return Mimic(str(found.get("joint")), ratio, offset)


def resolved(joint: str, mimics: Mapping[str, Mimic | None]) -> Mimic:
    """The joint that moves by itself and that ``joint`` finally follows; itself where it is not passive.

    Args:
        mimics: of all joints of the URDF.

    Raises:
        SettingsError: an unknown master, or joints that follow each other in a cycle.
    """
    name, ratio, offset, seen = joint, 1.0, 0.0, [joint]
    while (step := mimics[name]) is not None:
        where = f"urdf: joint {name!r}: mimic"
        if step.master not in mimics:
            close = difflib.get_close_matches(step.master, mimics, n=1, cutoff=0.0)[0]
            remedy = f'Write joint="{close}", if that is the one, or remove the <mimic>.'
            raise SettingsError(where, f"unknown joint {step.master!r}", nearest(step.master, mimics), remedy)
        ratio, offset = ratio * step.ratio, ratio * step.offset + offset
        name = step.master
        if name in seen:
            raise SettingsError(where, f"a cycle: {' → '.join([*seen, name])}", "a joint that an axis moves at the end")
        seen.append(name)
    return Mimic(name, ratio, offset)


def followed(joint: str, mimics: Mapping[str, Mimic | None]) -> Mimic | None:
    """As :func:`resolved`; None where it follows a joint that does not exist, or a cycle."""
    try:
        return resolved(joint, mimics)
    except SettingsError:
        return None
