"""Noise of a sensor from its own samples, including quantisation."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np
from scipy.special import gammaincinv

from sysid.datasets.chunked import Array, copied, differences, ends, known, median_of, remembered
from sysid.scratch import chosen, leave

#: Samples of a sensor this far apart are independent [s], for any sensor above 17 Hz.
LAG_S = 0.06
#: A signal that varies by less than this share of its magnitude (at least of :data:`SMALLEST`, rad or m) contains only rounding
#: of floating-point numbers: it does not move.
ROUNDING, SMALLEST = 1e-9, 1e-3
#: Degrees of the local polynomials that follow the motion, and quantiles of the windows whose scatter may be that of the noise.
#: A decrease of the scatter by this factor from one degree to the next is due to motion: noise, also coloured noise of real
#: sensors, decreases by at most 2.5.
DEGREES, QUIET, FALLS = (5, 7), (0.2, 0.5), 3.0
#: Orders of difference for a motion that no degree follows, and for an upper bound of the noise.
FINEST, BOUND = 8, 4
#: Windows that are fitted together, and fits after which pages are unmapped (:func:`sysid.scratch.leave`).
_WINDOWS, _FITS = 2**11, 8


@remembered
def noise_of(values: Array, rate_hz: float) -> float:
    """Standard deviation of a sensor's noise [unit of the signal], from its own samples, moving or not.

    :func:`white_noise`; for a quantised sensor at least the uniform error of a step. NaN where the motion is too fast for the
    rate, and for a signal that does not change.
    """
    low, high = ends(values)
    if is_still(values) and high > low:
        return float("nan")
    scatter, rounding = white_noise(values, rate_hz), _step(values) / math.sqrt(12.0)
    if math.isnan(scatter):
        return rounding if rounding > 0.0 else scatter
    return max(scatter, rounding)


def is_still(values: Array) -> bool:
    """Whether a signal (n,) does not vary by more than rounding of floating-point numbers."""
    low, high = ends(values)
    return not high - low > ROUNDING * max(high, -low, SMALLEST)


def white_noise(values: Array, rate_hz: float) -> float:
    """Standard deviation of the noise of a signal (n,), including quantisation; NaN where it is not separable from motion.

    Scatter about polynomials over 0.2 s (at least ten samples) in the quietest fifth of the windows, of those that change at
    all: a motion with stops and jerks in every second of them hides no noise in these; slower noise is not included. For a fast
    motion at a low rate the degree increases as long as this removes most of the scatter. Where differences of order 8 follow
    the motion better than all polynomials, the noise is unknown.
    """
    for scatter, finer in itertools.pairwise(_scatters(values, rate_hz)):
        if not scatter > FALLS * finer:
            return scatter
    return float("nan")


def _scatters(values: Array, rate_hz: float) -> Iterator[float]:
    """Standard deviation of noise by the windows of least scatter about polynomials of each degree, 0 where none changes; then
    by the finest differences. Nothing where no window is without gaps.
    """
    width = max(round(0.2 * rate_hz), 10)
    windows = values[: len(values) // width * width].reshape(-1, width)
    bases = [np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, width), degree + 1))[0] for degree in DEGREES]
    whole, sums = 0, [list[Array]() for _ in DEGREES]
    for number, first in enumerate(range(0, len(windows), _WINDOWS)):
        some = windows[first : first + _WINDOWS]
        low, high = some.min(axis=1), some.max(axis=1)  # NaN with a gap
        whole += int(np.count_nonzero(~np.isnan(high)))
        some = some[high - low > ROUNDING * np.maximum(np.maximum(high, -low), SMALLEST)]
        centred = some - some.mean(axis=1, keepdims=True)
        for basis, own in zip(bases, sums, strict=True):
            residual = centred @ basis @ basis.T
            np.subtract(centred, residual, out=residual)
            own.append(np.sum(np.square(residual, out=residual), axis=1))
        if number % _FITS == _FITS - 1:
            leave()
    if not whole:
        return
    for degree, own in zip(DEGREES, sums, strict=True):
        found, freedom = np.concatenate(own), width - degree - 1
        # Quantiles of the sums of squares of normal errors are those of chi-squared.
        shares = np.quantile(found, QUIET) / (2.0 * gammaincinv(0.5 * freedom, QUIET)) if len(found) else 0.0
        yield float(np.sqrt(np.min(shares)))
    yield difference_scatter(values, FINEST)


def noise_bound(values: Array) -> float:
    """Upper bound of the noise of a signal (n,) where the motion is too fast: its scatter about cubics through five samples.

    From differences of order 4; NaN with too few samples.
    """
    return difference_scatter(values, BOUND)


def difference_scatter(values: Array, order: int) -> float:
    """Standard deviation of white noise from the median absolute difference of an order of a signal (n,); NaN if too short.

    A normalised difference of order k passes white noise with a gain of one and a motion of frequency f with about
    sin(πf/rate)^k (Gasser, Sroka and Jennen-Steinmetz, Biometrika 73 (1986) 625: residual variance from differences).
    """

    def sizes(first: int, last: int) -> Array:
        return known(np.abs(np.diff(values[first : last + order], order)))

    return 1.4826 * median_of([(max(len(values) - order, 0), sizes)], least=3) / math.sqrt(math.comb(2 * order, order))


@remembered
def table_noise(values: Array, rate_hz: float) -> float:
    """Noise of a signal in an aligned table [unit of the signal], also where its sensor is slower than the table.

    The median second difference over :data:`LAG_S`, in which steady motion cancels, or :func:`noise_of` if larger: between the
    samples of a slow sensor a table is smooth, whatever its noise. Fast motion counts in part; zero with too few rows.
    """
    there = known(values)
    lag = max(round(LAG_S * rate_hz), 1)
    if len(there) <= 2 * lag:
        return 0.0

    def second(first: int, last: int) -> Array:
        return np.abs(there[first + 2 * lag : last + 2 * lag] - 2.0 * there[first + lag : last + lag] + there[first:last])

    # The median of |x| of a normal variable is 0.6745 σ; a second difference has the variance of six samples.
    scatter = median_of([(len(there) - 2 * lag, second)]) / (0.6745 * math.sqrt(6.0))
    fine = noise_of(there, rate_hz)
    return scatter if math.isnan(fine) else max(scatter, fine)


def _step(values: Array) -> float:
    """The quantisation step; 0 where values do not repeat."""
    there = known(values)
    for count in (math.ceil(0.3 * len(there)), len(there)):  # a part may show that there are too many levels
        ordered = copied(there[:count])
        ordered.sort()
        new = np.ones(len(ordered), dtype=bool)
        new[1:] = ordered[1:] != ordered[:-1]
        levels = np.count_nonzero(new)
        if levels > len(there) / 4:
            return 0.0
    if levels < 2:
        return 0.0
    gaps = differences(chosen(ordered, new))
    return float(chosen(gaps, gaps > 1e-6 * (ordered[-1] - ordered[0])).min())
