"""``urdf``: the URDF with repaired geometry and joint friction, a table of the other effects, and the drive model.

The URDF of a plant is that of its machine with the effects that a URDF can hold, or a plain one from the limits of its axes.
Joint values are those of the sensors: an offset of a joint turns (or shifts) its frame. Effects of the geometry are places of
frames: lengths of links, offset of the tip, pose of the base.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import numpy.typing as npt

from sysid.effects import Effect
from sysid.export.drive_module import (
    MODULE,
    ModelSimulation,
    load_module,
    true_signals,
    write_drive_model,
    write_effect_table,
)
from sysid.export.names import MachineNames, Names
from sysid.export.target import Simulation, Support, Target
from sysid.machine.kinematics import Joint, Kinematics, origin_pose, roll_pitch_yaw, rotation_about, rotation_by
from sysid.machine.urdf_tree import MOVING, followed, moments_of, urdf_tree
from sysid.plant import Plant
from sysid.signals import point_signals

Array = npt.NDArray[np.float64]


def base_pose(plant: Plant) -> tuple[Array, Array]:
    """Rotation (3, 3) and place (3,) [m] of the base in the measured frame."""
    item = plant.effect("base_misalignment", "base")
    if item is None:
        return np.eye(3), np.zeros(3)
    turn = rotation_by(np.asarray(item.parameters["rotation"], dtype=np.float64))
    return turn, np.asarray(item.parameters["translation"], dtype=np.float64)


def stretched(joint: Joint, plant: Plant, kinematics: Kinematics) -> Array:
    """Place of a joint's frame, with the length error of the link that the joint before it in the chain moves.

    Fixed joints in between belong to that link: each is stretched by the same share.
    """
    place = joint.origin[:3, 3].copy()
    names = [j.name for j in kinematics.chain]
    if joint.name not in names:
        return place
    moved = [j for j in kinematics.chain[: names.index(joint.name)] if j.name in kinematics.drives]
    if not moved or moved[-1].name not in kinematics.actuated:
        return place
    target = plant.machine.axis_names[kinematics.actuated.index(moved[-1].name)]
    error = plant.effect("link_length_error", target)
    length = link_length(kinematics, moved[-1].name)
    if error is None or length < 1e-9:
        return place
    return place * (1.0 + float(np.asarray(error.parameters["error"])) / length)


def link_length(kinematics: Kinematics, joint: str) -> float:
    """Distance from the frame of a joint of the chain to that of the next joint that moves, or to the tip [m]."""
    names = [j.name for j in kinematics.chain]
    frame = np.eye(4)
    for step in kinematics.chain[names.index(joint) + 1 :]:
        frame = frame @ step.origin
        if step.name in kinematics.drives:
            break
    return float(np.linalg.norm(frame[:3, 3]))


def tip_offset(plant: Plant, kinematics: Kinematics) -> Array:
    """Offset of the tip in the frame of its link, (3,) [m]; the effect has it in the frame that the last joint moves."""
    item = plant.effect("tip_offset", "ee")
    if item is None:
        return np.zeros(3)
    turn = np.eye(3)
    for joint in reversed(kinematics.chain):
        if joint.name in kinematics.drives:
            break
        turn = joint.origin[:3, :3] @ turn
    return np.asarray(turn.T @ np.asarray(item.parameters["translation"], dtype=np.float64))


#: Link → mass (1,) [kg], centre (3,) [m] and inertia about it in the axes of the link (3, 3) [kg·m²].
LinkInertias = Mapping[str, tuple[Array, ...]]
#: Mass [kg] and inertia [kg·m²] of a body whose URDF link has none: a simulator needs some, the drives do not notice it.
SMALL_MASS, SMALL_INERTIA = 1e-9, 1e-9


#: Of every format with masses, for the page of an export.
NOTE = (
    "Moments of inertia that no mass distribution has (one above the sum of the others) are replaced by the nearest possible "
    "ones."
)


def link_inertias(urdf: Element) -> LinkInertias:
    """Those of a URDF; a link without a mass is left out."""
    found: dict[str, tuple[Array, ...]] = {}
    for link in urdf.findall("link"):
        mass, moments = link.find("inertial/mass"), link.find("inertial/inertia")
        if mass is None or float(mass.get("value", "0")) <= 0.0:
            continue
        pose = origin_pose(link.find("inertial/origin"))
        turned = pose[:3, :3] @ possible(moments_of(moments)) @ pose[:3, :3].T
        found[str(link.get("name"))] = (np.array([float(str(mass.get("value")))]), pose[:3, 3], turned)
    return found


def possible(moments: Array) -> Array:
    """Moments (3, 3) of the nearest mass distribution: its second moment tr(I)/2 − I along any direction is at least zero."""
    values, axes = np.linalg.eigh(0.5 * np.trace(moments) * np.eye(3) - moments)
    if values[0] >= 0.0:
        return moments
    second = axes * np.maximum(values, 0.0) @ axes.T
    return np.asarray(np.trace(second) * np.eye(3) - second)


#: Links that are added: the frame in which the end effector was measured, and the measured point; and joints to them.
WORLD, END_EFFECTOR = "measured_frame", "ee"
WORLD_JOINT, END_EFFECTOR_JOINT = f"{WORLD}_joint", f"{END_EFFECTOR}_joint"
#: A link of this name is the fixed world of MuJoCo and Gazebo, which leave out the joint above it.
FIXED_WORLD = "world"
#: Distance between the links of axes without a URDF [m].
APART = 0.5
#: Where a URDF has the name of a link, and of a joint: path of the elements, attribute.
_LINKS = (("link", "name"), ("joint/parent", "link"), ("joint/child", "link"))
_JOINTS = (("joint", "name"), ("joint/mimic", "joint"), ("transmission/joint", "name"), ("ros2_control/joint", "name"))


def own_urdf(plant: Plant) -> tuple[Element, dict[str, str]]:
    """The URDF of the machine, or a plain one, without effects; and axis → its joint there."""
    text, kinematics = plant.machine.urdf_text, plant.machine.kinematics()
    if text is None or kinematics is None:
        return _plain(plant)
    root = urdf_tree(text)
    root.set("name", root.get("name") or plant.machine.name)
    mimics = {name: joint.mimic for name, joint in kinematics.joints.items()}
    for joint in root.findall("joint"):
        leader = followed(joint.get("name", ""), mimics)
        if leader is None or kinematics.joints[leader.master].kind not in MOVING:  # beside the chain: it rests
            for mimic in joint.findall("mimic"):
                joint.remove(mimic)
    return root, {axis.name: str(axis.joint) for axis in plant.machine.axes}


def machine_names(
    plant: Plant, links: Names, joints: Names, added_links: Sequence[str] = (), added_joints: Sequence[str] = ()
) -> MachineNames:
    """Names of the machine in a target that describes bodies.

    Args:
        links, joints: the namespaces of its bodies and of its joints, which may be one.
        added_links, added_joints: what the target adds to each.
    """
    root, driven = own_urdf(plant)
    found_links, found_joints = (
        space.each(str(element.get("name", "")) for element in root.findall(tag))
        for space, tag in ((links, "link"), (joints, "joint"))
    )
    added = links.each(added_links) | joints.each(added_joints)
    name, axes = plant.machine.name, {axis: axis for axis in plant.machine.axis_names}
    return MachineNames((name, name), axes, found_links, found_joints, driven, added)


def urdf_names(plant: Plant, links: Names, joints: Names) -> MachineNames:
    """Those of a URDF with the added frames; the namespaces are of its readers."""
    posed = plant.machine.kinematics() is not None
    frames = ((WORLD, END_EFFECTOR), (WORLD_JOINT, END_EFFECTOR_JOINT)) if posed else ((), ())
    return machine_names(plant, links, joints, *frames)


def urdf_of(plant: Plant, names: MachineNames) -> Element:
    """The URDF of a plant in the names of a target; with the added frames where it has names for them."""
    root, driven = own_urdf(plant)
    kinematics = plant.machine.kinematics()
    if kinematics is not None:
        _set_frames(root, plant, kinematics)
    for axis, joint in driven.items():
        _set_dynamics(root, plant, axis, joint)
    _rename(root, names)
    if kinematics is not None and WORLD in names.added:
        base, tip = names.links[kinematics.chain[0].parent], names.links[kinematics.tip]
        world, end = names.added[WORLD], names.added[END_EFFECTOR]
        SubElement(root, "link", {"name": world})
        _fixed(root, names.added[WORLD_JOINT], (world, base), *base_pose(plant))
        SubElement(root, "link", {"name": end})
        _fixed(root, names.added[END_EFFECTOR_JOINT], (tip, end), np.eye(3), tip_offset(plant, kinematics))
    return root


def xml_text(root: Element) -> str:
    """An element as a document."""
    indent(root)
    return tostring(root, encoding="unicode", xml_declaration=True)


def _rename(root: Element, names: MachineNames) -> None:
    for places, written in ((_LINKS, names.links), (_JOINTS, names.joints)):
        for path, key in places:
            for element in root.findall(path):
                if (name := element.get(key, "")) in written:
                    element.set(key, written[name])
    for element in root.findall("gazebo"):
        if (name := element.get("reference", "")) in names.links or name in names.joints:
            element.set("reference", {**names.joints, **names.links}[name])


def _set_frames(root: Element, plant: Plant, kinematics: Kinematics) -> None:
    """Origins of all joints of the chain, stretched, and turned by the offsets of their sensors."""
    for element in root.findall("joint"):
        joint = kinematics.joints[element.get("name", "")]
        place, turn = stretched(joint, plant, kinematics), joint.origin[:3, :3]
        drive = kinematics.drives.get(joint.name)
        offset = 0.0
        if drive is not None:
            item = plant.effect("joint_offset", plant.machine.axis_names[drive.column])
            offset = 0.0 if item is None else drive.ratio * float(np.asarray(item.parameters["offset"]))
        if offset and joint.prismatic:
            place = place + turn @ joint.axis * offset
        elif offset:
            turn = turn @ rotation_about(joint.axis, np.array([offset]))[0]
        if np.array_equal(place, joint.origin[:3, 3]) and np.array_equal(turn, joint.origin[:3, :3]):
            continue
        origin = element.find("origin")
        if origin is None:
            origin = SubElement(element, "origin")
        _set_origin(origin, turn, place)


def _fixed(root: Element, name: str, ends: tuple[str, str], turn: Array, place: Array) -> None:
    joint = SubElement(root, "joint", {"name": name, "type": "fixed"})
    for role, link in zip(("parent", "child"), ends, strict=True):
        SubElement(joint, role, {"link": link})
    _set_origin(SubElement(joint, "origin"), turn, place)


def _set_origin(origin: Element, turn: Array, place: Array) -> None:
    origin.set("xyz", " ".join(repr(float(x)) for x in place))
    origin.set("rpy", " ".join(repr(x) for x in roll_pitch_yaw(turn)))


def _set_dynamics(root: Element, plant: Plant, axis: str, name: str) -> None:
    """Damping and friction of a force axis, the mean of both directions; the rated speed of a velocity axis."""
    element = next(joint for joint in root.findall("joint") if joint.get("name", "") == name)
    about = plant.machine.axis(axis)
    if about.actuation == "velocity" and about.drives == "joint":
        limit = element.find("limit")
        if limit is not None:
            limit.set("velocity", repr(float(about.gain)))
    values = {}
    for effect, attribute, simple in (
        ("viscous_friction", "damping", "coefficient"),
        ("coulomb_friction", "friction", "force"),
    ):
        item = plant.effect(effect, axis)
        if item is not None:
            sides = [item.parameters.get(key, item.parameters.get(simple, 0.0)) for key in ("positive", "negative")]
            values[attribute] = repr(float(np.mean(np.asarray(sides, dtype=np.float64))))
    if values:
        dynamics = element.find("dynamics")
        if dynamics is None:
            dynamics = SubElement(element, "dynamics")
        for attribute, value in values.items():
            dynamics.set(attribute, value)


def _plain(plant: Plant) -> tuple[Element, dict[str, str]]:
    """A link for each axis, side by side: revolute about z, prismatic along x; and axis → joint."""
    root, joints = Element("robot", {"name": plant.machine.name}), Names()
    driven = {axis.name: joints.new(axis.joint or axis.name) for axis in plant.machine.axes}
    SubElement(root, "link", {"name": "base"})
    for k, axis in enumerate(plant.machine.axes):
        slides = axis.joint_type == "prismatic"
        link = f"{axis.name}_link"
        SubElement(root, "link", {"name": link})
        joint = SubElement(root, "joint", {"name": driven[axis.name], "type": "prismatic" if slides else "revolute"})
        SubElement(joint, "parent", {"link": "base"})
        SubElement(joint, "child", {"link": link})
        SubElement(joint, "origin", {"xyz": f"0 {APART * k} 0"})
        SubElement(joint, "axis", {"xyz": "1 0 0" if slides else "0 0 1"})
        low, high = axis.limits or (-1e3, 1e3)
        SubElement(joint, "limit", {"lower": repr(low), "upper": repr(high), "effort": "0", "velocity": "0"})
    return root, driven


def joint_values(kinematics: Kinematics, names: MachineNames, joints: Array) -> dict[str, float]:
    """Written name → value of all moved joints of a URDF for the axes' joints (A,), passive ones included."""
    drives = kinematics.drives.items()
    return {names.joints[name]: drive.ratio * float(joints[drive.column]) + drive.offset for name, drive in drives}


