"""How noisy a sensor is, from its own samples, and the steps in which it counts."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from sysid.datasets.in_pieces import absolute, copied, differences, known, median
from sysid.scratch import chosen, computed

Array = npt.NDArray[np.float64]

#: Samples of a sensor this far apart are independent [s]: of any sensor above 17 Hz.
LAG_S = 0.06
#: A signal that varies by less than this share of its magnitude (at least of :data:`SMALLEST`, rad or m) shows rounding of
#: floating-point numbers: it does not move, and says nothing of its sensor.
DUST, SMALLEST = 1e-9, 1e-3
#: Degrees of the local polynomials that follow the motion, and by which factor scatter falls from one to the next where it is
#: motion that the lower one does not follow: noise, also coloured noise of real sensors, falls by 2.5 at the most.
DEGREES, FALLS = (3, 5, 7), 3.0
#: Orders of difference that scatter is told from where no degree follows the motion, and that bounds it.
FINEST, BOUND = 8, 4
#: Windows that are fitted together.
_WINDOWS = 2**14


def noise_of(values: Array, rate_hz: float) -> float:
    """Standard deviation of a sensor's noise [unit of the signal], from its own samples, whether it moves or not.

    :func:`white_noise`; where the sensor counts in steps, at least the uniform error of a step. NaN where the motion is too
    fast for the rate to tell noise from it, and for a signal that does not change at all.
    """
    if is_still(values) and not np.isnan(values).all() and np.nanmax(values) > np.nanmin(values):
        return float("nan")
    scatter, rounding = white_noise(values, rate_hz), _step(values) / math.sqrt(12.0)
    if math.isnan(scatter):
        return rounding if rounding > 0.0 else scatter
    return max(scatter, rounding)


def is_still(values: Array) -> bool:
    """Whether a signal (n,) varies by rounding of floating-point numbers alone, or not at all."""
    there = known(values)
    return not len(there) or float(np.ptp(there)) <= DUST * max(float(there.max()), -float(there.min()), SMALLEST)


def white_noise(values: Array, rate_hz: float) -> float:
    """Standard deviation of the noise of a signal (n,), rounding to steps included; NaN where it cannot be told from motion.

    Median of the scatter about polynomials over a fifth of a second (at least ten samples): a cubic follows most motion of a
    machine over that time, the median leaves out what it does not follow (stops, jerks); noise slower than that is not seen.
    What a cubic leaves of a fast motion at a low rate is not noise: the degree rises as long as that takes most of the scatter
    away. A motion that differences of order 8 still follow better than all of them leaves the noise unknown.
    """
    windows = _windows(values, rate_hz)
    if not len(windows):
        return float("nan")
    scatters = [_scatter(windows, degree) for degree in DEGREES]
    for scatter, finer in zip(scatters, [*scatters[1:], difference_scatter(values, FINEST)], strict=True):
        if not scatter > FALLS * finer:
            return scatter
    return float("nan")


def _scatter(windows: Array, degree: int) -> float:
    """Median standard deviation of windows (m, width) about polynomials."""
    width = windows.shape[1]
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, width), degree + 1))[0]
    sums = []
    for first in range(0, len(windows), _WINDOWS):
        some = windows[first : first + _WINDOWS]
        centred = some - some.mean(axis=1, keepdims=True)
        residual = centred - centred @ basis @ basis.T
        sums.append(np.sum(residual**2, axis=1))
    return float(np.sqrt(np.median(np.concatenate(sums)) / (width - degree - 1)))


def noise_bound(values: Array) -> float:
    """The most that the noise of a signal (n,) can be, where motion is too fast to tell: its scatter about local cubics.

    Those of five neighbouring samples, from differences of order 4; NaN where there are too few samples.
    """
    return difference_scatter(values, BOUND)


def difference_scatter(values: Array, order: int) -> float:
    """Standard deviation of white noise that the median difference of an order of a signal (n,) amounts to; NaN without any.

    A difference of order k passes white noise with a gain of one and a motion of frequency f with one of about sin(πf/rate)^k
    (Gasser, Sroka and Jennen-Steinmetz, Biometrika 73 (1986) 625: residual variance from differences).
    """
    sizes = known(absolute(differences(values, order)))
    if len(sizes) < 3:
        return float("nan")
    return 1.4826 * median(sizes) / math.sqrt(math.comb(2 * order, order))


def _windows(values: Array, rate_hz: float) -> Array:
    """Stretches of a fifth of a second without gaps, (m, width)."""
    width = max(round(0.2 * rate_hz), 10)
    count = len(values) // width
    windows = values[: count * width].reshape(count, width)
    whole = ~np.isnan(windows).any(axis=1)
    return chosen(windows.reshape(-1), np.repeat(whole, width)).reshape(-1, width)


def unsteadiness(values: Array, rate_hz: float) -> float:
    """Noise of a signal in an aligned table [unit of the signal], not too small where its sensor is slower than the table.

    The median second difference over :data:`LAG_S`, which leaves out steady motion, or :func:`noise_of` where that is more:
    between the samples of a slow sensor a table is smooth, whatever its noise. Quick motion counts in part; zero where there
    are too few rows to tell.
    """
    there = known(values)
    lag = max(round(LAG_S * rate_hz), 1)
    if len(there) <= 2 * lag:
        return 0.0

    def second(first: int, last: int) -> Array:
        return np.abs(there[first + 2 * lag : last + 2 * lag] - 2.0 * there[first + lag : last + lag] + there[first:last])

    # Of a normal variable half the values lie within 0.6745 standard deviations; a second difference has those of six samples.
    scatter = median(computed(len(there) - 2 * lag, second)) / (0.6745 * math.sqrt(6.0))
    fine = noise_of(there, rate_hz)
    return scatter if math.isnan(fine) else max(scatter, fine)


def _step(values: Array) -> float:
    """The sensor's quantum; 0 where its values do not repeat."""
    ordered = copied(known(values))
    ordered.sort()
    new = np.ones(len(ordered), dtype=bool)
    new[1:] = ordered[1:] != ordered[:-1]
    levels = np.count_nonzero(new)
    if levels < 2 or levels > len(ordered) / 4:
        return 0.0
    gaps = differences(chosen(ordered, new))
    return float(chosen(gaps, gaps > 1e-6 * (ordered[-1] - ordered[0])).min())
