"""Calibration model of a URDF: its geometric and elastic parameters, measured points for any values, and the Jacobians.

At every moving joint the frame of its origin is displaced by a small translation and rotation, tilts under the gravity moment
across its axis, and turns by its reading less its deflection under load; measured points have offsets on their links::

    point = F · Π_j origin_j · Exp(δ_j) · Exp(Σ_d ℓ_jd·M_jd·d) · motion_j(r_j·((1 + scale)·q − compliance·L) + z_j) · (p₀ + p)

d are the two directions across the axis, M_jd the gravity moments about them, L the gravity load on the axis (above zero where
it opposes positive motion), r and z ratio and offset of a passive joint, else 1 and 0, and F the frame of the measurement.
Loads follow from the URDF's masses at the deflected pose. Six displacements per joint describe any other geometry. They are
redundant: a prior keeps non-identifiable combinations near zero, and :mod:`sysid.networks.calibration` reports them.

Source: complete and redundant calibration models: Hollerbach, Khalil, Gautier, Springer Handbook of Robotics, ch. 8 (2016);
elastic ones: Khalil and Besnard, IEEE Trans. Robot. Autom. 18 (2002), 915–922.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy

from sysid.machine.kinematics import GRAVITY, Kinematics, rotation_by
from sysid.networks import calibrated_chain as sizes
from sysid.networks.calibrated_chain import (
    ElasticChain,
    ElasticJoint,
    FoldedChain,
    FoldedJoint,
    GeometryParameter,
    MovingJoint,
    cross,
    exps,
    left_jacobian,
    moving_joints,
    point_on,
)

Array = npt.NDArray[np.float64]

#: Poses over the joints' ranges at which the largest loads are looked up.
_REACH = 256
#: Steps of the deflected pose; a step changes loads by the deflection, so that the error falls by a hundred each.
_SETTLING = 4


@dataclass(frozen=True)
class _Frames:
    """Orientation of every origin before and after its displacement and after its tilt, its position, the frames that the
    joints move (the first is the base's), and the points, (n, points, 3)."""

    before: list[Array]
    displaced: list[Array]
    tilted: list[Array]
    origins: list[Array]
    moved: list[tuple[Array, Array]]
    points: Array


@dataclass(frozen=True)
class Geometry:
    """The parameters of a chain, and measured points as a function of them.

    Args:
        markers: name → link of the chain that carries it, of points that are measured beside the tip.
        frame: pose of the base in the frame of the measurement, (4, 4).
        offsets: of tip and markers on their links beyond the URDF, (points, 3) [m]; zero if None.
    """

    kinematics: Kinematics
    markers: dict[str, str] = field(default_factory=dict)
    frame: Array = field(default_factory=lambda: np.eye(4))
    offsets: Array | None = None

    @cached_property
    def chain(self) -> tuple[MovingJoint, ...]:
        return moving_joints(self.kinematics)

    @cached_property
    def parameters(self) -> tuple[GeometryParameter, ...]:
        """From base to tip: six per joint and the scale of an axis, three of the tip and of each marker; then the compliance of
        each axis and two lateral ones of each joint."""
        found, elastic = [], []
        compliances, lateral = self._compliance_priors
        for number, moved in enumerate(self.chain):
            name = moved.joint.name
            for part, (letter, unit) in enumerate(moved.names):
                prior = sizes.PRIOR_ANGLE if unit == "rad" else sizes.PRIOR_LENGTH
                found.append(GeometryParameter(f"{name}.{letter}", unit, prior, "displacement", number, part))
            if not moved.passive:
                found.append(GeometryParameter(f"{name}.scale", "1", sizes.PRIOR_SCALE, "scale", number))
                unit = "m/N" if moved.joint.prismatic else "rad/(N·m)"
                elastic.append(GeometryParameter(f"{name}.compliance", unit, compliances[number], "compliance", number))
            for part in moved.across:
                key = f"{name}.lateral_{moved.letter(part)}"
                elastic.append(GeometryParameter(key, "rad/(N·m)", lateral, "lateral", number, part))
        for point, name in enumerate(("tip", *self.markers)):
            prior = sizes.PRIOR_MARKER if point else sizes.PRIOR_LENGTH
            places = enumerate("xyz")
            found += [GeometryParameter(f"{name}.{letter}", "m", prior, "point", -1, part, point) for part, letter in places]
        return (*found, *elastic)

    @cached_property
    def priors(self) -> Array:
        return np.array([parameter.prior for parameter in self.parameters])

    @cached_property
    def optional(self) -> npt.NDArray[np.bool_]:
        """Which parameters are compared with a model that lacks them, (P,)."""
        return np.array([parameter.optional for parameter in self.parameters])

    @cached_property
    def elastic(self) -> npt.NDArray[np.bool_]:
        """Which parameters are compliances, (P,)."""
        return np.array([parameter.kind in ("compliance", "lateral") for parameter in self.parameters])

    def tip(self, q: Array, values: Array) -> Array:
        """Tip in the frame of the measurement, (n, 3) [m], at joint values ``q`` (n, n_axes) with the parameters (P,)."""
        return self.points(q, values)[:, 0]

    def points(self, q: Array, values: Array) -> Array:
        """Tip and markers, (n, points, 3) [m]."""
        return self.points_at(q, values, self.loads(q, values))

    @property
    def offsets_of_points(self) -> Array:
        return np.zeros((1 + len(self.markers), 3)) if self.offsets is None else self.offsets

    def point_frames(self, q: Array) -> tuple[Array, Array]:
        """Nominal orientations (n, points, 3, 3) and positions (n, points, 3) of tip and markers."""
        nothing = np.zeros(self._elastic.stop)
        frames = self._frames(q, nothing, np.zeros((len(q), len(self.chain), 3)))
        turns = [frames.moved[after + 1][0] @ pose[:3, :3] for after, pose in self._places]
        return np.stack(turns, axis=1), frames.points

    def points_at(self, q: Array, values: Array, loads: Array) -> Array:
        """:meth:`points` at given loads."""
        return self._frames(q, values, loads).points

    def loads(self, q: Array, values: Array) -> Array:
        """Gravity loads at the deflected pose, (n, joints, 3): in the direction of each joint's axis and about the two across.

        The first is above zero where gravity opposes positive motion, passive joints included, and zero of a passive joint; the
        others are moments about the directions.
        """
        loads = np.zeros((len(q), len(self.chain), 3))
        for _ in range(_SETTLING if np.any(values[self._elastic]) else 1):
            loads = self._loads_of(self._frames(q, values, loads))
        return loads

    def folded(self, values: Array) -> FoldedChain | None:
        """The chain with the constant parameters ``values`` (P,), whose ``tip`` is many times faster than :meth:`tip`; None
        where joints deflect."""
        if np.any(values[self._elastic]):
            return None
        joints = []
        for number, moved in enumerate(self.chain):
            start = self.frame @ moved.before if number == 0 else moved.before
            base = start[:3, :3]
            own = values[self._displaced[number]]
            rotation = base @ rotation_by(own[3:] @ moved.directions)
            shift = start[:3, 3] + base @ (own[:3] @ moved.directions)
            ratio, offset = moved.drive.ratio * (1.0 + self._scale(values, number)), moved.drive.offset
            joints.append(
                FoldedJoint.of(moved.drive.column, ratio, offset, moved.joint.prismatic, moved.joint.axis, rotation, shift)
            )
        pose = self._places[0][1]
        return FoldedChain(tuple(joints), (pose[:3, 3] + pose[:3, :3] @ values[self._point[0]])[:, None])

    def elastic_chain(self, values: Array) -> ElasticChain:
        """The chain with the constant parameters ``values`` (P,)."""
        joints = []
        for number, moved in enumerate(self.chain):
            base, own = moved.before[:3, :3], values[self._displaced[number]]
            master = self._axis_joint[moved.drive.column]
            joints.append(
                ElasticJoint(
                    turn=base @ rotation_by(own[3:] @ moved.directions),
                    shift=moved.before[:3, 3] + base @ (own[:3] @ moved.directions),
                    axis=np.asarray(moved.joint.axis, dtype=np.float64),
                    prismatic=moved.joint.prismatic,
                    column=moved.drive.column,
                    ratio=moved.drive.ratio,
                    scale=self._scale(values, number),
                    offset=moved.drive.offset,
                    master=master,
                    compliance=0.0 if master is None else float(values[self._compliances[master]]),
                    across=moved.directions[list(moved.across)],
                    lateral=values[self._laterals[number]],
                    mass=moved.mass,
                    centre=np.asarray(moved.centre, dtype=np.float64),
                )
            )
        after, pose = self._places[0]
        point = pose[:3, 3] + pose[:3, :3] @ values[self._point[0]]
        return ElasticChain(tuple(joints), self.frame, after, point, _SETTLING if np.any(values[self._elastic]) else 0)

    def slopes(self, q: Array, values: Array) -> Array:
        """Derivatives of the tip with respect to the parameters, (n, 3, P), at constant loads."""
        return self.point_slopes(q, values, self.loads(q, values))[:, 0]

    def point_slopes(self, q: Array, values: Array, loads: Array) -> Array:
        """Derivatives of tip and markers with respect to the parameters, (n, points, 3, P), at constant loads."""
        frames = self._frames(q, values, loads)
        slopes = np.zeros((len(q), len(self._places), 3, len(values)))
        for point, (after, pose) in enumerate(self._places):
            rotation = frames.moved[after + 1][0] @ pose[:3, :3]
            slopes[:, point, :, self._point[point]] = rotation
            for number in range(after + 1):
                self._joint_slopes(slopes[:, point], q, values, loads, frames, number, frames.points[:, point])
        return slopes

    def joint_slopes(self, q: Array, values: Array, loads: Array) -> Array:
        """Derivatives of tip and markers with respect to the joint values, (n, points, 3, n_axes), at constant loads."""
        frames = self._frames(q, values, loads)
        slopes = np.zeros((len(q), len(self._places), 3, q.shape[1]))
        for point, (after, _) in enumerate(self._places):
            for number in range(after + 1):
                drive = self.chain[number].drive
                ratio = drive.ratio * (1.0 + self._scale(values, number))
                slopes[:, point, :, drive.column] += self._motion_slope(frames, number, frames.points[:, point]) * ratio
        return slopes

    def _joint_slopes(
        self, slopes: Array, q: Array, values: Array, loads: Array, frames: _Frames, number: int, point: Array
    ) -> None:
        """Write the derivatives of a point (n, 3) with respect to the parameters of one joint into ``slopes`` (n, 3, P)."""
        moved = self.chain[number]
        before, displaced = frames.before[number], frames.displaced[number]
        first = self._displaced[number].start
        turned = values[first + 3 : first + 6] @ moved.directions
        lever = point - frames.origins[number]
        # d Exp(r)y = (J_l(r) dr) × Exp(r)y, with y the point as seen from the displaced frame.
        bent = left_jacobian(turned)
        for part, direction in enumerate(moved.directions):
            slopes[:, :, first + part] = before @ direction
            slopes[:, :, first + 3 + part] = cross(before @ (bent @ direction), lever)
        motion = self._motion_slope(frames, number, point) * moved.drive.ratio
        master = self._axis_joint[moved.drive.column]
        if master is not None:
            slopes[:, :, self._scales[master]] += motion * q[:, moved.drive.column, None]
            slopes[:, :, self._compliances[master]] -= motion * loads[:, master, :1]
        tilt = self._tilt(values, loads, number)
        for k, part in enumerate(moved.across):
            direction = moved.directions[part]
            about = np.broadcast_to(direction, tilt.shape) + 0.5 * cross(tilt, direction)  # J_l to first order of the tilt
            turn = np.einsum("nij,nj->ni", displaced, about) * loads[:, number, 1 + k, None]
            slopes[:, :, self._laterals[number].start + k] = cross(turn, lever)

    def _motion_slope(self, frames: _Frames, number: int, point: Array) -> Array:
        """Derivative of a point with respect to a joint's motion, (n, 3)."""
        axis = frames.tilted[number] @ self.chain[number].joint.axis
        if self.chain[number].joint.prismatic:
            return np.asarray(axis)
        return cross(axis, point - frames.origins[number])

    def _scale(self, values: Array, number: int) -> float:
        """Scale error of the reading that moves a joint."""
        master = self._axis_joint[self.chain[number].drive.column]
        return 0.0 if master is None else float(values[self._scales[master]])

    def _tilt(self, values: Array, loads: Array, number: int) -> Array:
        """Rotation vector of the lateral deflection in the displaced frame, (n, 3)."""
        moved = self.chain[number]
        across = moved.directions[list(moved.across)]
        return np.asarray((loads[:, number, 1:] * values[self._laterals[number]]) @ across)

    def _frames(self, q: Array, values: Array, loads: Array) -> _Frames:
        count = len(q)
        rotation, position = np.tile(self.frame[:3, :3], (count, 1, 1)), np.tile(self.frame[:3, 3], (count, 1))
        moved_frames = [(rotation, position)]
        before, displaced, tilted, origins = [], [], [], []
        for number, moved in enumerate(self.chain):
            own = values[self._displaced[number]]
            base = rotation @ moved.before[:3, :3]
            position = position + rotation @ moved.before[:3, 3] + base @ (own[:3] @ moved.directions)
            turned = rotation = base @ rotation_by(own[3:] @ moved.directions)
            if np.any(values[self._laterals[number]]):
                rotation = turned @ exps(self._tilt(values, loads, number))
            before.append(base)
            displaced.append(turned)
            tilted.append(rotation)
            origins.append(position)
            motion = moved.joint.motion(self._motion(q, values, loads, number))
            position = position + np.einsum("nij,nj->ni", rotation, motion[:, :3, 3])
            rotation = rotation @ motion[:, :3, :3]
            moved_frames.append((rotation, position))
        points = np.empty((count, len(self._places), 3))
        for point, (after, pose) in enumerate(self._places):
            turn, at = moved_frames[after + 1]
            points[:, point] = at + turn @ (pose[:3, 3] + pose[:3, :3] @ values[self._point[point]])
        return _Frames(before, displaced, tilted, origins, moved_frames, points)

    def _motion(self, q: Array, values: Array, loads: Array, number: int) -> Array:
        """Value of a joint: its axis's reading, corrected and deflected, times its ratio, plus its offset, (n,)."""
        drive = self.chain[number].drive
        value = q[:, drive.column] * (1.0 + self._scale(values, number))
        master = self._axis_joint[drive.column]
        if master is not None and values[self._compliances[master]] != 0.0:
            value = value - values[self._compliances[master]] * loads[:, master, 0]
        return value if drive.ratio == 1.0 and drive.offset == 0.0 else drive.ratio * value + drive.offset

    def _loads_of(self, frames: _Frames) -> Array:
        """Loads of a pose, (n, joints, 3): suffix sums of mass and first moment from the tip to the base."""
        count = len(frames.points)
        loads = np.zeros((count, len(self.chain), 3))
        down = -GRAVITY * self.frame[:3, 2]  # the base stands upright
        mass, first = 0.0, np.zeros((count, 3))
        for number in range(len(self.chain) - 1, -1, -1):
            moved = self.chain[number]
            rotation, position = frames.moved[number + 1]
            mass += moved.mass
            first = first + moved.mass * (position + rotation @ moved.centre)
            moment = cross(first - mass * frames.origins[number], down)
            turned = frames.tilted[number]
            axis = turned @ moved.joint.axis
            own = -mass * axis @ down if moved.joint.prismatic else -np.einsum("nj,nj->n", axis, moment)
            master = self._axis_joint[moved.drive.column]
            if master is not None:
                loads[:, master, 0] += moved.drive.ratio * own
            for k, part in enumerate(moved.across):
                loads[:, number, 1 + k] = np.einsum("nj,nj->n", turned @ moved.directions[part], moment)
        return loads

    @cached_property
    def _compliance_priors(self) -> tuple[Array, float]:
        """Prior standard deviations of the compliance of each joint, (joints,), and of lateral compliance."""
        count = len(self.kinematics.actuated)
        ends = np.array([self.kinematics.limits(name) for name in self.kinematics.actuated]).reshape(-1, 2)
        low, high = np.where(np.isfinite(ends[:, 0]), ends[:, 0], -np.pi), np.where(np.isfinite(ends[:, 1]), ends[:, 1], np.pi)
        q = low + (high - low) * scipy.stats.qmc.Halton(max(count, 1), scramble=False).random(_REACH)[:, :count]
        bare = np.zeros((_REACH, len(self.chain), 3))
        largest = np.abs(self._loads_of(self._frames(q, np.zeros(self._elastic.stop), bare))).max(axis=0, initial=0.0)
        priors = np.zeros(len(self.chain))
        for slide, deflection in ((False, sizes.PRIOR_DEFLECTION), (True, sizes.PRIOR_SLIDE_DEFLECTION)):
            same = np.array([moved.joint.prismatic == slide for moved in self.chain], dtype=bool)
            most = max(float(largest[same, 0].max(initial=0.0)), 1e-9)
            priors[same] = deflection / np.maximum(largest[same, 0], most / sizes.SOFTEST)
        return priors, sizes.PRIOR_LATERAL / max(float(largest[:, 1:].max(initial=0.0)), 1e-9)

    @cached_property
    def _places(self) -> tuple[tuple[int, Array], ...]:
        """Tip and markers: the moving joint before each, and the pose of its link in the frame which that joint moves."""
        found = []
        for link, offset in zip((self.kinematics.tip, *self.markers.values()), self.offsets_of_points, strict=True):
            after, pose = point_on(self.kinematics, link)
            pose = pose.copy()
            pose[:3, 3] += pose[:3, :3] @ offset
            found.append((after, pose))
        return tuple(found)

    # Indices of the parameters, in the order of ``parameters``.

    @cached_property
    def _displaced(self) -> tuple[slice, ...]:
        """The six displacements of each joint."""
        starts = np.cumsum([0, *(6 if moved.passive else 7 for moved in self.chain)])
        return tuple(slice(int(start), int(start) + 6) for start in starts[:-1])

    @cached_property
    def _scales(self) -> tuple[int, ...]:
        """Of the scale of each joint; of a passive joint meaningless."""
        return tuple(part.stop for part in self._displaced)

    @cached_property
    def _point(self) -> tuple[slice, ...]:
        first = sum(6 if moved.passive else 7 for moved in self.chain)
        return tuple(slice(first + 3 * point, first + 3 * point + 3) for point in range(len(self._places)))

    @cached_property
    def _elastic(self) -> slice:
        return slice(self._point[-1].stop, self._point[-1].stop + sum(2 if m.passive else 3 for m in self.chain))

    @cached_property
    def _compliances(self) -> tuple[int, ...]:
        """Of the compliance of each joint; of a passive joint meaningless."""
        starts = np.cumsum([self._elastic.start, *(2 if moved.passive else 3 for moved in self.chain)])
        return tuple(int(start) for start in starts[:-1])

    @cached_property
    def _laterals(self) -> tuple[slice, ...]:
        firsts = (first + (0 if moved.passive else 1) for first, moved in zip(self._compliances, self.chain, strict=True))
        return tuple(slice(first, first + 2) for first in firsts)

    @cached_property
    def _axis_joint(self) -> tuple[int | None, ...]:
        """Column of the joint values → number of the axis's own joint in the chain; None where it only has passive ones."""
        own = {moved.drive.column: number for number, moved in enumerate(self.chain) if not moved.passive}
        return tuple(own.get(column) for column in range(len(self.kinematics.actuated)))
