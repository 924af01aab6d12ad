"""Damping of a hanging tool by feedback: the tip moves after the tool.

With d: horizontal position of the tool relative to the tip, and a tip that adds x to its planned position,
``d̈ + 2ζω·ḋ + ω²·d = −ẍ``. The offset ``x = −2ζ_a·ḋ/ω`` gives ``ẍ ≈ 2ζ_a·ω·ḋ`` at the frequency of the swing, where
d⃛ = −ω²·ḋ: the damping ratio becomes ζ + ζ_a. The machine follows after its dead time θ, so the swing is predicted by the
rotation of the free pendulum::

    ḋ(t + θ)/ω = (ḋ/ω)·cos ωθ − d·sin ωθ

An axis follows the speed of its setpoint with the gain 1/(ΩT) at high frequencies Ω, where T is its lag; the loop then has the
gain 2ζ_a/(ωT). Below one, so for ``ζ_a < ωT/2`` with the shortest lag, it is stable there for any dead time.

Source: delayed feedback of the sway, Masoud, Nayfeh and Al-Mousa, Journal of Vibration and Control 9 (2003); there the delay
is tuned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid_rl.control.pendulum import Pendulum

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class SwingDamper:
    """The feedback.

    Args:
        pendulum: identified.
        damping_ratio: ζ_a that it adds.
        dead_time: θ of the machine [s].
    """

    pendulum: Pendulum
    damping_ratio: float
    dead_time: float

    def offset(self, below: Array, speed: Array) -> Array:
        """Offsets (n, 3) [m] of the tips.

        Args:
            below, speed: position [m] and speed [m/s] of the tools relative to the tips, (n, 3).
        """
        angle = self.pendulum.frequency * self.dead_time
        rate = speed / self.pendulum.frequency * math.cos(angle) - below * math.sin(angle)
        return np.asarray(-2.0 * self.damping_ratio * rate * [1.0, 1.0, 0.0])
