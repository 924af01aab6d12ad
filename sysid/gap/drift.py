"""A level that drifts while the machine moves, beside white noise: of a measured input, and of planned recordings.

A free run integrates every disturbance, so that even the residual of the true model drifts like a random walk. The local level
model (Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, §2.2) estimates this drift:
``r_k = level_k + s·ε_k``, ``level_{k+1} = level_k + s·√(calm + moving·activity_k)·η_k``. Its one-step prediction errors are
white: without drift the residual itself, with strong drift its increments. A parameter that only follows the drift gains
nothing.

Only a stage that integrates its input drifts without bound. Elsewhere the level decays (``memory`` < 1 per bin), so that a
constant offset is no drift.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.compiled import kernel

Array = npt.NDArray[np.float64]

#: Residuals are averaged over this time [s] before they are whitened.
BIN = 0.1
#: A whitened residual counts as at most this many standard deviations.
CLIP = 12.0
#: Searched strengths of the drift, variance per bin relative to the noise of a bin.
_STRENGTHS = (0.0, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1e4)


@dataclass(frozen=True)
class DriftStrength:
    """Strength of the drift of one signal.

    Args:
        calm: variance that the level gains in each bin at rest, relative to the noise of a bin.
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


@kernel
def _filter(residual: Array, activity: Array, calm: float, moving: float, memory: float, error: Array, variance: Array) -> None:
    """Prediction errors of the local level model and their variances, relative to the noise of a bin; NaN where missing."""
    level = 0.0
    spread = 1.0  # the start of a run is known about as well as one bin
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


@kernel
def _filter_lanes(
    residuals: Array, activity: Array, calm: float, moving: float, memory: float, errors: Array, variances: Array
) -> None:
    for lane in range(len(residuals)):
        _filter(residuals[lane], activity, calm, moving, memory, errors[lane], variances[lane])


def whiten_lanes(residuals: Array, activity: Array, drift: DriftStrength) -> Array:
    """error/√variance of many series at once, (lanes, m)."""
    errors, variances = np.empty(residuals.shape), np.empty(residuals.shape)
    _filter_lanes(np.ascontiguousarray(residuals), activity, drift.calm, drift.moving, drift.memory, errors, variances)
    return errors / np.sqrt(variances)


def smooth_level(residual: Array, activity: Array, drift: DriftStrength) -> Array:
    """The level given all samples before and after (n,), NaN where these are missing.

    Fixed-interval smoother of the local level model (de Jong, J. Am. Stat. Assoc. 84, 1989, 1085–1088).

    Args:
        activity: (n,); its mean is 1, as in :func:`estimate_drift`.
    """
    error, variance, out = np.empty(len(residual)), np.empty(len(residual)), np.empty(len(residual))
    _filter(residual, activity, drift.calm, drift.moving, 1.0, error, variance)
    _smooth(residual, error, variance, out)
    return out


@kernel
def _smooth(residual: Array, error: Array, variance: Array, out: Array) -> None:
    pull = 0.0
    for k in range(len(residual) - 1, -1, -1):
        if np.isnan(residual[k]):
            out[k] = np.nan
            continue
        spread = variance[k] - 1.0  # of the level before the sample
        pull = (error[k] + pull) / variance[k]
        out[k] = residual[k] - error[k] + spread * pull


def estimate_drift(series: Sequence[Array], activities: Sequence[Array], memory: float = 1.0) -> tuple[DriftStrength, float]:
    """Maximum likelihood over a grid, refined once; returns the drift and the log-likelihood (up to a constant).

    Args:
        series, activities: one array of bins for each recording.
        memory: share of the level that is left a bin later; 1 for a stage that integrates.
    """
    joined, active = np.concatenate(series), np.concatenate(activities)
    starts = np.concatenate([[0], np.cumsum([len(part) for part in series])])
    work = np.empty((2, len(joined)))
    best = (DriftStrength(memory=memory), -np.inf)
    calm: Sequence[float] = _STRENGTHS
    moving: Sequence[float] = _STRENGTHS if any(len(a) and np.ptp(a) > 0 for a in activities) else (0.0,)
    for _ in range(2):
        for c in calm:
            for m in moving:
                noise, total = _likelihood(joined, active, starts, c, m, memory, work)
                if total > best[1]:
                    best = DriftStrength(c, m, noise, memory), total
        calm, moving = _around(best[0].calm), _around(best[0].moving) if len(moving) > 1 else (0.0,)
    return best


