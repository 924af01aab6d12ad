"""``flow_saturation``: beyond some command the spool is fully open (or the pump at its limit) and the speed is constant."""

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

#: A command that no log reaches: the effect is absent.
ABSENT = 10.0

EFFECT = Effect(
    name="flow_saturation",
    title="Flow saturation",
    titles={"unknown": "Speed saturation"},
    sentences=("The {target} gets no faster beyond a command of {limit}.",),
    part="valve",
    stage="command",
    slots=(Slot("limit", ABSENT),),
    forms=(
        Form((Parameter("limit", "1", (0.02, ABSENT), (0.2, 0.4, 0.6, 0.8, 0.9, 0.96), 0.01, "speed is constant above it"),)),
    ),
    equation="y = max(−limit, min(limit, u))",
    source="Merritt 1967, ch. 5",
    excited_by="large commands on one axis at a time",
    confused_with={"gain_curve": "saturation has a corner and a plateau; a gain curve bends smoothly"},
    example={"limit": 0.5},
    need=Need("motion", 5, "Record {axis} alone at 60, 80 and 100 %, 5 s each."),
    actuations=("velocity",),
    surrogate_test=0.8,
)


@inlined
def step(u, p, i):
    return min(max(u, -p[i]), p[i])
