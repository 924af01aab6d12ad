"""Forward kinematics of the actuated chain of a URDF, vectorised over poses.

Source: URDF specification (ROS wiki, ``urdf/XML/joint``); Craig, Introduction to Robotics, ch. 2-3.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError, nearest
from sysid.foreign import shown
from sysid.machine.urdf_tree import ENDS, KINDS, MOVING, Mimic, followed, parse_mimic, resolved, urdf_tree
from sysid.numbers import Finite, NonNegative, end_stops, number

Array = npt.NDArray[np.float64]

#: Standard gravity (CGPM 1901) [m/s²].
GRAVITY = 9.80665


@dataclass(frozen=True)
class Joint:
    """One URDF joint: ``origin`` is the child frame at joint zero in the parent frame, 4×4; ``mimic`` of a passive one."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Array
    axis: Array
    limits: tuple[float, float]
    mimic: Mimic | None = None

    @property
    def prismatic(self) -> bool:
        return self.kind == "prismatic"

    def motion(self, q: Array) -> Array:
        """Child pose relative to the parent at joint values ``q``, shape (n,) → (n, 4, 4)."""
        motion = np.tile(np.eye(4), (len(q), 1, 1))
        if self.prismatic:
            motion[:, :3, 3] = q[:, None] * self.axis
        elif self.kind in ("revolute", "continuous"):
            motion[:, :3, :3] = rotation_about(self.axis, q)
        return np.asarray(self.origin @ motion)


