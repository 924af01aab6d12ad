"""Position, speed and acceleration of a measured joint: zero-phase low-pass and central differences.

Source: Gautier, Janot, Vandanjon, IEEE TCST 21 (2013).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import signal

Array = npt.NDArray[np.float64]

#: Cut-off of the position [Hz], and order of its Butterworth filter in one direction.
POSITION_HZ, ORDER = 50.0, 4


def smooth_motion(
    position: Array, rate_hz: float, cut_hz: float = POSITION_HZ, order: int = ORDER
) -> tuple[Array, Array, Array]:
    """Low-passed position, speed and acceleration of positions (n,), each (n,); missing readings are interpolated."""
    there = np.flatnonzero(~np.isnan(position))
    filled = np.interp(np.arange(len(position)), there, position[there])
    smooth = signal.sosfiltfilt(signal.butter(order, min(cut_hz, 0.4 * rate_hz), fs=rate_hz, output="sos"), filled)
    speed = np.gradient(smooth, 1.0 / rate_hz)
    return smooth, speed, np.gradient(speed, 1.0 / rate_hz)
