"""Torques of the links on the force axes of an arm at measured motion, by inverse dynamics.

The inertial parameters of the bodies are those of the URDF, changed by the effects ``link_mass_error``, ``inertial_error`` and
``payload``; torques are linear in them (:mod:`sysid.machine.rigid_body`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.machine.rigid_body import PARAMETERS, RigidBody, point_mass
from sysid.plant.layout import AT, AXIS_WIDTH
from sysid.plant.smooth_motion import smooth_motion
from sysid.signals import axis_signal

if TYPE_CHECKING:
    from sysid.plant.model import Model

Array = npt.NDArray[np.float64]

#: Places of a motion in a recording's cache, and of the torques of the last parameters.
_MOTION, _TORQUE = "link motion", "link torque"


def link_motion(model: Model, recording: Recording) -> tuple[Array, Array, Array] | None:
    """Low-passed positions, speeds and accelerations of all axes, each (n, A); None where a joint is not measured."""
    if _MOTION not in recording.derived:
        joints = [recording.values(axis_signal(name, "joint")) for name in model.machine.axis_names]
        found = None
        if all(np.count_nonzero(~np.isnan(joint)) > 1 for joint in joints):
            parts = [smooth_motion(joint, recording.rate_hz) for joint in joints]
            found = tuple(np.column_stack(columns) for columns in zip(*parts, strict=True))
        recording.derived[_MOTION] = found
    motion: tuple[Array, Array, Array] | None = recording.derived[_MOTION]
    return motion


@dataclass(frozen=True)
class LinkTorque:
    """Torques on an axis at measured motion, (n,) each [N·m or N].

    Args:
        carried: of the links, by the transmission.
        rotor: of an inertia of the rotor beside that of machine.toml, which is ahead of the transmission.
        constant: torque of the drive over its command.
    """

    carried: Array
    rotor: Array
    constant: float = 1.0

    @property
    def whole(self) -> Array:
        return self.carried + self.rotor

    @property
    def commanded(self) -> Array:
        """Part of the command that makes these torques."""
        return self.whole / self.constant


def link_torque(model: Model, theta: Array, recording: Recording, axis: str) -> LinkTorque:
    """Torques of the links and of the rotor on an axis; zero without masses, or where a joint is not measured."""
    if model.rigid is None:
        return LinkTorque(*np.zeros((2, len(recording))))
    i = model.axis_index(axis)
    parameters, (rotors, scales) = inertial_parameters(model, theta), rotors_and_scales(model, theta)
    key = (parameters.tobytes(), rotors.tobytes(), scales.tobytes())
    known: tuple[tuple[bytes, ...], Array, Array] | None = recording.derived.get(_TORQUE)
    if known is None or known[0] != key:
        motion = link_motion(model, recording)
        carried, rotor = np.zeros((2, len(recording), model.axes))
        if motion is not None:
            carried, rotor = model.rigid.torque(*motion, parameters) * scales, motion[2] * rotors
        known = recording.derived[_TORQUE] = (key, np.ascontiguousarray(carried.T), np.ascontiguousarray(rotor.T))
    return LinkTorque(known[1][i], known[2][i], float(force_constants(model, theta)[i]))


def static_torque(model: Model, theta: Array, joints: Array) -> Array:
    """Torques of the links at rest, joints (n, A) → (n, A) [N·m or N]."""
    assert model.rigid is not None
    rest = np.zeros_like(joints)
    scales = rotors_and_scales(model, theta)[1]
    return model.rigid.torque(joints, rest, rest, inertial_parameters(model, theta)) * scales


def inertial_parameters(model: Model, theta: Array) -> Array:
    """Inertial parameters of the bodies of a plant, (B, 10) (:mod:`sysid.machine.rigid_body`)."""
    rigid = model.rigid
    assert rigid is not None
    found = rigid.nominal.copy()
    for i, body in enumerate(rigid.body_of):
        at = i * AXIS_WIDTH
        found[body] = found[body] * theta[at + AT.link_mass_error]
        first = at + AT.inertial_error
        found[body] += theta[first : first + PARAMETERS]
    first = model.arrays.tool + AT.payload
    mass, centre = float(theta[first]), theta[first + 1 : first + 4]
    if mass > 0.0:
        found[rigid.tip.body] += payload_parameters(rigid, mass, mass * centre)
    return found


def rotors_and_scales(model: Model, theta: Array) -> tuple[Array, Array]:
    """Inertia of each rotor beside that of machine.toml [kg·m²], and measured over true force of the links, (A,) each."""
    places = np.arange(model.axes) * AXIS_WIDTH + AT.inertial_error + PARAMETERS
    return theta[places], theta[places + 1]


def force_constants(model: Model, theta: Array) -> Array:
    """Force of each axis over its command, (A,)."""
    return np.asarray(theta[np.arange(model.axes) * AXIS_WIDTH + AT.force_constant_error])


def payload_parameters(rigid: RigidBody, mass: float, first_moment: Array) -> Array:
    """Inertial parameters (10,) of a point mass in the frame of the joint that carries the tip.

    Args:
        first_moment: in the frame of the tip, (3,) [kg·m].
    """
    return point_mass(mass, rigid.tip.rotation @ first_moment + mass * rigid.tip.place)
