"""Static poses as rows of a regression: coordinates of the tip, their slopes by every unknown, and small errors of the arm.

Every part of an arm is a little off: a joint axis is tilted, a link is offset across its length, an encoder is eccentric, a
link bends sideways under load. No effect of the catalogue describes these errors, each random and small; their sizes, one for
each kind, are estimated. Without them, every such error would become a zero offset or a length of some other joint.

The frame of a tracker or a capture system is arbitrary. At the described frame a linearisation has no meaning if the other is
turned by 90° or a metre away, so that the frame is fitted to the described geometry before anything else is compared: from the
closed form for points of equal weight, then with a loss that a few wrong poses do not dominate.

Sources: Hollerbach and Wampler, IJRR 15 (1996), 573–591 (complete kinematic errors of a chain); Kennedy and O'Hagan, J. R.
Statist. Soc. B 63 (2001), 425–464 (a discrepancy beside calibrated parameters); Arun, Huang, Blostein, IEEE TPAMI 9 (1987),
698–700 (registration of points).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from sysid.datasets.recording import Recording
from sysid.gap.candidates import Unknown
from sysid.gap.fit import place
from sysid.gap.problem import Problem
from sysid.machine import Kinematics
from sysid.machine.kinematics import GRAVITY
from sysid.machine.moved_bodies import moved_bodies
from sysid.plant import Model
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Poses of a block of cross-validation, and largest number of blocks.
BLOCK, BLOCKS = 4, 40
#: Steps of central differences, in the negligible change of an unknown.
STEP = 0.5
#: A pose whose error is larger than this multiple of the typical one counts less (Huber, Ann. Math. Stat. 35, 1964).
HUBER = 3.0
#: Median of the length of a standard normal vector of three components.
MEDIAN_LENGTH = 1.538
#: Kinds of error of the arm, each with a size of its own: shift of a link across its length [m], tilt of a joint's axis [rad],
#: eccentricity of an encoder [rad], and tilt by the moment that acts across the axis [rad at the largest moment].
KINDS = ("shift", "tilt", "eccentricity", "lateral deflection")
SHIFT, TILT, ECCENTRICITY, DEFLECTION = range(4)
#: An error of the arm that moves the tip by less than this share of the largest is left out.
UNSEEN = 1e-6
#: Registration: error from which its loss grows linearly, in noise floors; components (translation, rotation vector).
LINEAR, FRAME = 10.0, 6


class PoseRows:
    """The poses of recordings; a missing coordinate is a row of zeros.

    Args:
        theta: vector of the plant under test; ``floor``: noise floor of each coordinate, (3,).
    """

    def __init__(self, model: Model, problem: Problem, recordings: Sequence[Recording], theta: Array, floor: Array) -> None:
        self.problem, self.recordings, self.theta = problem, tuple(recordings), theta
        self.output = np.concatenate([problem.measured(r) for r in recordings])
        self.present = ~np.isnan(self.output - self.predicted(theta[None])[0])
        self.poses, width = self.output.shape
        self.scale = 1.0 / floor
        self.measured = int(self.present.sum())
        names = [axis_signal(name, "joint") for name in model.machine.axis_names]
        joints = np.concatenate([np.column_stack([r.values(name) for name in names]) for r in recordings])
        kinematics = model.machine.kinematics()
        assert kinematics is not None  # the stage exists only with one
        tangents, self.kind = tangents_of(kinematics, np.nan_to_num(joints))
        self.tangents = self._flat(tangents)
        self.blocks = max(1, min(BLOCKS, self.poses // BLOCK))
        self.block = np.repeat(np.arange(self.poses) * self.blocks // max(self.poses, 1), width)

    def predicted(self, thetas: Array) -> Array:
        """(lanes, poses, 3) [m]."""
        return np.concatenate([self.problem.predict(thetas, r) for r in self.recordings], axis=1)

    def residual(self, theta: Array) -> Array:
        """Residual (rows,) in noise floors."""
        return self._flat((self.output - self.predicted(theta[None])[0])[:, :, None])[:, 0]

    def linearised(self, theta: Array, unknowns: Sequence[Unknown]) -> tuple[Array, Array]:
        """Residual (rows,) and change of the output per unit of each unknown, (rows, k), both in noise floors."""
        count = len(unknowns)
        values = np.array([theta[u.places[0]] for u in unknowns])
        steps = np.array([STEP * u.negligible for u in unknowns])
        lanes = np.vstack([values[None], values + np.diag(steps), values - np.diag(steps)])
        ends = self.predicted(place(theta, unknowns, lanes))
        slopes = np.moveaxis(ends[1 : count + 1] - ends[count + 1 :], 0, 2) / (2.0 * steps)
        return self._flat((self.output - ends[0])[:, :, None])[:, 0], self._flat(slopes)

    def by_row(self, of_pose: Array) -> Array:
        """Values of poses (poses,) for their rows, (rows,)."""
        return np.repeat(of_pose, self.output.shape[1])

    def weights(self, residual: Array) -> Array:
        """Weight of each pose by the length of its residual (rows,): less than one for outliers, (poses,)."""
        length = np.linalg.norm(residual.reshape(self.poses, -1), axis=1)
        seen = length[length > 0.0]
        typical = float(np.median(seen)) / MEDIAN_LENGTH if len(seen) else 1.0
        away = length / max(typical * np.sqrt(3.0), 1e-300)
        return np.asarray(np.sqrt(np.minimum(1.0, HUBER / np.maximum(away, 1e-12))))

    def registered(self, unknowns: Sequence[Unknown], nominal: Array) -> Array:
        """Values of unknowns of the measurement with the least error of the described geometry, (k,).

        Args:
            unknowns: the six components of the frame first.
            nominal: their values in the plant under test, (k,).
        """

        def residual(values: Array) -> Array:
            return self.residual(place(self.theta, unknowns, values[None])[0])

        def slopes(values: Array) -> Array:
            return np.asarray(-self.linearised(place(self.theta, unknowns, values[None])[0], unknowns)[1])

        fits = [
            least_squares(residual, start, slopes, loss="soft_l1", f_scale=LINEAR, x_scale="jac")
            for start in (nominal, self._closed_form(unknowns, nominal))
        ]
        return np.asarray(min(fits, key=lambda fit: float(fit.cost)).x)

    def _closed_form(self, unknowns: Sequence[Unknown], nominal: Array) -> Array:
        """Nominal values with the frame by which predicted points fit measured ones best, (k,)."""
        unmoved = np.r_[np.zeros(FRAME), nominal[FRAME:]]
        predicted = self.predicted(place(self.theta, unknowns, unmoved[None]))[0]
        there = self.present.all(axis=1)
        if np.count_nonzero(there) < 3:
            return nominal
        model, measured = predicted[there], self.output[there]
        turn, _ = Rotation.align_vectors(measured - measured.mean(axis=0), model - model.mean(axis=0))
        shift = measured.mean(axis=0) - turn.apply(model.mean(axis=0))
        return np.asarray(np.r_[shift, turn.as_rotvec(), nominal[FRAME:]])

    def _flat(self, columns: Array) -> Array:
        """(poses, 3, m) [m] → (rows, m) in noise floors; zero where not measured."""
        scaled = np.where(self.present[:, :, None], columns * self.scale[None, :, None], 0.0)
        return np.ascontiguousarray(scaled.reshape(-1, columns.shape[2]))


def tangents_of(kinematics: Kinematics, joints: Array) -> tuple[Array, npt.NDArray[np.int64]]:
    """Small errors of an arm at joint values (n, A).

    Returns:
        Motion of the tip per unit of each error [m], (n, 3, p), and indices into :data:`KINDS`, (p,).
    """
    poses = kinematics.link_poses(joints)
    tip = poses[kinematics.tip][:, :3, 3]
    frames = [(j, poses[j.child]) for j in kinematics.chain if j.name in kinematics.actuated]
    origins = [frame[:, :3, 3] for _, frame in frames] + [tip]
    weights = _weights(kinematics, poses)
    moments = [_moment(weights[k:], origin) for k, origin in enumerate(origins[:-1])]
    largest = max((float(np.linalg.norm(moment, axis=1).max()) for moment in moments), default=0.0)
    found = list[tuple[int, Array]]()
    for k, (joint, frame) in enumerate(frames):
        turn, origin, reach = frame[:, :3, :3], origins[k], tip - origins[k]
        value = joints[:, kinematics.actuated.index(joint.name)]
        tilts = [turn @ axis for axis in _across(np.asarray(joint.axis))]
        link = np.einsum("nji,nj->ni", turn, origins[k + 1] - origin)  # to the next joint, in the frame that the joint moves
        aligned = float(np.ptp(link, axis=0).max()) < 1e-9 and float(np.linalg.norm(link[0])) > 1e-9
        found += [(SHIFT, turn @ axis) for axis in (_across(link[0]) if aligned else np.eye(3))]
        found += [(TILT, np.cross(tilt, reach)) for tilt in tilts]
        if not joint.prismatic:
            own = np.cross(turn @ np.asarray(joint.axis), reach)
            found += [(ECCENTRICITY, own * wave(value)[:, None]) for wave in (np.sin, np.cos)]
        for tilt in tilts:
            found.append((DEFLECTION, np.cross(tilt, reach) * np.einsum("nj,nj->n", tilt, moments[k])[:, None]))
    kind, table = np.array([kind for kind, _ in found]), np.stack([column for _, column in found], axis=2)
    table[:, :, kind == DEFLECTION] /= max(largest, 1e-12)
    size = np.sqrt((table**2).sum(axis=(0, 1)))
    kept = size > UNSEEN * max(float(size.max(initial=0.0)), 1e-300)
    return table[:, :, kept], kind[kept]


def _across(axis: Array) -> Array:
    """Two unit vectors across an axis, (2, 3)."""
    unit = axis / np.linalg.norm(axis)
    first = np.cross(unit, np.eye(3)[int(np.argmin(np.abs(unit)))])
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(unit, first)])


def _weights(kinematics: Kinematics, poses: dict[str, Array]) -> list[tuple[float, Array]]:
    """(mass [kg], its centre (n, 3)) moved by each joint of the chain that an axis moves and by no further one."""
    driven = [joint.child for joint in kinematics.chain if joint.name in kinematics.drives]
    return [
        (body.mass, (poses[child] @ np.array([*body.centre, 1.0]))[:, :3])
        for child, body in zip(driven, moved_bodies(kinematics), strict=True)
    ]


def _moment(weights: list[tuple[float, Array]], origin: Array) -> Array:
    """Moment of the weights about an origin (n, 3) [N·m]."""
    down = np.array([0.0, 0.0, -GRAVITY])
    return np.asarray(sum((np.cross(at - origin, mass * down) for mass, at in weights), np.zeros(origin.shape)))
