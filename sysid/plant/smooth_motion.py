"""Position, speed and acceleration of a measured joint: zero-phase low-pass and differences.

Source: Gautier, Janot, Vandanjon, IEEE TCST 21 (2013).
"""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt
import scipy

Array = npt.NDArray[np.float64]

#: Least cut-off of the position [Hz], and order of its Butterworth filter in one direction.
POSITION_HZ, ORDER = 50.0, 4
#: Highest cut-off of a filter [share of the sample rate].
HIGHEST = 0.4


def smooth_motion(
    position: Array, rate_hz: float, cut_hz: float = POSITION_HZ, order: int = ORDER
) -> tuple[Array, Array, Array]:
    """Low-passed position, speed and acceleration of positions (n,), each (n,); missing readings are interpolated."""
    there = np.flatnonzero(~np.isnan(position))
    filled = np.interp(np.arange(len(position)), there, position[there])
    smooth = scipy.signal.sosfiltfilt(
        _low_pass(order, min(cut_hz, HIGHEST * rate_hz), rate_hz), filled, padlen=min(3 * (order + 1), len(filled) - 1)
    )
    return smooth, np.gradient(smooth, 1.0 / rate_hz), second_difference(smooth) * rate_hz**2


@functools.cache
def _low_pass(order: int, cut_hz: float, rate_hz: float) -> Array:
    """Second-order sections, (sections, 6)."""
    return np.asarray(scipy.signal.butter(order, cut_hz, fs=rate_hz, output="sos"))


def second_difference(values: Array) -> Array:
    """x_(k+1) − 2·x_k + x_(k−1), repeated at both ends, (n,)."""
    inner = np.diff(values, 2)
    return np.concatenate([inner[:1], inner, inner[-1:]])
