"""Inverse dynamics of the moved links of a machine, by Pinocchio: torques and their slopes by the inertial parameters.

Torques are linear in the inertial parameters of the bodies. A body is all that moves with one joint of the URDF, fixed parts
included; its ten parameters are mass [kg], first moment (3) [kg·m] and inertia xx, xy, yy, xz, yz, zz [kg·m²], all in and about
the frame of its joint.

Source: Atkeson, An, Hollerbach, Int. J. Robotics Research 5(3), 1986 (regressor); Carpentier et al., SII 2019 (Pinocchio).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, Literal
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError
from sysid.extras import install_remedy
from sysid.machine.description import Machine
from sysid.machine.kinematics import Kinematics
from sysid.machine.moved_bodies import has_masses
from sysid.machine.urdf_tree import MOMENTS, urdf_tree

Array = npt.NDArray[np.float64]

#: Inertial parameters of a body.
PARAMETERS = 10
#: Rows whose regressors are in memory at a time.
CHUNK = 4096


def moves_masses(machine: Machine, actuation: Literal["force", "servo"] = "force") -> bool:
    """Whether axes of an actuation move links whose masses the URDF gives: their forces include inverse dynamics then."""
    kinematics = machine.kinematics()
    if kinematics is None or not any(axis.actuation == actuation and axis.drives == "joint" for axis in machine.axes):
        return False
    return has_masses(kinematics)


@dataclass(frozen=True)
class Tip:
    """The body that carries the tip, and the tip's pose in the frame of its joint: ``rotation`` (3, 3), ``place`` (3,) [m]."""

    body: int
    rotation: Array
    place: Array


class RigidBody:
    """The links of a machine as rigid bodies.

    Args:
        kinematics: of the chain; ``urdf``: its text, with masses.

    Attributes:
        names: joint of each body, in the order of the library.
        body_of: for each axis the body that its joint moves, (A,).
        nominal: inertial parameters of the bodies in the URDF, (B, 10).
        tip: the body that carries the tip.

    Raises:
        SettingsError: Pinocchio is not installed.
    """

    def __init__(self, kinematics: Kinematics, urdf: str) -> None:
        pin = _pinocchio()
        text, links, joints = _bare(urdf)
        self._model = pin.buildModelFromXML(text)
        self._model.gravity.linear = np.array([0.0, 0.0, -kinematics.gravity])
        self._data = self._model.createData()
        self.names: tuple[str, ...] = tuple(joints[int(name.removeprefix("joint_"))] for name in list(self._model.names)[1:])
        self.body_of = np.array([self.names.index(name) for name in kinematics.actuated])
        self.nominal: Array = np.array([self._model.inertias[k + 1].toDynamicParameters() for k in range(len(self.names))])
        # Value of each joint of the library: gain · axis + offset; joints that no axis moves rest at zero.
        self._gain, self._offset = np.zeros((len(self.names), len(kinematics.actuated))), np.zeros(len(self.names))
        for name, drive in kinematics.drives.items():
            row = self.names.index(name)
            self._gain[row, drive.column], self._offset[row] = drive.ratio, drive.offset
        frame = self._model.frames[self._model.getFrameId(f"link_{links.index(kinematics.tip)}")]
        self.tip = Tip(int(frame.parentJoint) - 1, np.array(frame.placement.rotation), np.array(frame.placement.translation))

    @property
    def bodies(self) -> int:
        return len(self.names)

    def regressor(self, q: Array, v: Array, a: Array) -> Array:
        """Torque of each axis per unit of each inertial parameter, (n, A, B · 10).

        Args:
            q, v, a: positions, speeds and accelerations of the axes, (n, A) each [rad or m, and per s, s²].
        """
        compute, model, data = _pinocchio().computeJointTorqueRegressor, self._model, self._data
        gain = self._gain
        places, speeds, rates = q @ gain.T + self._offset, v @ gain.T, a @ gain.T
        out = np.empty((len(q), gain.shape[1], PARAMETERS * self.bodies))
        direct = np.array_equal(gain, np.eye(len(gain)))
        for k in range(len(q)):
            found = compute(model, data, places[k], speeds[k], rates[k])
            out[k] = found if direct else gain.T @ found
        return out

    def torque(self, q: Array, v: Array, a: Array, parameters: Array) -> Array:
        """Torques for a motion, each (n, A) → (n, A) [N·m or N].

        Args:
            parameters: of the bodies, (B, 10); need not be physically consistent.
        """
        parts = (slice(k, k + CHUNK) for k in range(0, len(q), CHUNK))
        return np.concatenate([self.regressor(q[s], v[s], a[s]) @ parameters.ravel() for s in parts])


