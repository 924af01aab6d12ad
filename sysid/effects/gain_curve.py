"""``gain_curve``: the metering edge opens progressively; speed grows with a power of the command."""

import math

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="gain_curve",
    title="Curved valve gain",
    titles={"unknown": "Nonlinear gain"},
    sentences=("The speed of the {target} follows its command to the power of {exponent}.",),
    part="valve",
    stage="command",
    slots=(Slot("exponent", 1.0),),
    forms=(Form((Parameter("exponent", "1", (0.3, 5.0), (0.7, 1.5, 2.5), 0.02, "power of the command"),)),),
    equation="y = sign(u)·|u|^exponent",
    source="Jelali & Kroll 2003, §3.2 (progressive spools)",
    excited_by="commands of many magnitudes on both sides",
    confused_with={
        "valve_deadband": "at medium commands a dead-band is a shifted line, a gain curve a curve through the origin"
    },
    example={"exponent": 2.0},
    need=Need("small_commands", 2, "Record {axis} at 10, 20, 40, 70 and 100 % in both directions, 5 s each."),
    actuations=("velocity",),
    surrogate_test=1.2,
)


@inlined
def step(u, p, i):
    if p[i] == 1.0 or u == 0.0:
        return u
    return math.copysign(abs(u) ** p[i], u)