def _around(value: float) -> tuple[float, ...]:
    return (0.0,) if value == 0.0 else tuple(value * f for f in (0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0))


@kernel
def _likelihood(
    residual: Array, activity: Array, starts: npt.NDArray[np.int64], calm: float, moving: float, memory: float, work: Array
) -> tuple[float, float]:
    """Noise and log-likelihood of series one after the other, (m,), each beginning at ``starts``; ``work``: (2, m)."""
    error, variance = work[0], work[1]
    for s in range(len(starts) - 1):
        here = slice(starts[s], starts[s + 1])
        _filter(residual[here], activity[here], calm, moving, memory, error[here], variance[here])
    count, logs = 0, 0.0
    for k in range(len(error)):
        if not np.isnan(error[k]):
            error[count] = error[k] / np.sqrt(variance[k])
            logs += np.log(variance[k])
            count += 1
    if count == 0:
        return 1.0, -np.inf
    noise = _scale(error[:count])
    total = 0.0
    for k in range(count):
        total -= 0.5 * min(abs(error[k]) / noise, CLIP) ** 2
    return noise, total - 0.5 * logs - count * np.log(noise)


def robust_scale(values: Array) -> float:
    """Standard deviation of ``values``, clipped at :data:`CLIP` times itself, so that a few outliers do not count."""
    return float(_scale(np.ascontiguousarray(values, dtype=np.float64)))


@kernel
def _scale(values: Array) -> float:
    scale = np.sqrt(np.mean(values**2))
    for _ in range(20):
        total = 0.0
        for value in values:
            total += min(abs(value), CLIP * scale) ** 2
        clipped = np.sqrt(total / len(values))
        if scale - clipped < 1e-6 * scale:
            break
        scale = clipped
    return float(max(scale, 1e-12))


def to_bins(values: Array, rate_hz: float) -> Array:
    """Means over bins along the second to last axis, (…, n, d) → (…, m, d); NaN where fewer than half the samples are there."""
    # (0 − value)/−1 is the value, so that one kernel serves both.
    nothing = np.zeros(values.shape[-2:])
    flat = np.ascontiguousarray(values, dtype=np.float64).reshape(math.prod(values.shape[:-2]), *values.shape[-2:])
    found = bins_of(nothing, flat, np.full(values.shape[-1], -1.0), rate_hz)
    return found.reshape(*values.shape[:-2], *found.shape[1:])


def bins_of(measured: Array, predicted: Array, sigma: Array, rate_hz: float) -> Array:
    """Means of (measured − predicted)/σ over bins, in one pass.

    Args:
        measured: (n, d); predicted: (lanes, n, d); NaN in either is missing.
        sigma: (d,).

    Returns:
        (lanes, m, d), NaN where fewer than half the samples of a bin are there.
    """
    width = max(1, round(BIN * rate_hz))
    out = np.empty((len(predicted), len(measured) // width, len(sigma)))
    _bin_lanes(np.ascontiguousarray(measured), np.ascontiguousarray(predicted), sigma, width, out)
    return out


@kernel
def _bin_lanes(measured: Array, predicted: Array, sigma: Array, width: int, out: Array) -> None:
    for lane in range(out.shape[0]):
        for k in range(out.shape[1]):
            for j in range(out.shape[2]):
                total, count = 0.0, 0
                for i in range(k * width, (k + 1) * width):
                    left = (measured[i, j] - predicted[lane, i, j]) / sigma[j]
                    if not np.isnan(left):
                        total += left
                        count += 1
                out[lane, k, j] = total / count if 2 * count >= width else np.nan
