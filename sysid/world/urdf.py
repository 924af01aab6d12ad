"""Queries and edits of a URDF tree, for the bodies of the world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError
from sysid.machine.kinematics import Joint, parse_urdf

Array = npt.NDArray[np.float64]

#: For links without mass in the URDF [kg, kg·m²]: negligible for what hangs on them.
MASS, _INERTIA = 1e-3, 1e-6
#: Density [kg/m³].
WATER = 1000.0
_KEYS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def parsed(root: Element) -> dict[str, Joint]:
    return parse_urdf(tostring(root, encoding="unicode"))[0]


def path_to(joints: Mapping[str, Joint], link: str, tip: str) -> tuple[Joint, ...]:
    """Joints from the tip down to ``link``."""
    by_child = {joint.child: joint for joint in joints.values()}
    path: list[Joint] = []
    at = link
    while at != tip:
        if at not in by_child:
            raise SettingsError("PyBullet world", f"tool {link!r} does not hang on the tip {tip!r}", "a link below it")
        path.append(by_child[at])
        at = by_child[at].parent
    return tuple(reversed(path))


def pose_of(joints: dict[str, Joint], link: str, ancestor: str) -> Array:
    """Pose of ``link`` in the frame of ``ancestor`` with all joints at zero; the identity if it is not below it."""
    by_child = {joint.child: joint for joint in joints.values()}
    pose = np.eye(4)
    at = link
    while at != ancestor:
        if at not in by_child:
            return np.eye(4)
        pose = by_child[at].origin @ pose
        at = by_child[at].parent
    return pose


def links_below(root: Element, link: str) -> list[str]:
    """Every link below ``link``."""
    found: list[str] = []
    for joint in parsed(root).values():
        if joint.parent == link:
            found += [joint.child, *links_below(root, joint.child)]
    return found


def remove_below(root: Element, link: str) -> None:
    gone = set(links_below(root, link))
    for element in (*root.findall("joint"), *root.findall("link")):
        child = element.find("child")
        if element.get("name") in gone or (child is not None and child.get("link") in gone):
            root.remove(element)


def chained(joints: Sequence[Joint]) -> Array:
    """Product of the origins of ``joints``, (4, 4)."""
    pose = np.eye(4)
    for joint in joints:
        pose = pose @ joint.origin
    return pose


def offset(joints: Sequence[Joint]) -> Array:
    """Translation of :func:`chained`, (3,)."""
    return np.asarray(chained(joints)[:3, 3])


def _named(root: Element, tag: str, name: str) -> Element:
    return next(element for element in root.findall(tag) if element.get("name") == name)


def joint_element(root: Element, name: str) -> Element:
    return _named(root, "joint", name)


def link_element(root: Element, name: str) -> Element:
    return _named(root, "link", name)


def scale_origin(origin: Element | None, factor: float) -> None:
    if origin is not None:
        origin.set("xyz", " ".join(repr(factor * x) for x in numbers(origin.get("xyz", "0 0 0"))))


def numbers(text: str) -> list[float]:
    return [float(word) for word in text.split()]


def effort_limit(root: Element, joint: str) -> float:
    limit = joint_element(root, joint).find("limit")
    return float(limit.get("effort", "inf")) if limit is not None else float("inf")


def unlimit(joint: Element) -> None:
    """Remove end stops and damping, which the compiled chain contains."""
    for tag in ("limit", "dynamics", "mimic", "safety_controller"):
        for element in joint.findall(tag):
            joint.remove(element)
    if joint.get("type") == "prismatic":
        SubElement(joint, "limit", lower="1", upper="-1", effort="1e9", velocity="1e9")
    else:
        joint.set("type", "continuous")


def drop_meshes(root: Element) -> None:
    """Remove mesh shapes, since a plant does not contain other files than its URDF."""
    for link in root.findall("link"):
        for element in (*link.findall("visual"), *link.findall("collision")):
            if element.find("geometry/mesh") is not None:
                link.remove(element)


def make_touchable(link: Element) -> None:
    """Use the visual shapes for collisions if the link has no collision shapes."""
    if link.find("collision") is None:
        for visual in link.findall("visual"):
            shape = SubElement(link, "collision")
            for child in (visual.find("origin"), visual.find("geometry")):
                if child is not None:
                    shape.append(child)


def complete_inertia(link: Element, mass: float, inertia: float = _INERTIA) -> None:
    """Set mass and inertia of a link without mass; for a mass without inertia, set that of a ball of water."""
    own = mass_of(link)
    if own <= 0.0:
        set_inertia(link, mass, inertia)
    elif link.find("inertial/inertia") is None:
        radius = (own / WATER / (4.0 / 3.0 * np.pi)) ** (1.0 / 3.0)
        SubElement(link.find("inertial"), "inertia", _equal_moments(float(0.4 * own * radius**2)))  # type: ignore[arg-type]


def mass_of(link: Element) -> float:
    element = link.find("inertial/mass")
    return float(element.get("value", "0")) if element is not None else 0.0


def set_inertia(link: Element, mass: float, inertia: float) -> None:
    """Replace the inertial element by a ball of this mass and inertia at the link's origin."""
    for element in link.findall("inertial"):
        link.remove(element)
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz="0 0 0")
    SubElement(inertial, "mass", value=repr(mass))
    SubElement(inertial, "inertia", _equal_moments(inertia))


def _equal_moments(inertia: float) -> dict[str, str]:
    return {key: repr(inertia) if key[1] == key[2] else "0" for key in _KEYS}


def inertial_of(link: Element) -> tuple[float, Array, Array]:
    """Mass, centre of mass and inertia about it, in the link's frame (rotated inertial frames are not supported)."""
    element = link.find("inertial/inertia")
    origin = link.find("inertial/origin")
    centre = np.array(numbers(origin.get("xyz", "0 0 0")) if origin is not None else [0.0, 0.0, 0.0])
    values = {key: float(element.get(key, "0")) if element is not None else 0.0 for key in _KEYS}
    xx, yy, zz, xy, xz, yz = (values[key] for key in _KEYS)
    return mass_of(link), centre, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
