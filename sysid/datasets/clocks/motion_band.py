"""What of a signal is motion: whether it moves at all, and what lies above the band of its motion and is noise alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.clocks.coarse import Pair, noise_of
from sysid.datasets.in_pieces import known, median_step
from sysid.datasets.resample import low_pass
from sysid.scratch import chosen

Array = npt.NDArray[np.float64]

#: Motion ends where its power falls to this many times that of the noise, in sections of some seconds; margin and least band.
BAND_S, BAND_RATIO, BAND_MARGIN, LOWEST_BAND_HZ = 20.0, 3.0, 1.5, 0.5
#: Samples that the spread and the quantum of a signal are told from.
ENOUGH = 20_000


def moves(pair: Pair) -> bool:
    """Whether both signals of a pair move."""
    return _moving(pair.x) and _moving(pair.y)


def _moving(values: Array) -> bool:
    """Whether a signal moves by much more than its noise (differences of neighbours) and its quantum."""
    there = known(values)
    if len(there) < 50:
        return False
    noise = noise_of(there)
    thinned = there[:: max(1, len(there) // ENOUGH)]
    steps = np.diff(np.unique(thinned))
    quantum = float(steps.min()) if len(steps) else 0.0
    spread = float(np.quantile(thinned, 0.99) - np.quantile(thinned, 0.01))
    return spread > 20.0 * max(noise, quantum)


def smoothed(pair: Pair) -> Pair:
    """``x`` without what is noise alone, and the samples of y that are known.

    Noise in the rate of x would make the offset look surer than it is, and between samples interpolation would shrink it and so
    prefer such lags.
    """
    x, noise = without_noise(pair.x_times, pair.x, pair.x_gap_s)
    there = ~np.isnan(pair.y)
    return replace(pair, x=x, noise=noise, y_times=chosen(pair.y_times, there), y=chosen(pair.y, there))


def without_noise(times: Array, values: Array, gap_s: float) -> tuple[Array, float]:
    """A signal (n,) without what lies above the band of its motion, and the standard deviation of the noise left in it."""
    rate = 1.0 / median_step(times)
    cut = min(0.2 * rate, motion_band(values, rate))
    return low_pass(times, values, cut, gap_s), noise_of(values) * float(np.sqrt(2.0 * cut / rate))


def range_of(values: Array) -> float:
    """How far a signal (n,) goes, its outermost hundredths left out."""
    low, high = np.nanquantile(values, (0.01, 0.99))
    return float(high - low)


def motion_band(values: Array, rate: float) -> float:
    """Frequency [Hz] above which a signal (n,) at ``rate`` is hardly more than its noise."""
    there = known(values)
    length = min(len(there), round(BAND_S * rate))
    count = len(there) // length if length else 0
    if count < 1 or length < 64:
        return rate
    window = np.hanning(length)
    sections = there[: count * length].reshape(count, length)
    power = np.mean(np.abs(np.fft.rfft((sections - sections.mean(axis=1, keepdims=True)) * window, axis=1)) ** 2, axis=0)
    frequencies = np.fft.rfftfreq(length, 1.0 / rate)
    # Smoothed over so many lines that noise alone never comes near the ratio.
    lines = max(3, -(-24 // count))
    smooth = np.convolve(power, np.ones(lines) / lines, mode="same")
    floor = float(np.median(smooth[frequencies > 0.3 * rate]))
    above = np.flatnonzero(smooth > BAND_RATIO * floor)
    top = float(frequencies[above[-1]]) if len(above) else 0.0
    return max(BAND_MARGIN * top, LOWEST_BAND_HZ)
