"""Static poses as rows of a regression: three coordinates of the tip each, and their slopes by every unknown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.candidates import Unknown
from sysid.gap.fit import place
from sysid.gap.poses.tangents import tangents_of
from sysid.gap.problem import Problem
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
        found = tangents_of(kinematics, np.nan_to_num(joints))
        self.tangents = self._flat(found.columns)
        self.kind = found.kind
        count = max(1, min(BLOCKS, self.poses // BLOCK))
        self.block = np.repeat(np.arange(self.poses) * count // max(self.poses, 1), width)
        self.blocks = count

    def predicted(self, thetas: Array) -> Array:
        """(lanes, poses, 3) [m]."""
        return np.concatenate([self.problem.predict(thetas, r) for r in self.recordings], axis=1)

    def residual(self, theta: Array) -> Array:
        """Residual (rows,) in noise floors."""
        return self._flat((self.output - self.predicted(theta[None])[0])[:, :, None])[:, 0]

    def linearised(self, theta: Array, unknowns: Sequence[Unknown]) -> tuple[Array, Array]:
        """Residual (rows,) and change of the output per unit of each unknown, (rows, k), both in noise floors."""
        values = np.array([theta[u.places[0]] for u in unknowns])
        steps = np.diag([STEP * u.negligible for u in unknowns])
        lanes = np.vstack([values[None], values + steps, values - steps]) if unknowns else np.empty((1, 0))
        ends = self.predicted(place(theta, unknowns, lanes))
        k = len(unknowns)
        slopes = np.empty((*ends.shape[1:], 0))
        if k:
            slopes = np.moveaxis(ends[1 : k + 1] - ends[k + 1 :], 0, 2) / (2.0 * np.diag(steps))
        return self._flat((self.output - ends[0])[:, :, None])[:, 0], self._flat(slopes)

    def by_row(self, of_pose: Array) -> Array:
        """Values of poses (poses,) for their rows, (rows,)."""
        return np.repeat(of_pose, self.output.shape[1])

    def _flat(self, columns: Array) -> Array:
        """(poses, 3, m) [m] → (rows, m) in noise floors; zero where not measured."""
        scaled = np.where(self.present[:, :, None], columns * self.scale[None, :, None], 0.0)
        return np.ascontiguousarray(scaled.reshape(-1, columns.shape[2]))


def weights_of(rows: PoseRows, residual: Array) -> Array:
    """Weight of each pose by the length of its residual (rows,): less than one for outliers, (poses,)."""
    length = np.linalg.norm(residual.reshape(rows.poses, -1), axis=1)
    seen = length[length > 0.0]
    typical = float(np.median(seen)) / MEDIAN_LENGTH if len(seen) else 1.0
    away = length / max(typical * np.sqrt(3.0), 1e-300)
    return np.asarray(np.sqrt(np.minimum(1.0, HUBER / np.maximum(away, 1e-12))))