@dataclass(frozen=True)
class Drive:
    """What moves a joint: the value of axis ``column`` times ``ratio`` plus ``offset`` [rad or m]; 1 and 0 of its own axis."""

    column: int
    ratio: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Kinematics:
    """The joints from the URDF's root link to ``tip``; ``actuated`` names those of the axes, in their order.

    Passive (mimic) joints of the chain follow an axis (:attr:`drives`); an axis may move the tip by a passive joint alone.
    ``gravity`` [m/s²] acts along −z of the root link.
    """

    chain: tuple[Joint, ...]
    actuated: tuple[str, ...]
    tip: str
    joints: dict[str, Joint]
    masses: dict[str, tuple[float, tuple[float, float, float]]]
    tool: str | None = None
    gravity: float = GRAVITY

    @staticmethod
    @functools.lru_cache(maxsize=64)
    def from_urdf(
        text: str, joints: tuple[str, ...], tip: str, tool: str | None = None, gravity: float = GRAVITY
    ) -> Kinematics:
        """Parse a URDF and follow it from ``tip`` to the root.

        Raises:
            SettingsError: not a URDF, an unknown joint or link, an actuated joint that does not move the tip.
        """
        every, masses = parse_urdf(text)
        by_child = {joint.child: joint for joint in every.values()}
        links = {joint.child for joint in every.values()} | {joint.parent for joint in every.values()}
        for role, link in (("tip", tip), ("tool", tool)):
            if link is not None and link not in links:
                raise SettingsError(f"urdf: {role}", f"unknown link {link!r}", nearest(link, links))
        chain: list[Joint] = []
        link = tip
        while link in by_child:  # ends: the joints are a tree
            chain.append(by_child[link])
            link = by_child[link].parent
        chain.reverse()
        on_chain = [joint.name for joint in chain if joint.kind != "fixed"]
        mimics = {name: joint.mimic for name, joint in every.items()}
        follows = {name: resolved(name, mimics).master for name in on_chain}
        for joint in chain:
            if joint.kind not in (*MOVING, "fixed"):
                remedy = f"Change its type to fixed, where {joint.child} does not move with respect to {joint.parent}."
                found = f"a {joint.kind} joint, which moves the tip"
                raise SettingsError(f"urdf: joint {shown(joint.name)}", found, f"{', '.join(MOVING)} or fixed", remedy)
        for name in joints:
            if name not in every:
                raise SettingsError("urdf", f"unknown joint {name!r}", nearest(name, every))
            if every[name].mimic is not None:
                expected = f"an axis for {resolved(name, mimics).master!r}, which it follows"
                raise SettingsError("urdf", f"joint {name!r} of an axis is passive (mimic)", expected)
            if name not in follows.values():
                raise SettingsError("urdf", f"joint {name!r} does not move the tip {tip!r}", nearest(name, on_chain))
        for name in on_chain:
            if every[follows[name]].kind not in MOVING:
                found = f"a mimic of {follows[name]!r}, which does not move"
                raise SettingsError(f"urdf: joint {shown(name)}", found, "a joint that moves", "Change its type to fixed.")
            if follows[name] not in joints:
                via = "" if every[name].mimic is None else f" by the passive joint {name!r}"
                found = f"joint {follows[name]!r} moves the tip{via} but no axis names it"
                raise SettingsError("urdf", found, "an axis for each joint")
        return Kinematics(tuple(chain), joints, tip, every, masses, tool, gravity)

    @functools.cached_property
    def drives(self) -> dict[str, Drive]:
        """Joint → the axis that moves it, itself or by a passive joint; joints that no axis moves are missing.

        A passive joint beside the chain whose master does not exist rests.
        """
        mimics = {name: joint.mimic for name, joint in self.joints.items()}
        found = {}
        for name in mimics:
            if (follows := followed(name, mimics)) is not None and follows.master in self.actuated:
                found[name] = Drive(self.actuated.index(follows.master), follows.ratio, follows.offset)
        return found

    @property
    def moved_links(self) -> set[str]:
        """Links that an axis moves: those behind the first joint of the chain that moves, and all that hangs on them."""
        first = next((k for k, joint in enumerate(self.chain) if joint.name in self.drives), len(self.chain))
        below, found = [joint.child for joint in self.chain[first:]], set[str]()
        while below:
            link = below.pop()
            if link not in found:
                found.add(link)
                below += [joint.child for joint in self.joints.values() if joint.parent == link]
        return found

    def moved_frames(self) -> Iterator[tuple[int, Joint, Array]]:
        """Of each joint of the chain: number of the last joint up to it that an axis moves (−1: none), the joint, and the pose
        (4, 4) of its child in the frame that this one moves, or in that of the root."""
        number, frame = -1, np.eye(4)
        for joint in self.chain:
            frame = frame @ joint.origin
            if joint.name in self.drives:
                number, frame = number + 1, np.eye(4)
            yield number, joint, frame

    def is_prismatic(self, joint: str) -> bool:
        return self.joints[joint].prismatic

    def limits(self, joint: str) -> tuple[float, float]:
        return self.joints[joint].limits

    def link_poses(self, q: Array) -> dict[str, Array]:
        """Pose of every link of the chain in the base frame.

        Args:
            q: joint values in the order of ``actuated``, shape (n, n_axes) [rad or m].

        Returns:
            Link name → (n, 4, 4).
        """
        q = np.atleast_2d(np.asarray(q, dtype=np.float64))
        pose = np.tile(np.eye(4), (len(q), 1, 1))
        poses = {self.chain[0].parent: pose} if self.chain else {self.tip: pose}
        for joint in self.chain:
            drive = self.drives.get(joint.name)
            values = np.zeros(len(q)) if drive is None else drive.ratio * q[:, drive.column] + drive.offset
            pose = pose @ joint.motion(values)
            poses[joint.child] = pose
        return poses

    def tip_position(self, q: Array) -> Array:
        """End-effector position in the base frame, (n, n_axes) → (n, 3) [m]."""
        return np.asarray(self.link_poses(q)[self.tip][:, :3, 3])


def rotation_about(axis: Array, angle: Array) -> Array:
    """Rotation matrices about a unit ``axis`` (3,) by ``angle`` (n,), (n, 3, 3) (Rodrigues)."""
    cross = cross_matrix(axis)
    sin, cos = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + sin * cross + (1.0 - cos) * (cross @ cross))