FILE = "robot.urdf"
COMPOSED = {
    "joint_offset": "`<origin>` of the joint: its value is that of the sensor",
    "link_length_error": "`<origin>` of the joints of the link",
    "tip_offset": f"link `{END_EFFECTOR}` on that of the tip",
    "base_misalignment": "link `measured_frame` above the root",
}


class UrdfTarget(Target):
    """URDF, as ROS and most simulators read it."""

    name = "urdf"
    title = "URDF"
    modules = ("mujoco",)
    notes = (
        "A URDF has one friction for both directions: the mean of both is written, and both are in `effects.csv`.",
        "Meshes are referred to as in the URDF of the machine, and not copied.",
        "For the replay the drive model moves the joints, and MuJoCo reads the URDF and computes the end effector.",
    )
    native: Mapping[str, str] = {"viscous_friction": "`<dynamics damping>`", "coulomb_friction": "`<dynamics friction>`"}
    composed = COMPOSED

    def names(self, plant: Plant) -> MachineNames:
        return urdf_names(plant, Names([FIXED_WORLD]), Names())

    def otherwise(self, effect: Effect) -> Support:
        return Support("plugin", f"`{MODULE}`")

    def write(self, plant: Plant, rate_hz: float, folder: Path) -> tuple[str, ...]:
        (folder / FILE).write_text(xml_text(urdf_of(plant, self.names(plant))), "utf-8")
        return FILE, write_effect_table(plant, folder), *write_drive_model(plant, rate_hz, folder)

    def simulation(self, plant: Plant, folder: Path) -> Simulation | None:
        return urdf_simulation(plant, load_module(folder / MODULE).load(), folder / FILE, self.names(plant))


