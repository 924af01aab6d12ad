"""What is left when the model is right: white sensor noise plus a drift that grows while the machine moves.

A free run integrates every disturbance, so even the true model's residual wanders like a random walk. The local level model
(Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, §2.2) says how much of a residual is such
wandering: ``r_k = level_k + s·ε_k``, ``level_{k+1} = level_k + s·√(calm + moving·activity_k)·η_k``. Its one-step
prediction errors are white; fits and comparisons are made on them. Without drift they are the residual itself; with much drift
they are its increments. A residual that only *looks* better because a parameter follows the wandering gains nothing.

Only a stage that integrates its input wanders without end. Elsewhere the level forgets (``memory`` < 1 per bin): a constant
that lasts is then no wandering but an offset that wants explaining.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

Array = npt.NDArray[np.float64]

#: Residuals are averaged over this time [s] before they are whitened.
BIN = 0.1
#: A whitened residual counts as at most this many standard deviations.
CLIP = 12.0
#: Searched strengths of the drift, variance per bin relative to the noise of a bin.
_STRENGTHS = (0.0, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1e4)


@dataclass(frozen=True)
class Drift:
    """Strength of the wandering of one signal.

    Args:
        calm: variance that the level gains in each bin, relative to the noise of a bin.
        moving: the same per unit of activity (mean activity is 1).
        noise: standard deviation of a whitened residual.
        memory: share of the level that is left a bin later.
    """

    calm: float = 0.0
    moving: float = 0.0
    noise: float = 1.0
    memory: float = 1.0

    @property
    def present(self) -> bool:
        return self.calm + self.moving > 1e-3


@njit(nogil=True, cache=True)
def _filter(residual: Array, activity: Array, calm: float, moving: float, memory: float, error: Array, variance: Array) -> None:
    """Prediction errors of the local level model and their variances, relative to the noise of a bin; NaN where missing."""
    level = 0.0
    spread = 1.0  # the start of a run is known about as well as one bin is measured
    for k in range(len(residual)):
        if np.isnan(residual[k]):
            error[k] = np.nan
            variance[k] = np.nan
        else:
            variance[k] = spread + 1.0
            error[k] = residual[k] - level
            gain = spread / variance[k]
            level += gain * error[k]
            spread *= 1.0 - gain
        level *= memory
        spread = memory * memory * spread + calm + moving * activity[k]


@njit(nogil=True, cache=True)
def _filter_lanes(
    residuals: Array, activity: Array, calm: float, moving: float, memory: float, errors: Array, variances: Array
) -> None:
    for lane in range(len(residuals)):
        _filter(residuals[lane], activity, calm, moving, memory, errors[lane], variances[lane])


def whiten_lanes(residuals: Array, activity: Array, drift: Drift) -> Array:
    """error/√variance of many series at once, (lanes, m)."""
    errors, variances = np.empty(residuals.shape), np.empty(residuals.shape)
    _filter_lanes(np.ascontiguousarray(residuals), activity, drift.calm, drift.moving, drift.memory, errors, variances)
    return errors / np.sqrt(variances)


def whiten(residual: Array, activity: Array, drift: Drift) -> tuple[Array, Array]:
    """(error/√variance, log variance), each (m,), for one series of bins."""
    error, variance = np.empty(len(residual)), np.empty(len(residual))
    _filter(np.ascontiguousarray(residual), activity, drift.calm, drift.moving, drift.memory, error, variance)
    return error / np.sqrt(variance), np.log(variance)


def log_density(residual: Array, activity: Array, drift: Drift) -> Array:
    """Log predictive density of every bin, (m,), NaN where missing, up to a constant."""
    error, log_variance = whiten(residual, activity, drift)
    return np.asarray(_normal(error / drift.noise) - 0.5 * log_variance - np.log(drift.noise))


def _normal(standard: Array) -> Array:
    """Log of the normal density without its constant; errors beyond :data:`CLIP` deviations count as that many.

    Heavier tails were tried and were worse: a model that moves wrongly passes the motion off as outliers.
    """
    return np.asarray(-0.5 * np.clip(standard, -CLIP, CLIP) ** 2)


def estimate_drift(series: Sequence[Array], activities: Sequence[Array], memory: float = 1.0) -> tuple[Drift, float]:
    """Maximum likelihood over a grid, refined once; returns the drift and the log-likelihood (up to a constant).

    Args:
        series, activities: one array of bins for each recording.
        memory: share of the level that is left a bin later; 1 for a stage that integrates.
    """
    best = (Drift(memory=memory), -np.inf)
    calm: Sequence[float] = _STRENGTHS
    moving: Sequence[float] = _STRENGTHS if any(np.ptp(a) > 0 for a in activities) else (0.0,)
    for _ in range(2):
        for c in calm:
            for m in moving:
                candidate = _likelihood(series, activities, c, m, memory)
                if candidate[1] > best[1]:
                    best = candidate
        calm, moving = _around(best[0].calm), _around(best[0].moving) if len(moving) > 1 else (0.0,)
    return best


def white_noise(series: Sequence[Array]) -> tuple[Drift, float]:
    """The noise of series that do not wander, and the log-likelihood (up to a constant)."""
    joined = np.concatenate(series)
    joined = joined[~np.isnan(joined)]
    noise = robust_scale(joined)
    return Drift(noise=noise), float(_normal(joined / noise).sum() - len(joined) * np.log(noise))


def _around(value: float) -> tuple[float, ...]:
    return (0.0,) if value == 0.0 else tuple(value * f for f in (0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0))


def _likelihood(
    series: Sequence[Array], activities: Sequence[Array], calm: float, moving: float, memory: float
) -> tuple[Drift, float]:
    errors, logs = [], []
    for residual, activity in zip(series, activities, strict=True):
        error, log_variance = whiten(residual, activity, Drift(calm, moving, memory=memory))
        there = ~np.isnan(error)
        errors.append(error[there])
        logs.append(log_variance[there])
    joined = np.concatenate(errors)
    count = len(joined)
    if count == 0:
        return Drift(memory=memory), -np.inf
    noise = robust_scale(joined)
    total = float(_normal(joined / noise).sum()) - 0.5 * float(np.concatenate(logs).sum()) - count * np.log(noise)
    return Drift(calm, moving, noise, memory), float(total)


def robust_scale(values: Array) -> float:
    """Standard deviation with what lies beyond :data:`CLIP` of itself drawn in (a few outliers do not count)."""
    scale = float(np.sqrt(np.mean(values**2)))
    for _ in range(20):
        clipped = float(np.sqrt(np.mean(np.clip(values, -CLIP * scale, CLIP * scale) ** 2)))
        if scale - clipped < 1e-6 * scale:
            break
        scale = clipped
    return max(scale, 1e-12)


def to_bins(residual: Array, rate_hz: float, seconds: float = BIN) -> Array:
    """Means over bins along the second to last axis, (…, n, d) → (…, m, d); NaN where fewer than half the samples are there."""
    width = max(1, round(seconds * rate_hz))
    count = residual.shape[-2] // width
    shape = residual.shape[:-2]
    blocks = residual[..., : count * width, :].reshape(*shape, count, width, residual.shape[-1])
    there = ~np.isnan(blocks)
    totals = np.where(there, blocks, 0.0).sum(axis=-2)
    counts = there.sum(axis=-2)
    return np.where(counts >= 0.5 * width, totals / np.maximum(counts, 1), np.nan)
