"""How noisy a sensor is, from its own samples."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: Samples of a sensor this far apart are independent [s]: of any sensor above 17 Hz.
LAG_S = 0.06


def noise_of(values: Array, rate_hz: float) -> float:
    """Standard deviation of a sensor's noise [unit of the signal], from its own samples, whether it moves or not.

    Median of the scatter about cubics over a fifth of a second: a cubic follows any motion of a machine over that time, the
    median leaves out what it does not follow (stops, jerks); noise slower than that is not seen. Where the sensor counts
    in steps, at least the uniform error of a step.
    """
    width = max(round(0.2 * rate_hz), 10)
    count = len(values) // width
    windows = values[: count * width].reshape(count, width)
    windows = windows[~np.isnan(windows).any(axis=1)]
    if not len(windows):
        return float("nan")
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, width), 4))[0]
    centred = windows - windows.mean(axis=1, keepdims=True)
    residual = centred - centred @ basis @ basis.T
    scatter = float(np.sqrt(np.median(np.sum(residual**2, axis=1)) / (width - 4)))
    return max(scatter, _step(values) / math.sqrt(12.0))


def unsteadiness(values: Array, rate_hz: float) -> float:
    """Noise of a signal in an aligned table [unit of the signal], not too small where its sensor is slower than the table.

    The median second difference over :data:`LAG_S`, which leaves out steady motion, or :func:`noise_of` where that is more:
    between the samples of a slow sensor a table is smooth, whatever its noise. Quick motion counts in part; zero where there
    are too few rows to tell.
    """
    known = values[~np.isnan(values)]
    lag = max(round(LAG_S * rate_hz), 1)
    if len(known) <= 2 * lag:
        return 0.0
    second = np.abs(known[2 * lag :] - 2.0 * known[lag:-lag] + known[: -2 * lag])
    # Of a normal variable half the values lie within 0.6745 standard deviations; a second difference has those of six samples.
    scatter = float(np.median(second)) / (0.6745 * math.sqrt(6.0))
    fine = noise_of(known, rate_hz)
    return scatter if math.isnan(fine) else max(scatter, fine)


def _step(values: Array) -> float:
    """The sensor's quantum; 0 where its values do not repeat."""
    known = values[~np.isnan(values)]
    levels = np.unique(known)
    if len(levels) < 2 or len(levels) > len(known) / 4:
        return 0.0
    gaps = np.diff(levels)
    return float(gaps[gaps > 1e-6 * (levels[-1] - levels[0])].min())
