"""A notch that both forces of a comparison pass, forward and backward, where the noise of the motion is amplified."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import signal

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Notch:
    """(s² + 2·depth·ω·s + ω²)/(s² + 2·width·ω·s + ω²), ω = 2π·frequency_hz; its gain at ω is (depth/width)², run both ways.

    Args:
        frequency_hz: below half the sample rate.
        depth, width: damping ratios of numerator and denominator.
    """

    frequency_hz: float
    depth: float
    width: float

    def section(self, rate_hz: float) -> Array:
        """Its second-order section (1, 6) by the bilinear transform, exact at its frequency."""
        omega = 2.0 * rate_hz * np.tan(np.pi * self.frequency_hz / rate_hz)
        numerator, denominator = ([1.0, 2.0 * ratio * omega, omega**2] for ratio in (self.depth, self.width))
        return np.concatenate(signal.bilinear(numerator, denominator, fs=rate_hz))[None]
