"""The URDF of a plant: that of its machine with the effects that a URDF can hold, or a plain one from the limits of its axes.

Joint values are those of the sensors: an offset of a joint turns (or shifts) its frame.
"""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import numpy.typing as npt

from sysid.export.geometry import base_pose, stretched, tip_offset
from sysid.machine.kinematics import Kinematics, rotation_about
from sysid.machine.urdf_tree import urdf_tree
from sysid.plant import Plant

Array = npt.NDArray[np.float64]
#: Links that are added: the frame in which the end effector was measured, and the measured point.
WORLD, END_EFFECTOR = "measured_frame", "ee"
#: Distance between the links of axes without a URDF [m].
APART = 0.5


def urdf_of(plant: Plant) -> str:
    """The URDF as text."""
    kinematics = plant.machine.kinematics()
    if kinematics is None or plant.machine.urdf_text is None:
        root = _plain(plant)
    else:
        root = urdf_tree(plant.machine.urdf_text)
        _set_frames(root, plant, kinematics)
        _add_frames(root, plant, kinematics)
    for axis in plant.machine.axes:
        _set_dynamics(root, plant, axis.name, axis.joint or axis.name)
    indent(root)
    return tostring(root, encoding="unicode", xml_declaration=True)


def _set_frames(root: Element, plant: Plant, kinematics: Kinematics) -> None:
    """Origins of all joints of the chain, stretched, and turned by the offsets of their sensors."""
    for element in root.findall("joint"):
        joint = kinematics.joints[str(element.get("name"))]
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


def _add_frames(root: Element, plant: Plant, kinematics: Kinematics) -> None:
    """The measured frame above the root, and the measured point on the link of the tip."""
    _fixed(root, WORLD, kinematics.chain[0].parent, *base_pose(plant), new=WORLD)
    _fixed(root, kinematics.tip, END_EFFECTOR, np.eye(3), tip_offset(plant, kinematics), new=END_EFFECTOR)


def _fixed(root: Element, parent: str, child: str, turn: Array, place: Array, new: str) -> None:
    SubElement(root, "link", {"name": new})
    joint = SubElement(root, "joint", {"name": f"{new}_joint", "type": "fixed"})
    SubElement(joint, "parent", {"link": parent})
    SubElement(joint, "child", {"link": child})
    _set_origin(SubElement(joint, "origin"), turn, place)


def _set_origin(origin: Element, turn: Array, place: Array) -> None:
    origin.set("xyz", " ".join(repr(float(x)) for x in place))
    origin.set("rpy", " ".join(repr(x) for x in roll_pitch_yaw(turn)))


def roll_pitch_yaw(turn: Array) -> tuple[float, float, float]:
    """Fixed-axis angles of a rotation matrix, R = Rz(yaw)·Ry(pitch)·Rx(roll) [rad]."""
    pitch = math.atan2(-turn[2, 0], math.hypot(turn[0, 0], turn[1, 0]))
    if math.hypot(turn[0, 0], turn[1, 0]) < 1e-12:  # yaw and roll turn about one axis
        return math.atan2(-turn[1, 2], turn[1, 1]), pitch, 0.0
    return math.atan2(turn[2, 1], turn[2, 2]), pitch, math.atan2(turn[1, 0], turn[0, 0])


def _set_dynamics(root: Element, plant: Plant, axis: str, name: str) -> None:
    """Damping and friction of a force axis, the mean of both directions; the rated speed of a velocity axis."""
    element = next(joint for joint in root.findall("joint") if joint.get("name") == name)
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


def _plain(plant: Plant) -> Element:
    """A link for each axis, side by side: revolute about z, prismatic along x."""
    root = Element("robot", {"name": plant.machine.name})
    SubElement(root, "link", {"name": "base"})
    for k, axis in enumerate(plant.machine.axes):
        slides = axis.joint_type == "prismatic"
        link = f"{axis.name}_link"
        SubElement(root, "link", {"name": link})
        joint = SubElement(root, "joint", {"name": axis.joint or axis.name, "type": "prismatic" if slides else "revolute"})
        SubElement(joint, "parent", {"link": "base"})
        SubElement(joint, "child", {"link": link})
        SubElement(joint, "origin", {"xyz": f"0 {APART * k} 0"})
        SubElement(joint, "axis", {"xyz": "1 0 0" if slides else "0 0 1"})
        low, high = axis.limits or (-1e3, 1e3)
        SubElement(joint, "limit", {"lower": repr(low), "upper": repr(high), "effort": "0", "velocity": "0"})
    return root


def joint_values(kinematics: Kinematics, joints: Array) -> dict[str, float]:
    """Values of all moved joints of a URDF for the axes' joints (A,), passive ones included."""
    return {name: drive.ratio * float(joints[drive.column]) + drive.offset for name, drive in kinematics.drives.items()}
