"""``coulomb_friction``: constant force against the motion, which holds the axis at rest below break-away."""

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

_BOUNDS, _FORCE = (0.0, 1e6), "N or N·m"

EFFECT = Effect(
    name="coulomb_friction",
    title="Dry friction",
    sentences=(
        "Dry friction of {force} acts against the motion of the {target}.",
        "Dry friction of {positive} (forwards) and {negative} (backwards) acts against the motion of the {target}.",
    ),
    part="cylinder",
    stage="force",
    slots=(Slot("positive"), Slot("negative")),
    forms=(
        Form(
            (Parameter("force", _FORCE, _BOUNDS, (1.0,), 0.01, "magnitude", scale="force", sets=(("positive", "negative"),)),)
        ),
        Form(
            (
                Parameter("positive", _FORCE, _BOUNDS, (1.0,), 0.01, "in the positive direction", scale="force"),
                Parameter("negative", _FORCE, _BOUNDS, (1.0,), 0.01, "in the negative direction", scale="force"),
            )
        ),
    ),
    equation="f = F·sign(v); at rest any force up to F",
    source="Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994)",
    excited_by="motion in both directions with slow changes of sign",
    example={"force": 1.5},
    need=Need("force_both_ways", 1, "Record {axis} moving slowly in both directions, with several stops, 20 s."),
    actuations=("force", "servo"),
)


@inlined
def force(v, p, i):
    """Force against the motion at speed ``v`` [N or N·m]."""
    return p[i] if v > 0.0 else -p[i + 1] if v < 0.0 else 0.0


@inlined
def limit(v, p, i):
    """Largest magnitude that friction can oppose to a motion of the sign of ``v``."""
    return p[i] if v >= 0.0 else p[i + 1]
