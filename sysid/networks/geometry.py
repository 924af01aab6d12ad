"""Calibration model of a URDF: its geometric parameters, the tip position for any values of them, and the Jacobians.

At every actuated joint the frame of its origin is displaced by a small translation and rotation before the joint moves, the
joint's reading has a scale error, and the tip has an offset on the last link::

    tip = Π_j origin_j · Exp(δ_j) · motion_j((1 + scale_j)·q_j) · tip_offset

Six displacements per joint describe any other geometry. They are redundant: a prior keeps non-identifiable combinations near
zero, and :mod:`sysid.networks.calibration` reports them.

Source: complete and redundant calibration models: Hollerbach, Khalil, Gautier, Springer Handbook of Robotics, ch. 8 (2016).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from sysid.machine.kinematics import Joint, Kinematics, rotation_about
from sysid.networks.folded import FoldedChain, FoldedJoint

Array = npt.NDArray[np.float64]

#: Prior standard deviations of a machine's departure from its URDF: m, rad, and a share.
PRIOR_LENGTH, PRIOR_ANGLE, PRIOR_SCALE = 0.02, 0.035, 0.02


@dataclass(frozen=True)
class GeometryParameter:
    """One parameter of a geometry; zero is the value of the URDF.

    Args:
        key: ``boom_joint.x`` and ``boom_joint.rx`` (translation and rotation of its origin, in the origin's frame), ``.offset``
            (along or about the joint's own axis: its zero), ``.scale`` (of its reading), ``tip.x`` (in the tip's frame).
        unit: m, rad or 1.
        prior: standard deviation of the prior.
    """

    key: str
    unit: str
    prior: float


@dataclass(frozen=True)
class _ActuatedJoint:
    """An actuated joint.

    Args:
        joint: without its origin.
        column: of the joint values.
        before: constant transform from the previous actuated joint to this one's origin, (4, 4).
        directions: of translations and rotations, rows in the frame of the origin, (3, 3).
        names: name and unit of the six displacements.
    """

    joint: Joint
    column: int
    before: Array
    directions: Array
    names: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class _Frames:
    """Orientation of every origin before and after its displacement, its position, the orientation of the tip, the tip."""

    before: tuple[Array, ...]
    displaced: tuple[Array, ...]
    origins: tuple[Array, ...]
    last: Array
    tip: Array


@dataclass(frozen=True)
class Geometry:
    """The parameters of a chain, and the tip as a function of them."""

    kinematics: Kinematics

    @cached_property
    def parameters(self) -> tuple[GeometryParameter, ...]:
        """From base to tip: seven per joint, three of the tip."""
        found = []
        for moved in self._chain:
            for name, unit in moved.names:
                prior = PRIOR_ANGLE if unit == "rad" else PRIOR_LENGTH
                found.append(GeometryParameter(f"{moved.joint.name}.{name}", unit, prior))
            found.append(GeometryParameter(f"{moved.joint.name}.scale", "1", PRIOR_SCALE))
        return (*found, *(GeometryParameter(f"tip.{letter}", "m", PRIOR_LENGTH) for letter in "xyz"))

    @property
    def priors(self) -> Array:
        return np.array([parameter.prior for parameter in self.parameters])

    def tip(self, q: Array, values: Array) -> Array:
        """Tip in the base frame, (n, 3) [m], at joint values ``q`` (n, n_axes) with the geometry ``values`` (P,)."""
        return self._frames(q, values).tip

    def folded(self, values: Array) -> FoldedChain:
        """The chain with the constant geometry ``values`` (P,), whose ``tip`` is many times faster than :meth:`tip`."""
        joints = []
        for number, moved in enumerate(self._chain):
            own = values[7 * number : 7 * number + 7]
            base = moved.before[:3, :3]
            rotation = base @ _exp(own[3:6] @ moved.directions)
            shift = moved.before[:3, 3] + base @ (own[:3] @ moved.directions)
            stretch, joint = 1.0 + float(own[6]), moved.joint
            joints.append(FoldedJoint.of(moved.column, stretch, joint.prismatic, joint.axis, rotation, shift))
        return FoldedChain(tuple(joints), (self._to_tip[:3, 3] + self._to_tip[:3, :3] @ values[7 * len(joints) :])[:, None])

    def slopes(self, q: Array, values: Array) -> Array:
        """Derivatives of the tip with respect to the parameters, (n, 3, P)."""
        frames = self._frames(q, values)
        columns = []
        for number, moved in enumerate(self._chain):
            own = values[7 * number : 7 * number + 7]
            turned = own[3:6] @ moved.directions
            before, displaced = frames.before[number], frames.displaced[number]
            columns += [before @ direction for direction in moved.directions]
            # d Exp(r)y = (J_l(r) dr) × Exp(r)y, with y the tip as seen from the displaced frame.
            reach = np.einsum("nji,nj->ni", before, frames.tip - frames.origins[number])
            columns += [
                _rotational_velocity(before, _left_jacobian(turned) @ direction, reach) for direction in moved.directions
            ]
            columns.append(self._motion_slope(frames, number, displaced) * q[:, moved.column, None])
        columns += list(np.moveaxis(frames.last, 2, 0))
        return np.stack(columns, axis=2)

    def joint_slopes(self, q: Array, values: Array) -> Array:
        """Derivatives of the tip with respect to the joint values, (n, 3, n_axes)."""
        frames = self._frames(q, values)
        slopes = np.zeros((len(q), 3, q.shape[1]))
        for number, moved in enumerate(self._chain):
            stretch = 1.0 + values[7 * number + 6]
            slopes[:, :, moved.column] = self._motion_slope(frames, number, frames.displaced[number]) * stretch
        return slopes

    def _motion_slope(self, frames: _Frames, number: int, displaced: Array) -> Array:
        """Derivative of the tip with respect to a joint's motion, (n, 3)."""
        axis = displaced @ self._chain[number].joint.axis
        if self._chain[number].joint.prismatic:
            return np.asarray(axis)
        return np.cross(axis, frames.tip - frames.origins[number])

    def _frames(self, q: Array, values: Array) -> _Frames:
        rotation, position = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
        before, displaced, origins = [], [], []
        for number, moved in enumerate(self._chain):
            own = values[7 * number : 7 * number + 7]
            base = rotation @ moved.before[:3, :3]
            position = position + rotation @ moved.before[:3, 3] + base @ (own[:3] @ moved.directions)
            rotation = base @ _exp(own[3:6] @ moved.directions)
            before.append(base)
            displaced.append(rotation)
            origins.append(position)
            motion = moved.joint.motion(q[:, moved.column] * (1.0 + own[6]))
            position = position + np.einsum("nij,nj->ni", rotation, motion[:, :3, 3])
            rotation = rotation @ motion[:, :3, :3]
        last = rotation @ self._to_tip[:3, :3]
        tip = position + rotation @ self._to_tip[:3, 3] + last @ values[7 * len(self._chain) :]
        return _Frames(tuple(before), tuple(displaced), tuple(origins), last, tip)

    @cached_property
    def _chain(self) -> tuple[_ActuatedJoint, ...]:
        before, found = np.eye(4), []
        for joint in self.kinematics.chain:
            before = before @ joint.origin
            if joint.name in self.kinematics.actuated:
                found.append(_actuated_joint(joint, self.kinematics.actuated.index(joint.name), before))
                before = np.eye(4)
        return tuple(found)

    @cached_property
    def _to_tip(self) -> Array:
        """Constant transform from the last actuated joint to the tip, (4, 4)."""
        after = np.eye(4)
        for joint in self.kinematics.chain:
            after = np.eye(4) if joint.name in self.kinematics.actuated else after @ joint.origin
        return after


def _actuated_joint(joint: Joint, column: int, before: Array) -> _ActuatedJoint:
    """Displacements along the coordinate axes where the joint axis is one of them, else along the axis and across it."""
    main = int(np.argmax(np.abs(joint.axis)))
    if np.allclose(np.abs(joint.axis), np.eye(3)[main]):
        directions, letters = np.eye(3), "xyz"
        directions[main] = joint.axis
    else:
        across = np.cross(joint.axis, np.eye(3)[int(np.argmin(np.abs(joint.axis)))])
        across /= np.linalg.norm(across)
        directions, letters, main = np.array([across, np.cross(joint.axis, across), joint.axis]), "uvw", 2
    names = [(letter, "m") for letter in letters] + [(f"r{letter}", "rad") for letter in letters]
    own = main if joint.prismatic else 3 + main
    names[own] = ("offset", names[own][1])
    return _ActuatedJoint(replace(joint, origin=np.eye(4)), column, before, directions, tuple(names))


def _exp(rotation: Array) -> Array:
    """The rotation by a rotation vector, (3, 3)."""
    angle = float(np.linalg.norm(rotation))
    return np.asarray(rotation_about(rotation / angle, np.array([angle]))[0]) if angle > 0.0 else np.eye(3)


def _left_jacobian(rotation: Array) -> Array:
    """Left Jacobian of SO(3) at a rotation vector, (3, 3)."""
    angle = float(np.linalg.norm(rotation))
    if angle < 1e-8:
        return np.eye(3)
    x, y, z = rotation
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, versine = (angle - np.sin(angle)) / angle**3, (1.0 - np.cos(angle)) / angle**2
    return np.asarray(np.eye(3) + versine * cross + sine * cross @ cross)


def _rotational_velocity(before: Array, about: Array, reach: Array) -> Array:
    """Velocity of the tip at ``reach`` in the frame ``before`` for the angular velocity ``about`` of that frame, (n, 3)."""
    return np.asarray(np.einsum("nij,nj->ni", before, np.cross(about, reach)))