def urdf_simulation(plant: Plant, model: Any, path: Path, names: MachineNames) -> ModelSimulation:
    """The drive model moves the joints of the URDF in MuJoCo, which computes the end effector."""
    import mujoco

    kinematics = plant.machine.kinematics()
    drives = {} if kinematics is None else kinematics.drives
    moved = {names.joints[name] for name in drives} | {names.joint(axis) for axis in plant.machine.axis_names}
    spec = mujoco.MjSpec.from_string(skeleton(path.read_text("utf-8"), moved))
    spec.compiler.fusestatic = False
    spec.compiler.boundmass, spec.compiler.boundinertia = 1e-9, 1e-9
    body = spec.compile()
    data = mujoco.MjData(body)

    def signals(state: Any) -> dict[str, float]:
        found = true_signals(plant, state)
        if kinematics is None:
            return found
        offsets = np.array([axis.offset for axis in model.axes])
        for name, value in joint_values(kinematics, names, state.structure - offsets).items():
            data.qpos[body.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(body, data)
        return found | end_effector_signals(data.body(names.added[END_EFFECTOR]).xpos, state)

    return ModelSimulation(model, signals)


def end_effector_signals(place: Array, state: Any) -> dict[str, float]:
    """End effector at ``place`` (3,) [m], and the tool as far from it as in a state of the drive model."""
    points = (("ee", place), ("tool", place + state.tool - state.ee))
    return {name: float(x) for point, at in points for name, x in zip(point_signals(point), at, strict=True)}


def skeleton(urdf: str, moved: Collection[str]) -> str:
    """Frames and moved joints of a URDF alone: without shapes, whose meshes need not be there, and without masses."""
    root = urdf_tree(urdf)
    for link in root.findall("link"):
        for part in list(link):
            link.remove(part)
    for joint in root.findall("joint"):
        for mimic in joint.findall("mimic"):
            joint.remove(mimic)
        if joint.get("name") not in moved:
            joint.set("type", "fixed")
    return tostring(root, encoding="unicode")
