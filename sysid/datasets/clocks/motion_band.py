"""The band of the motion in a signal: whether the signal moves, and a low-pass that removes noise above the band."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.chunked import known, median_step
from sysid.datasets.clocks.coarse import Pair, noise_of
from sysid.datasets.resample import low_pass
from sysid.scratch import chosen

Array = npt.NDArray[np.float64]

#: Length of a section [s], power relative to noise at which the band of the motion ends, margin, least band [Hz].
BAND_S, BAND_RATIO, BAND_MARGIN, LOWEST_BAND_HZ = 20.0, 3.0, 1.5, 0.5
#: Samples from which the spread and the quantum of a signal are estimated.
MAX_SAMPLES = 20_000


def moves(pair: Pair) -> bool:
    """Whether both signals of a pair move."""
    return _moving(pair.x) and _moving(pair.y)


def _moving(values: Array) -> bool:
    """Whether a signal moves by more than 20 times its noise and its quantum."""
    there = known(values)
    if len(there) < 50:
        return False
    noise = noise_of(there)
    thinned = there[:: max(1, len(there) // MAX_SAMPLES)]
    steps = np.diff(np.unique(thinned))
    quantum = float(steps.min()) if len(steps) else 0.0
    spread = float(np.quantile(thinned, 0.99) - np.quantile(thinned, 0.01))
    return spread > 20.0 * max(noise, quantum)


def smoothed(pair: Pair) -> Pair:
    """``x`` without noise above the band of its motion, and the known samples of y.

    Noise in the rate of x makes the interval of the offset too narrow, and interpolation reduces it between samples, which
    biases the lag.
    """
    x, noise = without_noise(pair.x_times, pair.x, pair.x_gap_s)
    there = ~np.isnan(pair.y)
    return replace(pair, x=x, noise=noise, y_times=chosen(pair.y_times, there), y=chosen(pair.y, there))


def without_noise(times: Array, values: Array, gap_s: float) -> tuple[Array, float]:
    """A signal (n,) low-passed to the band of its motion, and the standard deviation of the remaining noise."""
    rate = 1.0 / median_step(times)
    cut = min(0.2 * rate, motion_band(values, rate))
    return low_pass(times, values, cut, gap_s), noise_of(values) * float(np.sqrt(2.0 * cut / rate))


def range_of(values: Array) -> float:
    """Range of a signal (n,) between its 1 % and 99 % quantiles."""
    low, high = np.nanquantile(values, (0.01, 0.99))
    return float(high - low)


def motion_band(values: Array, rate: float) -> float:
    """Frequency [Hz] above which a signal (n,) at ``rate`` is mainly noise."""
    there = known(values)
    length = min(len(there), round(BAND_S * rate))
    count = len(there) // length if length else 0
    if count < 1 or length < 64:
        return rate
    window = np.hanning(length)
    sections = there[: count * length].reshape(count, length)
    power = np.mean(np.abs(np.fft.rfft((sections - sections.mean(axis=1, keepdims=True)) * window, axis=1)) ** 2, axis=0)
    frequencies = np.fft.rfftfreq(length, 1.0 / rate)
    # Smoothed over enough lines that noise alone stays below the ratio.
    lines = max(3, -(-24 // count))
    smooth = np.convolve(power, np.ones(lines) / lines, mode="same")
    floor = float(np.median(smooth[frequencies > 0.3 * rate]))
    above = np.flatnonzero(smooth > BAND_RATIO * floor)
    top = float(frequencies[above[-1]]) if len(above) else 0.0
    return max(BAND_MARGIN * top, LOWEST_BAND_HZ)
