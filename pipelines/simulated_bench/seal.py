"""Seal friction with elastic bristles (LuGre): sticking, break-away, and sliding with the Stribeck effect.

    ż = v − σ0·|v|/g(v)·z,   F = σ0·z + σ1·ż·e^(−(v/vs)²) + σ2·v,   g(v) = Fc + (Fs − Fc)·e^(−(v/vs)²).

Source: Canudas de Wit, Olsson, Åström, Lischinsky, IEEE Trans. Automatic Control 40 (1995) 419.
"""

from __future__ import annotations

import math

from simulated_bench.compiled import compiled

#: σ1/σ0: damping of the bristles over their stiffness [s].
BRISTLE_TIME = 3e-4


@compiled
def seal_step(
    bristle: float, speed: float, coulomb: float, static: float, stribeck: float, viscous: float, stiffness: float, step: float
) -> tuple[float, float]:
    """Bristle deflection after ``step`` [m] and the friction force against the motion [N]."""
    if coulomb <= 0.0:
        return 0.0, viscous * speed
    near = math.exp(-((speed / stribeck) ** 2))
    level = coulomb + (max(static, coulomb) - coulomb) * near
    rate = stiffness * abs(speed) / level
    # Exact for a constant speed over the step: never beyond the sliding deflection.
    if rate * step > 1e-9:
        end = math.copysign(level / stiffness, speed)
        after = end + (bristle - end) * math.exp(-rate * step)
    else:
        after = bristle + speed * step
    slip = (after - bristle) / step
    return after, stiffness * after + BRISTLE_TIME * stiffness * slip * near + viscous * speed
