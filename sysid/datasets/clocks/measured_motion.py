"""Motion in a measured signal: its band, with a low-pass that removes noise above it, and its direction where backlash is taken
up.

Behind backlash of width w the driven side follows at a distance of w/2 to one side or the other, depending on the direction of
motion; after a reversal it rests until the backlash is taken up. Interpreted as a clock offset, that is w/2 over the speed:
tens of milliseconds for slow motion and half a degree. The map between two signals therefore has an intercept for each
direction, ``y = f(x) + c·d``, d = ±1, and samples around reversals are not used.

Source: the play operator and its two branches: Visintin, Differential Models of Hysteresis (1994), ch. III.2.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from sysid.datasets.chunked import Array, Mask, Rows, known, median_step
from sysid.datasets.clocks.coarse import Pair, noise_of
from sysid.datasets.resample import low_pass
from sysid.scratch import chosen

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


def directions(values: Array, width: float, tremor: float = 0.0) -> tuple[Array, Mask]:
    """Direction of motion (n,), −1 or +1, and a mask of the samples at which backlash of up to ``width`` is taken up (n,).

    Args:
        values: a motion without missing samples (n,).
        width: upper bound of the backlash; a smaller motion back is no reversal.
        tremor: a smaller motion back is noise and leaves the backlash taken up [both: unit of the motion].

    Returns:
        Between two reversals a sample is valid if it is further than ``width`` from both turning points and the motion passes
        its value only once, because either signal may be the one that rests.
    """
    turns, first = turning_rows(values, width)
    edges = np.concatenate([[0], turns, [len(values) - 1]]).astype(np.intp)
    direction, settled = np.ones(len(values)), np.zeros(len(values), dtype=bool)
    sign = first
    for k, (begin, end) in enumerate(pairwise(edges)):
        rows = slice(int(begin), int(end) + 1)
        along = sign * values[rows]
        highest, lowest = np.maximum.accumulate(along), np.minimum.accumulate(along[::-1])[::-1]
        level = (along >= highest - tremor) & (along <= lowest + tremor)
        left = along - along[0] > width
        ahead = along[-1] - along > width if k < len(edges) - 2 else np.ones(len(along), dtype=bool)
        direction[rows] = sign
        settled[rows] = level & left & ahead
        sign = -sign
    return direction, settled


def turning_rows(values: Array, least: float) -> tuple[Rows, float]:
    """Rows of the reversals of a motion (n,) by more than ``least``, and the direction before the first (−1 or +1)."""
    corners = _corners(values)
    found: list[int] = []
    sign, first = 0.0, 1.0
    low = high = int(corners[0]) if len(corners) else 0
    for row in corners.tolist():
        value = values[row]
        if value > values[high]:
            high = row
        if value < values[low]:
            low = row
        if sign >= 0.0 and values[high] - value > least and high < row:
            if sign == 0.0:
                first = 1.0 if high > low else -1.0
            if sign > 0.0 or high > low:
                found.append(high)
            sign, low, high = -1.0, row, row
        elif sign <= 0.0 and value - values[low] > least and low < row:
            if sign == 0.0:
                first = -1.0 if low > high else 1.0
            if sign < 0.0 or low > high:
                found.append(low)
            sign, low, high = 1.0, row, row
    return np.array(found, dtype=np.intp), first


def _corners(values: Array) -> Rows:
    """Rows of all turning points of the motion, and its ends."""
    rise = np.sign(np.diff(values))
    rows = np.flatnonzero(rise) + 1  # the sample after each change
    turned = np.flatnonzero(np.diff(rise[rows - 1]) != 0.0)
    inner = rows[turned]
    return np.unique(np.concatenate([[0], inner, [max(len(values) - 1, 0)]])).astype(np.intp)
