"""URDF of the chain of an MJCF and all that hangs on it: kinematics, masses, limits. Shapes are left out.

A URDF link has its origin on the axis of its joint, an MJCF body anywhere: the link of a body lies at the anchor of its last
joint, and a body with several joints becomes several links. Joint values of both are the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from sysid.machine.kinematics import pose_of, roll_pitch_yaw
from sysid.machine.sources.mjcf_chain import Chain
from sysid.machine.sources.mjcf_model import body_name, joint_name, joints_of, mujoco_library, path_to
from sysid.machine.urdf_tree import Mimic

Array = npt.NDArray[np.float64]

#: The root link, at the origin of the world.
ROOT = "world"
#: A joint without a limit of its speed or force.
_UNLIMITED = {"velocity": "1000", "effort": "1000000"}


def write_urdf(
    model: Any, chain: Chain, name: str, tool: tuple[int, int | None] | None = None
) -> tuple[str, tuple[str, str | None], list[str]]:
    """(text, links of the tip and of the tool, what could not be written).

    Args:
        tool: its body, and the site on it that is meant, if it is one.
    """
    writer = _Writer(model, {joint_name(model, j.joint): j.follows for j in chain.joints if j.follows is not None}, name)
    above, held = int(model.body_parentid[chain.bodies[0]]), [] if chain.base is None else path_to(model, chain.base)
    writer.held = {joint for body in held for joint in joints_of(model, body)}
    writer.add(chain.bodies[0], ROOT, _reference_pose(model, above))
    tip = writer.point(chain.bodies[-1], chain.site)
    hung = None if tool is None else writer.point(*tool)
    indent(writer.root)
    return tostring(writer.root, encoding="unicode") + "\n", (tip, hung), writer.notes


class _Writer:
    def __init__(self, model: Any, mimics: Mapping[str, Mimic], name: str) -> None:
        self.model, self.mimics, self.notes = model, mimics, list[str]()
        self.root = Element("robot", {"name": name})
        SubElement(self.root, "link", {"name": ROOT})
        self.taken, self.joints = {ROOT}, {joint_name(model, joint) for joint in range(model.njnt)}
        self.held: set[int] = set()
        self.link_of: dict[int, str] = {}
        #: Body → pose of the body's frame in that of its link.
        self.frame_of: dict[int, Array] = {}

    def add(self, body: int, parent: str, above: Array) -> None:
        """A body and all below it; ``above``: pose of the parent body's frame in its link (4, 4)."""
        model, own = self.model, self._name(body_name(self.model, body))
        frame = above @ _pose(model.body_pos[body], model.body_quat[body])
        every = [j for j in joints_of(model, body) if j not in self.held]
        joints = [j for j in every if int(model.jnt_type[j]) in self._single()]
        if len(joints) < len(every):
            self.notes.append(f"the free or ball joint of {body_name(model, body)}, which is fixed in the URDF")
        if not joints:
            self._joint(self._fixed(own), "fixed", parent, own, frame)
        for k, joint in enumerate(joints):
            anchor = np.asarray(model.jnt_pos[joint], dtype=np.float64)
            link = own if k == len(joints) - 1 else self._name(f"{own}_{k}")
            axis, straight = np.asarray(model.jnt_axis[joint]), int(model.jnt_type[joint]) == self._single()[0]
            reference = float(model.qpos0[model.jnt_qposadr[joint]])
            motion = _shift(-reference * axis) if straight else _turn(-reference * axis)
            self._moving(joint, parent, link, frame @ _shift(anchor) @ motion)
            parent, frame = link, _shift(-anchor)
            if link != own:
                SubElement(self.root, "link", {"name": link})
        if not joints:
            frame = np.eye(4)
        self._link(own, body, frame)
        self.link_of[body], self.frame_of[body] = own, frame
        for child in range(body + 1, model.nbody):
            if int(model.body_parentid[child]) == body:
                self.add(child, own, frame)

    def point(self, body: int, site: int | None) -> str:
        """The link whose origin is a site, or the origin of a body: that of the body, or one that is fixed to it."""
        model = self.model
        frame, name = self.frame_of[body], body_name(model, body)
        if site is not None:
            frame = frame @ _pose(model.site_pos[site], model.site_quat[site])
            name = str(model.site(site).name) or "tip"
        if np.array_equal(frame, np.eye(4)):
            return self.link_of[body]
        link = self._name(name if name not in self.taken else f"{name}_tip")
        SubElement(self.root, "link", {"name": link})
        self._joint(self._fixed(link), "fixed", self.link_of[body], link, frame)
        return link

    def _single(self) -> tuple[int, int]:
        kinds = mujoco_library().mjtJoint
        return int(kinds.mjJNT_SLIDE), int(kinds.mjJNT_HINGE)

    def _name(self, name: str) -> str:
        """``name``, numbered where it is taken: links of a URDF have names of their own."""
        found, k = name, 1
        while found in self.taken:
            found, k = f"{name}_{k}", k + 1
        self.taken.add(found)
        return found

    def _fixed(self, link: str) -> str:
        """A name for the fixed joint of a link, beside those of the model's joints."""
        found = f"{link}_fixed"
        while found in self.joints:
            found += "_"
        self.joints.add(found)
        return found

    def _link(self, name: str, body: int, frame: Array) -> None:
        model, link = self.model, SubElement(self.root, "link", {"name": name})
        mass = float(model.body_mass[body])
        if mass <= 0.0:
            return
        inertial = SubElement(link, "inertial")
        SubElement(inertial, "origin", _origin(frame @ _pose(model.body_ipos[body], model.body_iquat[body])))
        SubElement(inertial, "mass", {"value": _number(mass)})
        moments = (_number(float(value)) for value in model.body_inertia[body])
        SubElement(
            inertial,
            "inertia",
            dict(zip(("ixx", "iyy", "izz"), moments, strict=True)) | dict.fromkeys(("ixy", "ixz", "iyz"), "0"),
        )

    def _moving(self, joint: int, parent: str, link: str, pose: Array) -> None:
        model, name = self.model, joint_name(self.model, joint)
        straight, limited = int(model.jnt_type[joint]) == self._single()[0], bool(model.jnt_limited[joint])
        kind = "prismatic" if straight else "revolute" if limited else "continuous"
        element = self._joint(name, kind, parent, link, pose)
        SubElement(element, "axis", {"xyz": _numbers(model.jnt_axis[joint])})
        low, high = (float(end) for end in model.jnt_range[joint]) if limited else (-1e6, 1e6)
        if kind != "continuous":
            SubElement(element, "limit", {"lower": _number(low), "upper": _number(high)} | _UNLIMITED)
        if name in self.mimics:
            mimic = self.mimics[name]
            words = {"joint": mimic.master, "multiplier": _number(mimic.ratio), "offset": _number(mimic.offset)}
            SubElement(element, "mimic", words)

    def _joint(self, name: str, kind: str, parent: str, child: str, pose: Array) -> Element:
        element = SubElement(self.root, "joint", {"name": name, "type": kind})
        SubElement(element, "parent", {"link": parent})
        SubElement(element, "child", {"link": child})
        SubElement(element, "origin", _origin(pose))
        return element


def _reference_pose(model: Any, body: int) -> Array:
    """Pose of a body in the world at the model's reference, (4, 4)."""
    pose = np.eye(4)
    for each in path_to(model, body):
        pose = pose @ _pose(model.body_pos[each], model.body_quat[each])
    return pose


def _pose(position: Any, quaternion: Any) -> Array:
    """(4, 4) of MuJoCo's position (3,) and quaternion w x y z."""
    return pose_of(Rotation.from_quat(np.roll(np.asarray(quaternion, dtype=np.float64), -1)).as_matrix(), position)


def _shift(vector: Array) -> Array:
    return pose_of(np.eye(3), vector)


def _turn(vector: Array) -> Array:
    return pose_of(Rotation.from_rotvec(vector).as_matrix(), np.zeros(3))


def _origin(pose: Array) -> dict[str, str]:
    """Attributes of <origin>."""
    return {"xyz": _numbers(pose[:3, 3]), "rpy": _numbers(roll_pitch_yaw(pose[:3, :3]))}


def _number(value: float) -> str:
    return f"{value if value != 0.0 else 0.0:.12g}"


def _numbers(values: Any) -> str:
    return " ".join(_number(float(value)) for value in values)
