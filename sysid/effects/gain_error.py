"""``gain_error``: the axis is faster or slower than its nominal gain."""

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="gain_error",
    title="Wrong speed gain",
    sentences=("The {target} moves at {ratio} times the speed that the simulation assumes.",),
    beside={
        "valve_deadband": "Beyond its dead-band the {target} responds {ratio} times as strongly as the simulation assumes."
    },
    part="valve",
    stage="command",
    slots=(Slot("ratio", 1.0),),
    forms=(Form((Parameter("ratio", "1", (0.05, 20.0), (0.7, 1.3, 2.0), 0.01, "true gain / nominal gain"),)),),
    equation="v = ratio · gain · x",
    source="definition",
    excited_by="any motion",
    confused_with={"gain_curve": "a gain error changes all speeds by one ratio, a curve the low ones most"},
    need=Need("motion", 5, "Record {axis} moving over half of its range, 20 s."),
    actuations=("velocity",),
    proportional=True,
    surrogate_test=0.8,
)


@inlined
def step(x, p, i):
    return x * p[i]
