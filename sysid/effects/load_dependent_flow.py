"""``load_dependent_flow``: the load reduces the pressure drop at the valve, so that lifting is slower than lowering."""

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="load_dependent_flow",
    title="Load-dependent flow",
    titles={"unknown": "Load-dependent speed"},
    sentences=("The load changes the speed of the {target}: slower against it, faster with it ({coefficient}).",),
    part="valve",
    stage="command",
    slots=(Slot("coefficient"),),
    forms=(
        Form(
            (
                Parameter(
                    "coefficient",
                    "1/N or 1/(N·m)",
                    (-0.5, 0.5),
                    (0.05, 0.2),
                    0.01,
                    "relative loss of speed per N·m of gravity moment (or N of load) against the motion",
                    scale="1/load",
                ),
            )
        ),
    ),
    equation="v = x·(1 − coefficient·L·sign(x)), L > 0 where gravity opposes positive motion of the drive",
    source="Q = Cd·w·x·√(2Δp/ρ), Merritt 1967, ch. 5, linear in Δp; ×0.80–0.89 up, ×1.16–1.23 down (machine facts)",
    excited_by="motion both ways at several reaches",
    confused_with={
        "asymmetric_gain": "over the gravity moment, unequal gain is the intercept of the speed ratio up/down, load its slope",
        "temperature_drift": "load follows the pose, warm-up the time: compare the same motion early and late",
    },
    example={"coefficient": 0.04},
    exempt=("time_invariant", "memoryless"),
    need=Need("load_change", 20, "Record {axis} up and down with the arm extended and retracted, 20 s each."),
    actuations=("velocity",),
)


@inlined
def step(x, p, i, load):
    """``load`` on the drive [N·m or N]; a load that would reverse the motion stops it."""
    if x > 0.0:
        return x * max(1.0 - p[i] * load, 0.0)
    return x * max(1.0 + p[i] * load, 0.0)
