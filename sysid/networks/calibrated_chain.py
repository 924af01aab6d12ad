"""A chain as a calibration sees it: its moving joints, with fixed transforms merged, axes and the directions of displacements;
its forward kinematics with a constant geometry; and its constants where joints deflect under load, for programs that evaluate
it without Python.

With a constant geometry, constant transforms are multiplied in advance. From the tip to the base, with the constant rotation R
and translation t before joint j, its axis k and reading θ::

    p ← t + R·(k kᵀ + cos θ·(I − k kᵀ) + sin θ·[k]×)·p        revolute
    p ← t + R·(p + θ·k)                                        prismatic

Parameters of a calibration model: their names, units and prior standard deviations, in the order of a vector.

Priors are Gaussian about the URDF. Sizes, and where they come from:

- displacement of a joint's origin 20 mm and 2°, zero of a joint 2°: an order of magnitude above a manufactured arm's errors
  (0.5 to 3 mm and 0.2 to 1°, machine facts), so that they bound and do not decide;
- scale of a reading 2 %: an encoder counts whole turns, so that a scale error is a wrong gear ratio or a stretched wire;
- deflection 10 mrad (10 mm of a slide) at the largest gravity load of the arm: 0.25° was computed for a crane (machine facts);
  a lightly loaded joint may be up to :data:`SOFTEST` times as soft as the most loaded one;
- lateral deflection 3 mrad at the largest lateral moment of the arm: bearings are several times stiffer across the axis than a
  drive about it;
- place of a marker on its link 0.3 m: the size of a link.

Sources: elastic and geometric parameters together: Khalil and Besnard, IEEE Trans. Robot. Autom. 18 (2002), 915–922; Nubiola
and Bonev, Robot. Comput.-Integr. Manuf. 29 (2013), 236–245; taxonomy of calibration models: Hollerbach and Wampler, Int. J.
Robot. Res. 15 (1996), 573–591.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from sysid.machine.kinematics import Drive, Joint, Kinematics, cross_matrix
from sysid.machine.moved_bodies import moved_bodies

Array = npt.NDArray[np.float64]

Kind = Literal["displacement", "scale", "point", "compliance", "lateral"]

#: Prior standard deviations: m, rad, and a share.
PRIOR_LENGTH, PRIOR_ANGLE, PRIOR_SCALE = 0.02, 0.035, 0.02
#: Deflection at the largest load of the arm, of a revolute joint [rad] and of a prismatic one [m]; across the axis [rad].
PRIOR_DEFLECTION, PRIOR_SLIDE_DEFLECTION, PRIOR_LATERAL = 0.01, 0.01, 0.003
#: Place of a marker on its link [m].
PRIOR_MARKER = 0.3
#: Largest ratio of the prior compliances of two joints of an arm.
SOFTEST = 10.0

#: Parameters that are compared with a model that lacks them; the others are always estimated.
OPTIONAL: frozenset[Kind] = frozenset({"scale", "compliance", "lateral"})


@dataclass(frozen=True)
class GeometryParameter:
    """One parameter of a geometry; zero is the value of the URDF.

    Args:
        key: ``boom_joint.x`` and ``boom_joint.rx`` (translation and rotation of its origin, in the origin's frame), ``.offset``
            (along or about the joint's own axis: its zero), ``.scale`` (of its reading), ``.compliance`` (about or along its
            axis under its gravity load), ``.lateral_x`` (tilt about an axis across the joint's under the gravity moment about
            that axis), ``tip.x`` (in the tip's frame), ``<marker>.x`` (in the frame of the marker's link).
        unit: m, rad, 1, rad/(N·m) or m/N.
        prior: standard deviation of the prior.
        kind: what it describes.
        joint: number in the chain of moving joints; −1 of a point.
        part: which of the joint's six displacements or two lateral axes, or which coordinate of the point.
        point: number of the point; −1 of a joint.
    """

    key: str
    unit: str
    prior: float
    kind: Kind = "displacement"
    joint: int = -1
    part: int = 0
    point: int = -1

    @property
    def optional(self) -> bool:
        return self.kind in OPTIONAL


@dataclass(frozen=True)
class MovingJoint:
    """A joint that an axis moves, itself or as a passive (mimic) joint.

    Args:
        joint: without its origin.
        drive: the axis that moves it.
        passive: whether it follows that axis's own joint.
        before: constant transform from the previous moving joint to this one's origin, (4, 4).
        directions: of translations and rotations, rows in the frame of the origin, (3, 3).
        names: name and unit of the six displacements.
        own: which of the directions is the joint's axis.
        mass, centre: of all that it moves and no further joint, in the frame that it moves [kg], (3,) [m].
    """

    joint: Joint
    drive: Drive
    passive: bool
    before: Array
    directions: Array
    names: tuple[tuple[str, str], ...]
    own: int
    mass: float
    centre: Array

    @property
    def across(self) -> tuple[int, int]:
        """The two directions across the joint's axis."""
        first, second = (part for part in range(3) if part != self.own)
        return first, second

    def letter(self, part: int) -> str:
        """``x`` … of a direction across the axis."""
        return self.names[3 + part][0].removeprefix("r")


def moving_joints(kinematics: Kinematics) -> tuple[MovingJoint, ...]:
    """From base to tip."""
    before, found = np.eye(4), []
    bodies = iter(moved_bodies(kinematics))
    for joint in kinematics.chain:
        before = before @ joint.origin
        drive = kinematics.drives.get(joint.name)
        if drive is not None:
            body = next(bodies)
            directions, names, own = _displacements(joint)
            bare = replace(joint, origin=np.eye(4))
            passive = joint.name not in kinematics.actuated
            found.append(MovingJoint(bare, drive, passive, before, directions, names, own, body.mass, body.centre))
            before = np.eye(4)
    return tuple(found)


def point_on(kinematics: Kinematics, link: str) -> tuple[int, Array]:
    """Number of the last moving joint before a link of the chain, −1 for a link of the base, and the pose of the link's frame
    in the frame which that joint moves, (4, 4)."""
    found = ((number, pose) for number, joint, pose in kinematics.moved_frames() if joint.child == link)
    return next(found, (-1, np.eye(4)))


def _displacements(joint: Joint) -> tuple[Array, tuple[tuple[str, str], ...], int]:
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
    return directions, tuple(names), main


def exps(rotations: Array) -> Array:
    """Rotations by rotation vectors (n, 3), (n, 3, 3) (Rodrigues)."""
    x, y, z = rotations.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    angle = np.sqrt(x * x + y * y + z * z)
    small = angle < 1e-8
    safe = np.where(small, 1.0, angle)
    sine, versine = np.where(small, 1.0, np.sin(safe) / safe), np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    return np.asarray(np.eye(3) + sine[:, None, None] * cross + versine[:, None, None] * (cross @ cross))


def left_jacobian(rotation: Array) -> Array:
    """Left Jacobian of SO(3) at a rotation vector, (3, 3)."""
    angle = float(np.linalg.norm(rotation))
    if angle < 1e-8:
        return np.eye(3)
    cross = cross_matrix(rotation)
    sine, versine = (angle - np.sin(angle)) / angle**3, (1.0 - np.cos(angle)) / angle**2
    return np.asarray(np.eye(3) + versine * cross + sine * cross @ cross)


def cross(a: Array, b: Array) -> Array:
    """Cross product over the last axis, for few vectors faster than numpy's."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    x, y, z, u, v, w = a[..., 0], a[..., 1], a[..., 2], b[..., 0], b[..., 1], b[..., 2]
    out[..., 0], out[..., 1], out[..., 2] = y * w - z * v, z * u - x * w, x * v - y * u
    return out


@dataclass(frozen=True)
class FoldedJoint:
    """One joint with the constant transform before it.

    Args:
        column: of the joint values.
        stretch, offset: factor of its reading, and what is added [rad or m].
        prismatic: whether it is a prismatic joint.
        shift: t, (3, 1).
        factors: factors of the point; revolute (9, 3): constant, cos and sin part; prismatic (3, 3): R.
        slide: R·k, (3, 1).
    """

    column: int
    stretch: float
    offset: float
    prismatic: bool
    shift: Array
    factors: Array
    slide: Array

    @staticmethod
    def of(
        column: int, stretch: float, offset: float, prismatic: bool, axis: Array, rotation: Array, shift: Array
    ) -> FoldedJoint:
        along = np.outer(axis, axis)
        parts = [rotation]
        if not prismatic:
            parts = [rotation @ along, rotation @ (np.eye(3) - along), rotation @ cross_matrix(axis)]
        return FoldedJoint(column, stretch, offset, prismatic, shift[:, None], np.vstack(parts), (rotation @ axis)[:, None])


@dataclass(frozen=True)
class FoldedChain:
    """The joints from base to tip, and the tip in the frame of the last joint, (3, 1)."""

    joints: tuple[FoldedJoint, ...]
    last: Array

    @cached_property
    def _readings(self) -> tuple[npt.NDArray[np.int64], Array, Array | None]:
        """Columns of the joint values in the order of the chain, the factors of their readings, and offsets where there are
        any."""
        columns = np.array([joint.column for joint in self.joints], dtype=np.int64)
        offsets = np.array([[joint.offset] for joint in self.joints])
        return columns, np.array([[joint.stretch] for joint in self.joints]), offsets if offsets.any() else None

    def tip(self, q: Array) -> Array:
        """Joint values (n, n_axes) → tip in the base frame, (n, 3) [m]."""
        columns, stretches, offsets = self._readings
        readings = q.take(columns, axis=1).T * stretches
        if offsets is not None:
            readings += offsets
        cosines, sines = np.cos(readings), np.sin(readings)
        point = self.last
        for k in range(len(self.joints) - 1, -1, -1):
            joint = self.joints[k]
            moved = joint.factors.dot(point)
            if joint.prismatic:
                point = joint.slide * readings[k]
                point += moved
            else:
                point = moved[3:6] * cosines[k]
                point += moved[6:] * sines[k]
                point += moved[:3]
            point += joint.shift
        return np.ascontiguousarray(point.T)


@dataclass(frozen=True)
class ElasticJoint:
    """One moving joint of a chain.

    Args:
        turn, shift: of its origin in the frame that the joint before it moves, (3, 3) and (3,) [m].
        axis: unit vector in the frame of the origin, (3,).
        column: of the joint values that move it; its motion is ``ratio``·((1 + ``scale``)·value − ``compliance``·load) +
            ``offset``.
        master: number of the joint whose load includes its own, or None.
        compliance: of its axis under the load of ``master`` [rad/(N·m) or m/N].
        across: directions of lateral deflection in the frame of the origin, (2, 3); ``lateral`` [rad/(N·m)], (2,).
        mass, centre: of all that it moves and no further joint, in the frame that it moves [kg], (3,) [m].
    """

    turn: Array
    shift: Array
    axis: Array
    prismatic: bool
    column: int
    ratio: float
    scale: float
    offset: float
    master: int | None
    compliance: float
    across: Array
    lateral: Array
    mass: float
    centre: Array


@dataclass(frozen=True)
class ElasticChain:
    """Joints from base to tip.

    Args:
        frame: pose of the base in the frame of the measurement, (4, 4).
        after: number of the joint that moves the tip; ``point``: the tip in the frame that it moves, (3,) [m].
        settling: steps from the unloaded pose to the deflected one.
    """

    joints: tuple[ElasticJoint, ...]
    frame: Array
    after: int
    point: Array
    settling: int
