"""Notch of the force comparison of a drive with a spring: weights by the noise that the antiresonance amplifies.

At measured motion the force (Jm + Jl·H(s))·a contains the noise of the acceleration, amplified near the antiresonance ω₀ by

    A(s) = (1 + r·H(s))/(1 + r),     r = Jl/Jm,     |A(jω₀)| ≈ r/(2ζ·(1 + r)),

since the motor stands nearly still there. Other errors of the motion and of the spring are amplified in the same way. Least
squares with equal weights gives friction, which acts at all frequencies, the values that suit this error. Generalised least
squares divides by the spectrum of the noise (Aitken 1936): both forces are multiplied by 1/|A| where that is below one. The
amplification is one again where |ω² − ω₀²| is about r/(1 + r) of ω₀², which a quarter of this as damping ratio of the
denominator describes; the numerator gives the gain 1/|A| at ω₀.
"""

from __future__ import annotations

import math

from sysid.gap.drive_resonance import DriveResonance
from sysid.plant.notch import Notch


def drive_notch(drive: DriveResonance) -> Notch | None:
    """The notch at the antiresonance of a drive; None where its damping is too large to amplify."""
    share = drive.inertia_ratio / (1.0 + drive.inertia_ratio)
    gain = 2.0 * drive.damping_ratio / share
    width = 0.25 * share
    return Notch(drive.antiresonance_hz, width * math.sqrt(gain), width) if gain < 1.0 else None
