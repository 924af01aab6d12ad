"""``valve_deadband``: spool overlap: small commands cause no motion, with a limit for each side."""

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

_STARTS = (0.03, 0.12, 0.25, 0.5)

EFFECT = Effect(
    name="valve_deadband",
    title="Valve dead-band",
    sentences=(
        "The {target} does not move until its command exceeds +{positive} in one direction or −{negative} in the other.",
    ),
    titles={"unknown": "Command dead-band"},
    part="valve",
    stage="command",
    slots=(Slot("positive"), Slot("negative")),
    forms=(
        Form(
            (
                Parameter("positive", "1", (0.0, 0.95), _STARTS, 0.004, "largest command without motion"),
                Parameter("negative", "1", (0.0, 0.95), _STARTS, 0.004, "same on the negative side, magnitude"),
            )
        ),
    ),
    equation="y = u − positive above, u + negative below, 0 between; slope unchanged",
    source="Merritt 1967, §5.5; 11–22 % in PVG32 data, 43–67 % of half the span on a 1:14 excavator (machine facts)",
    excited_by="slow small commands on both sides of zero",
    example={"positive": 0.25, "negative": 0.15},
    need=Need("small_commands", 2, "Record {axis} with slow commands from 0 to 30 % and back on both sides, 30 s."),
    actuations=("velocity",),
    surrogate_test=0.04,
)


@inlined
def step(u, p, i):
    if u > p[i]:
        return u - p[i]
    if u < -p[i + 1]:
        return u + p[i + 1]
    return 0.0
