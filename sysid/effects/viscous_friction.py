"""``viscous_friction``: force against the motion, proportional to the speed."""

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

_BOUNDS, _SLOPE = (0.0, 1e7), "N·s/m or N·m·s/rad"

EFFECT = Effect(
    name="viscous_friction",
    title="Viscous friction",
    sentences=(
        "The {target} is braked by friction in proportion to its speed ({coefficient}).",
        "The {target} is braked in proportion to its speed, by {positive} forwards and {negative} backwards.",
    ),
    part="cylinder",
    stage="force",
    slots=(Slot("positive"), Slot("negative")),
    forms=(
        Form(
            (Parameter("coefficient", _SLOPE, _BOUNDS, (1.0,), 0.01, "slope", scale="force", sets=(("positive", "negative"),)),)
        ),
        Form(
            (
                Parameter("positive", _SLOPE, _BOUNDS, (1.0,), 0.01, "slope in the positive direction", scale="force"),
                Parameter("negative", _SLOPE, _BOUNDS, (1.0,), 0.01, "slope in the negative direction", scale="force"),
            )
        ),
    ),
    equation="f = coefficient·v",
    source="Armstrong-Hélouvry et al., Automatica 30 (1994)",
    excited_by="motion at several speeds",
    confused_with={
        "coulomb_friction": "dry friction is constant over speed, viscous friction proportional: compare two speeds"
    },
    example={"coefficient": 4.0},
    need=Need("force_both_ways", 1, "Record {axis} at three speeds in both directions, 20 s."),
    actuations=("force", "servo"),
)


@inlined
def force(v, p, i):
    """Force against the motion at speed ``v`` [N or N·m]."""
    return p[i] * v if v > 0.0 else p[i + 1] * v