def cross_matrix(vector: Array) -> Array:
    """[v]×, (3, 3): its product with a vector is the cross product of v (3,) and that."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_by(vector: Array) -> Array:
    """The rotation by a rotation vector (3,), (3, 3)."""
    angle = float(np.linalg.norm(vector))
    return np.asarray(rotation_about(vector / angle, np.array([angle]))[0]) if angle > 0.0 else np.eye(3)


def pose_of(rotation: Array, place: Array) -> Array:
    """A rotation (3, 3) and a place (3,) [m] as one pose, (4, 4)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, place
    return pose


def parse_urdf(text: str) -> tuple[dict[str, Joint], dict[str, tuple[float, tuple[float, float, float]]]]:
    """All joints by name, and link name → (mass [kg], centre of mass in the link frame [m])."""
    root = urdf_tree(text)
    joints = {joint.name: joint for joint in (_parse_joint(element) for element in root.findall("joint"))}
    masses = {}
    for link in root.findall("link"):
        mass = link.find("inertial/mass")
        if mass is not None:
            where = f"urdf: link {shown(link.get('name', ''))}"
            centre = _vector(link.find("inertial/origin"), "xyz", "0 0 0", where)
            value = number(mass.get("value", "0"), NonNegative, f"{where}: mass")
            masses[link.get("name", "")] = (value, (centre[0], centre[1], centre[2]))
    return joints, masses


def _parse_joint(element: Element) -> Joint:
    name, kind = element.get("name", ""), element.get("type", "")
    where = f"urdf: joint {shown(name)}"
    if kind not in KINDS:
        raise SettingsError(where, f"type {shown(kind)}", ", ".join(KINDS), "" if kind else "Write its type.")
    parent, child = (str(element.find(role).get("link")) for role in ("parent", "child"))  # type: ignore[union-attr]
    axis = _vector(element.find("axis"), "xyz", "1 0 0", where)
    norm = float(np.linalg.norm(axis))
    if norm == 0.0:
        remedy = 'Write the direction of motion, such as xyz="0 0 1", or change its type to fixed.'
        raise SettingsError(where, "axis of length zero", "a direction", remedy)
    limit = element.find("limit")
    low, high = -math.inf, math.inf
    if limit is not None and kind in ("revolute", "prismatic"):
        low, high = (number(limit.get(end, "0"), Finite, f"{where}: {end}") for end in ENDS)
        low, high = end_stops(low, high)
    origin = origin_pose(element.find("origin"), where)
    return Joint(name, kind, parent, child, origin, axis / norm, (low, high), parse_mimic(element, name))


def origin_pose(origin: Element | None, where: str = "urdf") -> Array:
    """Pose of an <origin> element, (4, 4) [m]; the identity without one.

    Raises:
        SettingsError: entries that are not three finite numbers.
    """
    place = _vector(origin, "xyz", "0 0 0", where)
    return pose_of(_from_rpy(_vector(origin, "rpy", "0 0 0", where)), place)


def _vector(element: Element | None, key: str, default: str, where: str) -> Array:
    text = default if element is None else element.get(key, default)
    words = text.split()
    if len(words) != 3:
        raise SettingsError(where, f"{key}={shown(text)}", "three numbers")
    return np.array([number(word, Finite, f"{where}: {key}={shown(text)}") for word in words])


def roll_pitch_yaw(turn: Array) -> tuple[float, float, float]:
    """Fixed-axis angles of a rotation matrix, R = Rz(yaw)·Ry(pitch)·Rx(roll) [rad]."""
    pitch = math.atan2(-turn[2, 0], math.hypot(turn[0, 0], turn[1, 0]))
    if math.hypot(turn[0, 0], turn[1, 0]) < 1e-9:  # yaw and roll turn about one axis
        return math.atan2(-turn[1, 2], turn[1, 1]), pitch, 0.0
    return math.atan2(turn[2, 1], turn[2, 2]), pitch, math.atan2(turn[1, 0], turn[0, 0])


def _from_rpy(rpy: Array) -> Array:
    """Fixed-axis roll, pitch, yaw as in the URDF specification."""
    rotation = np.eye(3)
    for axis, angle in zip(np.eye(3), rpy, strict=True):
        rotation = rotation_about(axis, np.array([angle]))[0] @ rotation
    return rotation
