"""Initial lag between two clocks, from the cross-correlation of the rates of their motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.datasets.chunked import Array, median_step
from sysid.datasets.resample import interpolate
from sysid.scratch import chosen

#: Least correlation of the rates, and largest correlation at another lag relative to the best.
MIN_CORRELATION, MAX_ALTERNATIVE = 0.5, 0.85
#: Number of other lags that are refined.
MAX_ALTERNATIVES = 8
#: Of a long stream a stretch of this length is used [s], because over hours a skew blurs the correlation.
STRETCH_S = 240.0
#: Samples from which the noise of a signal is estimated.
NOISE_SAMPLES = 200_000
_HZ = 50.0
#: Half widths of the differences that give rates [s], and the accepted share of noise in a rate.
_WIDTHS_S, _NOISE_SHARE = (0.08, 0.16, 0.32, 0.64), 0.3


@dataclass(frozen=True)
class Pair:
    """One motion measured on both clocks; times in seconds from the start of the recording (x) and of the stream (y).

    ``backlash`` is the width that is allowed between the two, zero for none; ``noise`` is the standard deviation of the noise
    of x after smoothing [both: unit of x].
    """

    name: str
    x_times: Array
    x: Array
    y_times: Array
    y: Array
    degree: int
    x_gap_s: float
    backlash: float = 0.0
    noise: float = 0.0


@dataclass(frozen=True)
class Lag:
    """``t_machine = t + offset`` around ``centre`` [s of the stream]; ``refused``: why no lag is clearly the best.

    ``alternatives`` are the offsets of other lags that correlate almost as well.
    """

    offset: float = 0.0
    centre: float = 0.0
    refused: str = ""
    alternatives: tuple[float, ...] = ()


def coarse_lag(pairs: Sequence[Pair]) -> Lag:
    """The lag at which the rates of all pairs correlate best; ``refused`` where it is not clear.

    Magnitudes of the correlations are summed, because the sign of a map is unknown (a cylinder may close its joint).
    """
    step = 1.0 / _HZ
    start_x = min(float(pair.x_times[0]) for pair in pairs)
    start_y = min(float(pair.y_times[0]) for pair in pairs)
    count_x = int((max(float(pair.x_times[-1]) for pair in pairs) - start_x) / step) + 1
    count_y = int((max(float(pair.y_times[-1]) for pair in pairs) - start_y) / step) + 1
    rates = []
    for p in pairs:
        x, y = _on_grid(p.x_times, p.x, start_x, count_x), _on_grid(p.y_times, p.y, start_y, count_y)
        half = max(_half_width(x, noise_of(p.x)), _half_width(y, noise_of(p.y)))
        rates.append((_rates(x, half), _rates(y, half)))
    if (count_x - 1) * step > 2.0 * STRETCH_S and (count_y - 1) * step > 2.0 * STRETCH_S:
        first, last = _most_active([rate for _, (rate, _) in rates], round(STRETCH_S * _HZ))
    else:
        first, last = 0, count_y
    size = 1 << (count_x + last - first).bit_length()
    total = np.zeros(size)
    for (rate_x, known_x), (whole_y, known) in rates:
        rate_y, known_y = whole_y[first:last], known[first:last]
        cross = np.fft.irfft(np.fft.rfft(rate_x, size) * np.conj(np.fft.rfft(rate_y, size)), size)
        # Normalised by the energy of the overlap at that lag, with a floor against short overlaps at the ends.
        energy_x = np.fft.irfft(np.fft.rfft(rate_x**2, size) * np.conj(np.fft.rfft(known_y, size)), size)
        energy_y = np.fft.irfft(np.fft.rfft(known_x, size) * np.conj(np.fft.rfft(rate_y**2, size)), size)
        share = np.sum(rate_x**2) * min(1.0, (last - first) / count_x)
        floor = 0.25 * np.sqrt(share * np.sum(rate_y**2)) + 1e-300
        total += np.abs(cross) / np.maximum(np.sqrt(np.clip(energy_x, 0, None) * np.clip(energy_y, 0, None)), floor)
    total /= len(pairs)
    best = int(np.argmax(total))
    centre = start_y + (first + last) / 2.0 * step
    near = _alternatives(total, best)
    offset, *others = (((at if at < count_x else at - size) - first) * step + start_x - start_y for at in (best, *near))
    refused = ""
    if total[best] < MIN_CORRELATION:
        refused = f"the motions do not resemble each other at any lag (correlation {total[best]:.2f} at best)"
    elif near:
        refused = (
            f"{len(near) + 1} lags fit almost equally well (correlations {total[best]:.2f} and {total[near[0]]:.2f}): "
            f"the motion repeats itself"
        )
        return Lag(float(offset), float(centre), refused, tuple(map(float, others)))
    return Lag(float(offset), float(centre), refused)


def _alternatives(total: Array, best: int) -> list[int]:
    """Lags whose correlation is near that of the best, the highest first; a lobe ends where it falls below 70 %."""
    left = total.copy()
    found: list[int] = []
    at = best
    while True:
        turned = np.roll(left, -at)
        low = turned < 0.7 * turned[0]
        if not low.any():
            return found or [(best + 1) % len(total)]
        after, before = int(np.argmax(low)), int(np.argmax(low[::-1]))
        left[(at + np.arange(-before, after)) % len(left)] = -np.inf
        at = int(np.argmax(left))
        if left[at] <= MAX_ALTERNATIVE * total[best] or len(found) == MAX_ALTERNATIVES:
            return found
        found.append(at)


def _most_active(rates: Sequence[Array], count: int) -> tuple[int, int]:
    """First and last + 1 of the ``count`` samples with the most motion, each signal relative to its own energy."""
    energy = np.sum([rate**2 / max(float(np.sum(rate**2)), 1e-300) for rate in rates], axis=0)
    sums = np.concatenate([[0.0], np.cumsum(energy)])
    first = int(np.argmax(sums[count:] - sums[:-count]))
    return first, first + count


def noise_of(values: Array) -> float:
    """Standard deviation of the noise of a signal (n,), from second differences, in which smooth motion cancels."""
    there = chosen(values, ~np.isnan(values))[:NOISE_SAMPLES]
    return float(np.median(np.abs(np.diff(there, n=2)))) / 1.65 if len(there) > 2 else 0.0


def _on_grid(times: Array, values: Array, start: float, count: int) -> Array:
    """Values on the coarse grid, NaN where nothing was measured."""
    period = median_step(times)
    return interpolate(times, values, start + np.arange(count) / _HZ, max(3.5 * period, 0.2))


def _difference(values: Array, half: int) -> Array:
    rate = np.full(len(values), np.nan)
    rate[half:-half] = (values[2 * half :] - values[: -2 * half]) * (_HZ / (2 * half))
    return rate


def _half_width(values: Array, noise: float) -> int:
    """The shortest half width [samples] at which the rate is motion rather than noise."""
    for width in _WIDTHS_S:
        half = round(width * _HZ)
        rate = _difference(values, half)
        known = rate[~np.isnan(rate)]
        if noise / (np.sqrt(2.0) * width) < _NOISE_SHARE * (float(np.std(known)) if len(known) else np.inf):
            break
    return half


def _rates(values: Array, half: int) -> tuple[Array, Array]:
    """Rate on the coarse grid, zero where nothing was measured, and the mask of measured samples."""
    rate = _difference(values, half)
    known = ~np.isnan(rate)
    if known.any():  # clips mistaken frames
        limit = 1.5 * float(np.quantile(np.abs(rate[known]), 0.95))
        rate = np.clip(rate, -limit, limit)
    return np.where(known, rate, 0.0), known.astype(np.float64)
