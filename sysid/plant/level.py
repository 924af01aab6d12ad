"""Levels of a measured stretch and its differences from a simulated one: median, spread, mean, line; compiled."""

from __future__ import annotations

import numpy as np

from sysid.effects.compiled import inlined, loop

#: A median and its spread are computed from this number of samples.
MEDIAN_SAMPLES = 64
#: Distance between the quartiles of a normal distribution [standard deviations].
INTERQUARTILE_RANGE = 1.349
#: An axis has left its rest when it is away from it by this share of its range.
MOVED = 0.05


@inlined
def _sort(values, count):
    """The first ``count`` values in order."""
    for k in range(1, count):
        x = values[k]
        at = k
        while at > 0 and values[at - 1] > x:
            values[at] = values[at - 1]
            at -= 1
        values[at] = x


@loop
def median(values, count):
    """Median of the first ``count`` values, zero of none; sorts them."""
    _sort(values, count)
    return 0.5 * (values[(count - 1) // 2] + values[count // 2]) if count else 0.0


@loop
def middle_and_spread(measured, simulated, first, last, most, scratch):
    """Median and standard deviation (by quartiles) of the last ``most`` differences measured − simulated; NaN of none."""
    count, k = np.int64(0), last  # a literal 0 has another type and would be compiled separately
    stride = 1 + most // MEDIAN_SAMPLES
    seen = 0
    while k > first and seen < most:
        k -= 1
        if not np.isnan(measured[k]):
            if seen % stride == 0:
                scratch[count] = measured[k] - simulated[k]
                count += 1
            seen += 1
    if count == 0:
        return np.nan, np.nan
    _sort(scratch, count)
    middle = 0.5 * (scratch[(count - 1) // 2] + scratch[count // 2])
    return middle, (scratch[(3 * count - 1) // 4] - scratch[count // 4]) / INTERQUARTILE_RANGE


@loop
def shift(measured, simulated, first, last, most, middle, bound):
    """Mean of the last ``most`` differences measured − simulated, without those further than ``bound`` from ``middle``."""
    count, k, total = 0, last, 0.0
    while k > first and count < most:
        k -= 1
        if not np.isnan(measured[k]):
            away = measured[k] - simulated[k] - middle
            if abs(away) <= bound:
                total += away
                count += 1
    return middle + total / count if count else middle


@loop
def first_motion(measured, first, last):
    """First sample that is away from the first value by :data:`MOVED` of the range of the stretch; ``first`` of none."""
    origin, low, high = np.nan, np.inf, -np.inf
    for k in range(first, last):
        if not np.isnan(measured[k]):
            origin = measured[k] if np.isnan(origin) else origin
            low, high = min(low, measured[k]), max(high, measured[k])
    for k in range(first, last):
        if abs(measured[k] - origin) > MOVED * (high - low):
            return k
    return first


@loop
def mean(measured, simulated, first, last):
    """Mean of the differences measured − simulated; 0 of none."""
    count, total = 0, 0.0
    for k in range(first, last):
        if not np.isnan(measured[k]):
            count += 1
            total += measured[k] - simulated[k]
    return total / count if count else 0.0


@loop
def line(values, less, first, last):
    """Least-squares line through ``values − less``: its value at sample ``first`` and its slope [1/sample]; 0 of none."""
    n = 0
    st = 0.0
    sy = 0.0
    for k in range(first, last):
        if not np.isnan(values[k]):
            n += 1
            st += k - first
            sy += values[k] - less[k]
    if n == 0:
        return 0.0, 0.0
    top = 0.0
    bottom = 0.0
    for k in range(first, last):
        if not np.isnan(values[k]):
            top += (k - first - st / n) * (values[k] - less[k] - sy / n)
            bottom += (k - first - st / n) ** 2
    rise = top / bottom if n > 2 else 0.0
    return sy / n - rise * st / n, rise
