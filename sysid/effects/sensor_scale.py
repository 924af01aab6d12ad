"""``sensor_scale``: scale error of a sensor (wrong drum radius, wrong conversion factor)."""

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="sensor_scale",
    title="Sensor scale",
    sentences=("The sensor {target} reads {scale} times the true value.",),
    part="sensor",
    stage="sensor",
    target="signal",
    slots=(Slot("scale", 1.0),),
    forms=(Form((Parameter("scale", "1", (0.2, 5.0), (0.97, 1.03), 2e-3, "measured / true"),)),),
    equation="measured = scale·true",
    source="definition; draw-wire sensors 0.02–0.1 % of full scale (machine facts)",
    excited_by="motion over the range, compared with a second sensor of the same motion",
    confused_with={
        "gain_error": "a scaled sensor also disagrees with every other sensor of the same motion",
        "link_length_error": "a scale error is proportional to the reading; a length error is fixed along a link",
    },
    example={"scale": 1.1},
    need=Need("signal_travel", 10, "Record {axis} over its whole range together with the sensors before and behind it."),
)


@inlined
def step(x, p, i):
    return x * p[i]


@inlined
def undo(y, p, i):
    """The true value behind a measured one."""
    return y / p[i]
