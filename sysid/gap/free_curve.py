"""A rival without a name: a speed that depends on what was asked for in any way whatever.

A gain, its curve, a limit are some shapes that the speed of a drive may have over its command. Where a shape of no known form
tells nearly as much beside them as they do themselves, what is there is not them, however much better than nothing they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.data import Data
from sysid.gap.drift import Drift, to_bins, whiten_lanes

Array = npt.NDArray[np.float64]

#: Shares of the fastest speed at which the curve has a value, in each direction; straight lines between them.
KNOTS = np.array([0.05, 0.15, 0.3, 0.45, 0.6, 0.8, 1.0])
#: Standard deviation of these values before anything was seen, in shares of the speed: no machine is off by much more.
USUAL = 0.2


@dataclass(frozen=True)
class FreeCurve:
    """What is left of recordings beside what each value of the curve would do there.

    Args:
        left: whitened residuals (m,), variance about 1 where the model is right.
        columns: whitened change of the residual for each value of the curve (m, k).
        fastest: simulated speed at the last knot.
    """

    left: Array
    columns: Array
    fastest: float

    def values(self) -> Array:
        """The curve that these recordings tell best, (k,), as shares of the speed."""
        width = self.columns.shape[1]
        rows = np.vstack([self.columns, np.eye(width) / USUAL])
        values, *_ = np.linalg.lstsq(rows, np.concatenate([self.left, np.zeros(width)]), rcond=None)
        return np.asarray(values)

    def gain(self, values: Array) -> float:
        """Log likelihood gained with these values of the curve [nats]."""
        return float(0.5 * (np.sum(self.left**2) - np.sum((self.left - self.columns @ values) ** 2)))

    def imitates(self, without: Array) -> float:
        """Share of what an effect does that a curve does as well.

        Args:
            without: whitened residuals (m,) without the effect.
        """
        done = without - self.left
        values, *_ = np.linalg.lstsq(self.columns, done, rcond=None)
        whole = float(np.sum(done**2))
        return 1.0 - float(np.sum((done - self.columns @ values) ** 2)) / whole if whole > 0.0 else 0.0


def free_curve(data: Data, theta: Array, drift: Drift, fastest: float | None = None) -> FreeCurve:
    """The curve beside the model ``theta`` of a stage that integrates, on the first of its signals.

    Args:
        drift: by which residuals are whitened.
        fastest: speed at the last knot; that of these recordings where it is not given.
    """
    speeds = [_speed(data, theta, recording) for recording in data.recordings]
    if fastest is None:
        fastest = max(*(float(np.percentile(np.abs(speed), 99.0)) for speed in speeds), 1e-12)
    columns = []
    for recording, activity, speed in zip(data.recordings, data.activities, speeds, strict=True):
        weights = np.array([np.interp(np.abs(speed) / fastest, KNOTS, row) for row in np.eye(len(KNOTS))])
        sided = np.concatenate([weights * np.maximum(speed, 0.0), weights * np.minimum(speed, 0.0)])
        moved = to_bins(np.cumsum(sided, axis=1).T / recording.rate_hz / data.sigma[0], data.problem.rate(recording)).T
        moved[:, np.isnan(to_bins(data.problem.measured(recording), data.problem.rate(recording))[:, 0])] = np.nan
        columns.append(np.nan_to_num(whiten_lanes(moved, activity, drift) / drift.noise).T)
    return FreeCurve(data.whitened(theta[None], (drift,))[0], np.concatenate(columns), fastest)


def _speed(data: Data, theta: Array, recording: Recording) -> Array:
    """Simulated speed (n,)."""
    position = data.problem.predict(theta[None], recording)[0, :, 0]
    rows, there = np.arange(len(position)), np.isfinite(position)
    if not there.any():
        return np.zeros(len(position))
    return np.asarray(np.gradient(np.interp(rows, rows[there], position[there])) * recording.rate_hz)
