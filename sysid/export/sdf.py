"""``sdf``: an SDFormat 1.11 model for Gazebo, with repaired geometry and joint friction, and the drive model beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import numpy.typing as npt

from sysid.effects import Effect
from sysid.errors import SettingsError
from sysid.export.drive_module import MODULE, write_drive_model, write_effect_table
from sysid.export.names import MachineNames, Names, scoped
from sysid.export.target import Simulation, Support, Target
from sysid.export.urdf import END_EFFECTOR, FIXED_WORLD, NOTE, WORLD, link_inertias, urdf_names, urdf_of, xml_text
from sysid.foreign import shown
from sysid.plant import Plant

Array = npt.NDArray[np.float64]
FILE, VERSION = "model.sdf", "1.11"
#: Joint that is added, from the world to the first link.
ANCHOR = "world_joint"
#: Mass [kg] and inertia [kg·m²] of a link whose URDF has none, in place of Gazebo's 1 kg.
SMALL_MASS, SMALL_INERTIA = 1e-3, 1e-6
#: Least moment of a body, as a share of its largest one.
THIN = 1e-6
#: Elements of SDFormat that are written → their children (http://sdformat.org/spec?ver=1.11).
CHILDREN: Mapping[str, tuple[str, ...]] = {
    "sdf": ("model",),
    "model": ("link", "joint"),
    "link": ("pose", "inertial"),
    "inertial": ("pose", "mass", "inertia"),
    "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
    "joint": ("pose", "parent", "child", "axis"),
    "axis": ("xyz", "limit", "dynamics", "mimic"),
    "limit": ("lower", "upper", "effort", "velocity"),
    "dynamics": ("damping", "friction"),
    "mimic": ("multiplier", "offset", "reference"),
}


class SdfTarget(Target):
    """SDFormat, as Gazebo reads it."""

    name = "sdf"
    title = "Gazebo (SDFormat 1.11)"
    notes = (
        f"The link `{WORLD}` is fixed to the world: its frame is the measured one. `{END_EFFECTOR}` is the measured point.",
        "A joint has one damping and one friction for both directions: the mean of both is written, and both are in "
        "`effects.csv`. Shapes are not copied.",
        NOTE,
        f"`{MODULE}` computes the joints from the commands, for the set-points of a joint position controller.",
    )
    native: Mapping[str, str] = {"viscous_friction": "`<dynamics><damping>`", "coulomb_friction": "`<dynamics><friction>`"}
    composed: Mapping[str, str] = {
        "joint_offset": "`<pose>` of the joint: its value is that of the sensor",
        "link_length_error": "`<pose>` of the joints of the link",
        "tip_offset": f"link `{END_EFFECTOR}` on that of the tip",
        "base_misalignment": f"joint between the links `{WORLD}` and the root",
    }

    def names(self, plant: Plant) -> MachineNames:
        """Links, joints and frames of a model share one namespace."""
        space = Names([FIXED_WORLD], scoped)
        found = urdf_names(plant, space, space)
        machine = plant.machine.name, Names([FIXED_WORLD], scoped).new(plant.machine.name)
        return replace(found, machine=machine, added={**found.added, **space.each([ANCHOR])})

    def otherwise(self, effect: Effect) -> Support:
        return Support("plugin", f"`{MODULE}`")

    def write(self, plant: Plant, rate_hz: float, folder: Path) -> tuple[str, ...]:
        names = self.names(plant)
        root = sdf_of(urdf_of(plant, names), names.machine[1], names.added[ANCHOR])
        check_sdf(root)
        (folder / FILE).write_text(xml_text(root), "utf-8")
        return FILE, write_effect_table(plant, folder), *write_drive_model(plant, rate_hz, folder)

    def simulation(self, plant: Plant, folder: Path) -> Simulation | None:
        return None


def sdf_of(urdf: Element, name: str, anchor: str = ANCHOR) -> Element:
    """The SDFormat model of a URDF.

    Args:
        anchor: name of the joint that fixes its root to the world.

    Raises:
        SettingsError: a planar joint, which SDFormat does not have.
    """
    root = Element("sdf", {"version": VERSION})
    model = SubElement(root, "model", {"name": name})
    inertias = link_inertias(urdf)
    parents = {str(part.get("link")): joint for joint in urdf.findall("joint") for part in joint.findall("child")}
    for link in urdf.findall("link"):
        name = str(link.get("name"))
        _link(model, name, parents.get(name), inertias.get(name))
    for joint in urdf.findall("joint"):
        _joint(model, joint)
    first = next(str(link.get("name")) for link in urdf.findall("link") if str(link.get("name")) not in parents)
    fixed = SubElement(model, "joint", {"name": anchor, "type": "fixed"})
    _text(fixed, "parent", FIXED_WORLD)
    _text(fixed, "child", first)
    return root


def check_sdf(root: Element) -> None:
    """Check the elements of a model against SDFormat: each is known, in a parent that may have it, and numbers are finite.

    Raises:
        SettingsError: where not.
    """
    for parent in root.iter():
        for child in parent:
            if child.tag not in CHILDREN.get(parent.tag, ()):
                raise SettingsError(
                    "sdf", f"<{child.tag}> in <{parent.tag}>", f"one of {', '.join(CHILDREN.get(parent.tag, ()))}"
                )
        if not len(parent) and parent.tag not in ("parent", "child", "reference", "model"):
            words = (parent.text or "").split()
            if parent.tag != "pose" or words:
                _finite(parent.tag, words)


def _finite(tag: str, words: list[str]) -> None:
    expected = {"pose": 6, "xyz": 3}.get(tag, 1)
    if len(words) != expected or not np.isfinite([float(word) for word in words]).all():
        raise SettingsError("sdf", f"<{tag}> {' '.join(words)}", f"{expected} finite numbers")


def _link(model: Element, name: str, joint: Element | None, inertia: tuple[Array, ...] | None) -> None:
    found = SubElement(model, "link", {"name": name})
    if joint is not None and joint.get("type") != "floating":
        SubElement(found, "pose", {"relative_to": str(joint.get("name"))})
    elif joint is not None:  # two links without a joint between them
        SubElement(found, "pose", {"relative_to": _ends(joint)[0]}).text = _pose(joint.find("origin"))
    mass, centre, moments = inertia or (np.array([SMALL_MASS]), np.zeros(3), np.zeros((3, 3)))
    largest, least = float(np.abs(moments).max()), float(np.linalg.eigvalsh(moments)[0])
    if least <= THIN * largest:  # a rod, a point: Gazebo needs moments about all axes
        moments = moments + (THIN * largest or SMALL_INERTIA) * np.eye(3)
    inertial = SubElement(found, "inertial")
    _text(inertial, "pose", " ".join(repr(float(x)) for x in (*centre, 0.0, 0.0, 0.0)))
    _text(inertial, "mass", repr(float(mass[0])))
    tensor = SubElement(inertial, "inertia")
    for key in CHILDREN["inertia"]:
        _text(tensor, key, repr(float(moments["xyz".index(key[1]), "xyz".index(key[2])])))


def _joint(model: Element, joint: Element) -> None:
    kind = str(joint.get("type"))
    if kind == "floating":
        return
    if kind == "planar":
        where, remedy = f"sdf: joint {shown(str(joint.get('name')))}", "Change its type to fixed, or remove what hangs on it."
        raise SettingsError(where, "a planar joint", "a joint of SDFormat: revolute, continuous, prismatic or fixed", remedy)
    found = SubElement(model, "joint", {"name": str(joint.get("name")), "type": "revolute" if kind == "continuous" else kind})
    parent, child = _ends(joint)
    origin = joint.find("origin")
    SubElement(found, "pose", {"relative_to": parent}).text = _pose(origin)
    _text(found, "parent", parent)
    _text(found, "child", child)
    if kind == "fixed":
        return
    axis, described = SubElement(found, "axis"), joint.find("axis")
    _text(axis, "xyz", "1 0 0" if described is None else str(described.get("xyz", "1 0 0")))
    limit = joint.find("limit")
    if limit is not None and kind != "continuous":
        ends = SubElement(axis, "limit")
        for key in ("lower", "upper", "velocity"):
            if key != "velocity" or float(limit.get(key, "0")):  # a URDF without a rated speed has zero
                _text(ends, key, str(limit.get(key, "0")))
    dynamics = joint.find("dynamics")
    if dynamics is not None:
        part = SubElement(axis, "dynamics")
        for key in ("damping", "friction"):
            _text(part, key, str(dynamics.get(key, "0")))
    mimic = joint.find("mimic")
    if mimic is not None:
        part = SubElement(axis, "mimic", {"joint": str(mimic.get("joint"))})
        for key, default in (("multiplier", "1"), ("offset", "0")):
            _text(part, key, str(mimic.get(key, default)))
        _text(part, "reference", "0")


def _ends(joint: Element) -> tuple[str, str]:
    """Parent and child of a joint of a URDF."""
    parent, child = (str(part.get("link")) for role in ("parent", "child") for part in joint.findall(role))
    return parent, child


def _pose(origin: Element | None) -> str:
    """Translation [m] and fixed-axis angles [rad] of an origin, as a pose."""
    if origin is None:
        return "0 0 0 0 0 0"
    return f"{origin.get('xyz', '0 0 0')} {origin.get('rpy', '0 0 0')}"


def _text(parent: Element, tag: str, text: str) -> None:
    SubElement(parent, tag).text = text
