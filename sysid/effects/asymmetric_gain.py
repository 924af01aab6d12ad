"""``asymmetric_gain``: a differential cylinder runs faster where the oil fills the rod side."""

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="asymmetric_gain",
    title="Unequal speeds",
    sentences=("The {target} moves {ratio} times as fast in the negative direction as in the positive one.",),
    part="valve",
    stage="command",
    slots=(Slot("ratio", 1.0),),
    forms=(Form((Parameter("ratio", "1", (0.2, 5.0), (0.7, 1.4), 0.01, "speed at −1 / speed at +1, magnitudes"),)),),
    equation="v = ratio·x for x < 0, x otherwise",
    source="Jelali & Kroll, Hydraulic Servo-systems, 2003, §4.2; area ratios 1.46–1.64 (machine facts)",
    excited_by="motion in both directions",
    confused_with={
        "valve_deadband": "a ratio of speeds grows with the command; unequal dead-bands shift by a constant",
        "gain_error": "an unequal gain changes one direction alone, a gain error both alike",
        "temperature_drift": "an unequal gain is there from the start, warm-up grows with time: compare early and late motion",
    },
    need=Need("motion_both_ways", 3, "Record {axis} at 30, 60 and 100 % in both directions, 5 s each."),
    actuations=("velocity",),
    proportional=True,
    surrogate_test=0.9,
)


@inlined
def step(x, p, i):
    return x * p[i] if x < 0.0 else x
