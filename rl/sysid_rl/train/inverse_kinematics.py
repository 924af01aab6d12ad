"""Inverse kinematics: the baseline of every policy, and the test whether a path can be reached.

On calibrated kinematics (a ``structured`` forward model without a network, or a plant) the solver is compiled; on any other
forward model the same steps use a Jacobian by finite differences.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError, SettingsError
from sysid.networks import Calibration, StructuredForward
from sysid.networks.forward import ForwardModel
from sysid.plant import Plant, compile_plant
from sysid.plant import machine_arrays as rigs
from sysid.plant.layout import AT, AXIS_WIDTH
from sysid_rl.train import damped_least_squares as solver

Array = npt.NDArray[np.float64]

#: Most steps for a target, and the distance at which a search ends [m].
STEPS, NEAR = 60, 1e-7
#: Finite difference for a learned model, as a share of a joint's range: larger than its kinks.
DIFFERENCE = 1e-4


@dataclass(frozen=True)
class KinematicChain:
    """An open chain with fixed geometry.

    Args:
        rows: a joint each, (J, WIDTH), columns as in :mod:`sysid_rl.train.damped_least_squares`.
        last: the tip in the frame of the last joint, (3,) [m].
    """

    rows: Array
    last: Array

    def predict(self, q: npt.ArrayLike) -> Array:
        """Tips (n, 3) [m] at joints (n, A)."""
        joints = np.ascontiguousarray(np.atleast_2d(np.asarray(q, dtype=np.float64)))
        out = np.empty((len(joints), 3))
        solver.tips(self.rows, self.last, joints, out)
        return out


def chain_of_forward(model: ForwardModel) -> KinematicChain | None:
    """The kinematics inside a calibrated forward model; None where it is or contains a network, or where joints deflect."""
    if not isinstance(model, StructuredForward) or model.members or not isinstance(model.structure, Calibration):
        return None
    folded = model.structure.geometry.folded(model.structure.values)
    if folded is None:
        return None
    rows = []
    for joint in folded.joints:
        row = np.zeros(solver.WIDTH)
        rotation = joint.factors if joint.prismatic else joint.factors[:3] + joint.factors[3:6]
        row[solver.COLUMN], row[solver.STRETCH], row[solver.PRISMATIC] = joint.column, joint.stretch, joint.prismatic
        row[solver.OFFSET] = joint.offset
        row[solver.SHIFT : solver.SHIFT + 3] = joint.shift[:, 0]
        row[solver.ROTATION : solver.ROTATION + 9] = rotation.ravel()
        row[solver.AXIS : solver.AXIS + 3] = rotation.T @ joint.slide[:, 0]
        rows.append(row)
    return KinematicChain(np.array(rows), np.ascontiguousarray(folded.last[:, 0]))


def chain_of_plant(plant: Plant) -> KinematicChain:
    """The kinematics of a plant, without backlash and compliance.

    Raises:
        SettingsError: its machine has no URDF.
    """
    from scipy.spatial.transform import Rotation

    model = compile_plant(plant)
    if not model.posed:
        raise SettingsError(f"plant of {plant.machine.name}", "its machine has no URDF", "urdf = … and tip = … in machine.toml")
    theta, links = model.theta, model.arrays.links
    base, offset = model.arrays.base + AT.base_misalignment, model.arrays.base + AT.tip_offset
    turn = Rotation.from_rotvec(theta[base + 3 : base + 6]).as_matrix()
    rows = []
    shift = np.zeros(3)
    for j, link in enumerate(links):
        shift = link[rigs.SHIFT : rigs.SHIFT + 3].copy()
        if j > 0 and link[rigs.LENGTH] > 0.0 and links[j - 1, rigs.PASSIVE] == 0.0:
            carrier = int(links[j - 1, rigs.ORDER])
            shift *= 1.0 + theta[carrier * AXIS_WIDTH + AT.link_length_error] / link[rigs.LENGTH]
        if j == len(links) - 1:
            shift += theta[offset : offset + 3]
            break
        row = np.zeros(solver.WIDTH)
        rotation = link[rigs.ROTATION : rigs.ROTATION + 9].reshape(3, 3)
        if j == 0:
            rotation, shift = turn @ rotation, turn @ shift + theta[base : base + 3]
        column = int(link[rigs.ORDER])
        row[solver.COLUMN], row[solver.STRETCH], row[solver.PRISMATIC] = column, link[rigs.RATIO], link[rigs.PRISMATIC]
        row[solver.OFFSET] = link[rigs.RATIO] * theta[column * AXIS_WIDTH + AT.joint_offset] + link[rigs.OFFSET]
        row[solver.SHIFT : solver.SHIFT + 3], row[solver.ROTATION : solver.ROTATION + 9] = shift, rotation.ravel()
        row[solver.AXIS : solver.AXIS + 3] = link[rigs.AXIS : rigs.AXIS + 3]
        rows.append(row)
    return KinematicChain(np.array(rows), shift)


@dataclass(frozen=True)
class InverseKinematics:
    """Target → joints within their bounds.

    Args:
        model: joints → end effector; a :class:`KinematicChain` is solved by compiled code.
        low, high: bounds, (A,) [rad or m].
    """

    model: KinematicChain | ForwardModel
    low: Array
    high: Array

    @staticmethod
    def of(forward: ForwardModel | KinematicChain, low: Array, high: Array) -> InverseKinematics:
        """For a forward model; its kinematics are used if it has any."""
        chain = forward if isinstance(forward, KinematicChain) else chain_of_forward(forward)
        return InverseKinematics(chain or forward, low, high)

    @cached_property
    def weights(self) -> Array:
        """Weight of each joint's motion, (A,): its range."""
        return self.high - self.low

    def solve(self, targets: npt.ArrayLike, begin: npt.ArrayLike) -> tuple[Array, Array]:
        """Joints (n, A) for targets (n, 3), each searched from its row of ``begin`` (n, A); remaining distances (n,) [m]."""
        return self._solve(targets, begin, follow=False)

    def follow(self, points: npt.ArrayLike, begin: npt.ArrayLike) -> tuple[Array, Array]:
        """Joints (n, A) along a path (n, 3), each searched from the one before, the first from ``begin`` (A,)."""
        return self._solve(points, np.atleast_2d(np.asarray(begin, dtype=np.float64)), follow=True)

    def reach(self, point: npt.ArrayLike, rng: np.random.Generator, tries: int = 64) -> tuple[Array, float]:
        """Joints (A,) for one point (3,), farthest from their bounds of ``tries`` random searches, and the distance [m]."""
        begin = rng.uniform(self.low, self.high, (tries, len(self.low)))
        joints, left = self.solve(np.tile(np.asarray(point, dtype=np.float64), (tries, 1)), begin)
        score = np.where(left < left.min() + 1e-5, self.margin(joints), -1.0)
        best = int(np.argmax(score))
        return joints[best], float(left[best])

    def margin(self, joints: Array) -> Array:
        """Smallest distance of a joint from its bound, as a share of its range, (n,) for joints (n, A)."""
        return np.asarray((np.minimum(joints - self.low, self.high - joints) / (self.high - self.low)).min(axis=-1))

    def _solve(self, targets: npt.ArrayLike, begin: npt.ArrayLike, follow: bool) -> tuple[Array, Array]:
        points = np.ascontiguousarray(np.atleast_2d(np.asarray(targets, dtype=np.float64)))
        starts = np.ascontiguousarray(np.asarray(begin, dtype=np.float64))
        rows = 1 if follow else len(points)
        if points.shape[1:] != (3,) or starts.shape != (rows, len(self.low)):
            found = f"targets of shape {points.shape} from {starts.shape}"
            raise InputError("inverse kinematics", found, f"(n, 3) from ({'1' if follow else 'n'}, {len(self.low)})")
        if not np.isfinite(points).all():
            raise InputError("inverse kinematics", "a target that is no finite number", "points [m]")
        out, left = np.empty((len(points), len(self.low))), np.empty(len(points))
        if isinstance(self.model, KinematicChain):
            solver.solve(
                self.model.rows, self.model.last, self.low, self.high, self.weights, starts, points, follow, STEPS, NEAR,
                out, left,
            )  # fmt: skip
            return out, left
        if not follow:
            return self._descend(points, starts)
        for k in range(len(points)):
            joints, away = self._descend(points[k : k + 1], starts if k == 0 else out[k - 1 : k])
            out[k], left[k] = joints[0], away[0]
        return out, left

    def _descend(self, targets: Array, begin: Array) -> tuple[Array, Array]:
        """The compiled solver's steps for any model, on all rows together."""
        q = np.clip(begin, self.low, self.high)
        error = self._tip(q) - targets
        cost = np.sum(error**2, axis=1)
        damping = np.full(len(q), 1e-4)
        low, high = self.low / self.weights, self.high / self.weights
        for _ in range(STEPS):
            active = (cost > NEAR**2) & (damping < 1e6)
            if not active.any():
                break
            jacobian = self._jacobian(q) * self.weights  # (n, 3, A)
            change = self.weights * _least_squares(jacobian, error, damping, q / self.weights, low, high)
            trial = np.clip(q + change, self.low, self.high)
            away = self._tip(trial) - targets
            found = np.sum(away**2, axis=1)
            better = active & (found < cost)
            settled = better & (cost - found < 1e-9 * cost)
            q[better], error[better], cost[better] = trial[better], away[better], found[better]
            damping = np.where(settled, np.inf, np.where(better, 0.2 * damping, 8.0 * damping))
        return q, np.sqrt(cost)

    def _tip(self, q: Array) -> Array:
        return np.asarray(self.model.predict(q))

    def _jacobian(self, q: Array) -> Array:
        step = DIFFERENCE * (self.high - self.low)
        count = len(self.low)
        moved = np.repeat(q, 2 * count, axis=0).reshape(len(q), count, 2, count)
        for i in range(count):
            moved[:, i, 0, i] -= step[i]
            moved[:, i, 1, i] += step[i]
        ends = self._tip(moved.reshape(-1, count)).reshape(len(q), count, 2, 3)
        return np.asarray(((ends[:, :, 1] - ends[:, :, 0]) / (2.0 * step[:, None])).transpose(0, 2, 1))


def _least_squares(jacobian: Array, error: Array, damping: Array, at: Array, low: Array, high: Array) -> Array:
    """Damped steps (n, A) for Jacobians (n, 3, A) and errors (n, 3); joints that would leave their bound are held."""
    held = np.zeros(at.shape, dtype=np.bool_)
    for _ in range(at.shape[1]):
        free = np.where(held[:, None, :], 0.0, jacobian)
        scale = np.trace(free @ free.transpose(0, 2, 1), axis1=1, axis2=2)
        ridge = (np.minimum(damping, 1e9) * np.maximum(scale, 1e-12))[:, None, None] * np.eye(3)
        z = -(free.transpose(0, 2, 1) @ np.linalg.solve(free @ free.transpose(0, 2, 1) + ridge, error[:, :, None]))[:, :, 0]
        more = ~held & (((at <= low) & (z < 0.0)) | ((at >= high) & (z > 0.0)))
        if not more.any():
            break
        held |= more
    return np.where(held, 0.0, z)
