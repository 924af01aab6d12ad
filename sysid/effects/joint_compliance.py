"""``joint_compliance``: structure and oil deflect under the weight of the arm (sag)."""

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="joint_compliance",
    title="Joint compliance",
    sentences=("The {target} deflects under the gravity moment that it carries ({compliance}).",),
    part="joint",
    stage="joint",
    slots=(Slot("compliance"),),
    forms=(
        Form(
            (
                Parameter(
                    "compliance",
                    "m/N or rad/(N·m)",
                    (0.0, 10.0),
                    (1e-3, 5e-3),
                    2e-4,
                    "deflection under the gravity moment or force",
                    scale="1/load",
                ),
            )
        ),
    ),
    equation="q = q₀ − compliance·L(q), L the gravity moment of the deflected posture, L > 0 where it opposes positive motion",
    source="Siciliano et al., Robotics, 2009, §6.6; 0.25° for 2e4 N·m/rad (machine facts)",
    excited_by="poses with the arm extended and retracted",
    confused_with={
        "link_length_error": "sag follows the gravity moment, downwards; a length error follows the link",
        "backlash": "backlash changes with the direction of motion; sag with the load, at rest too",
    },
    example={"compliance": 0.01},
    exempt=("time_invariant", "memoryless"),
    need=Need("load_change", 20, "Record {axis} at the same angles with the arm extended and retracted."),
    actuations=("velocity", "position", "force"),
    sides=("drive", "structure"),
)


@inlined
def step(q, p, i, load):
    """``load``: gravity moment [N·m] or force [N] about or along the joint."""
    return q - p[i] * load
