"""``viscous_friction``: a force in proportion to speed, against it."""

from __future__ import annotations

from numba import njit

from sysid.effects.effect import Effect, Form, Parameter, Slot

_BOUNDS = (0.0, 1e7)

EFFECT = Effect(
    name="viscous_friction",
    stage="force",
    target="axis",
    slots=(Slot("positive"), Slot("negative")),
    forms=(
        Form((Parameter("coefficient", "N·s/m or N·m·s", _BOUNDS, (1.0,), 0.0, "slope", sets=(("positive", "negative"),)),)),
        Form(
            (
                Parameter("positive", "N·s/m or N·m·s", _BOUNDS, (1.0,), 0.0, "slope in the positive direction"),
                Parameter("negative", "N·s/m or N·m·s", _BOUNDS, (1.0,), 0.0, "slope in the negative direction"),
            )
        ),
    ),
    equation="f = coefficient·v",
    source="Armstrong-Hélouvry et al., Automatica 30 (1994)",
    excited_by="motion at several speeds",
    confused_with=("coulomb_friction", "stribeck_friction"),
    actuations=("force",),
)


@njit(inline="always")
def force(v, p, i):
    """Force against the motion at speed ``v`` [N or N·m]."""
    return p[i] * v if v > 0.0 else p[i + 1] * v