def rigid_body(machine: Machine) -> RigidBody | None:
    """The rigid bodies of a machine whose force axes move masses; None without.

    Raises:
        SettingsError: Pinocchio is not installed.
    """
    if not moves_masses(machine):
        return None
    kinematics = machine.kinematics()
    assert kinematics is not None
    assert machine.urdf_text is not None
    return _known(kinematics.actuated, kinematics.tip, machine.urdf_text, machine.gravity)


def point_mass(mass: float, first_moment: Array) -> Array:
    """Inertial parameters (10,) of a mass with a first moment (3,) about an origin, without inertia about its own centre."""
    x, y, z = first_moment
    square = np.array([y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
    return np.concatenate([[mass], first_moment, square / mass if mass > 0.0 else np.zeros(6)])


@functools.lru_cache(maxsize=16)
def _known(joints: tuple[str, ...], tip: str, urdf: str, gravity: float) -> RigidBody:
    return RigidBody(Kinematics.from_urdf(urdf, joints, tip, gravity=gravity), urdf)


def _bare(urdf: str) -> tuple[str, list[str], list[str]]:
    """(URDF, links, joints): links with their inertias and joints without limits, shapes and passive coupling.

    Names become numbers, since the library has reserved ones and one table for links and joints. A continuous joint is written
    as a revolute one, which has one coordinate in the library instead of two, and what no axis can move as fixed.
    """
    root, bare = urdf_tree(urdf), Element("robot", {"name": "bare"})
    links = [link.get("name", "") for link in root.findall("link")]
    joints = [joint.get("name", "") for joint in root.findall("joint")]
    number = {name: f"link_{k}" for k, name in enumerate(links)}
    for name, link in zip(links, root.findall("link"), strict=True):
        own = SubElement(bare, "link", {"name": number[name]})
        if link.find("inertial/mass") is not None:
            inertial = SubElement(own, "inertial")
            for key, default in (("origin", {}), ("mass", {"value": "0"}), ("inertia", dict.fromkeys(MOMENTS, "0"))):
                found = link.find(f"inertial/{key}")
                SubElement(inertial, key, default | (dict(found.attrib) if found is not None else {}))
    for k, joint in enumerate(root.findall("joint")):
        kind = {"continuous": "revolute", "revolute": "revolute", "prismatic": "prismatic"}.get(joint.get("type", ""), "fixed")
        own = SubElement(bare, "joint", {"name": f"joint_{k:04d}", "type": kind})
        for key in ("parent", "child"):
            SubElement(own, key, {"link": number[str(joint.find(key).get("link"))]})  # type: ignore[union-attr]
        for key in ("origin", "axis"):
            for part in joint.findall(key):
                SubElement(own, key, dict(part.attrib))
        if kind != "fixed":
            SubElement(own, "limit", dict.fromkeys(("upper", "velocity", "effort"), "1e9") | {"lower": "-1e9"})
    return tostring(bare, encoding="unicode"), links, joints


def _pinocchio() -> Any:
    try:
        import pinocchio
    except ImportError:
        raise SettingsError(
            "inverse dynamics of the links", "Pinocchio is not installed", "the extra", install_remedy("pinocchio")
        ) from None
    return pinocchio
