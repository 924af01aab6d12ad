"""``coulomb_friction``: a constant force against the motion; holds the axis below break-away."""

from __future__ import annotations

from numba import njit

from sysid.effects.effect import Effect, Form, Parameter, Slot

_BOUNDS = (0.0, 1e6)

EFFECT = Effect(
    name="coulomb_friction",
    stage="force",
    target="axis",
    slots=(Slot("positive"), Slot("negative")),
    forms=(
        Form((Parameter("force", "N or N·m", _BOUNDS, (1.0,), 0.0, "magnitude", sets=(("positive", "negative"),)),)),
        Form(
            (
                Parameter("positive", "N or N·m", _BOUNDS, (1.0,), 0.0, "magnitude while moving in the positive direction"),
                Parameter("negative", "N or N·m", _BOUNDS, (1.0,), 0.0, "magnitude while moving in the negative direction"),
            )
        ),
    ),
    equation="f = F·sign(v); at rest any force up to F",
    source="Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994)",
    excited_by="motion in both directions with slow changes of sign",
    confused_with=("stribeck_friction", "load_bias", "viscous_friction"),
    actuations=("force",),
)


@njit(inline="always")
def force(v, p, i):
    """Force against the motion at speed ``v`` [N or N·m]."""
    return p[i] if v > 0.0 else -p[i + 1] if v < 0.0 else 0.0


@njit(inline="always")
def limit(v, p, i):
    """Largest magnitude that friction can oppose to a motion of the sign of ``v``."""
    return p[i] if v >= 0.0 else p[i + 1]
