"""``sensor_bias``: constant error of a sensor."""

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="sensor_bias",
    title="Sensor bias",
    sentences=("The sensor {target} has a bias of {bias}.",),
    part="sensor",
    stage="sensor",
    target="signal",
    slots=(Slot("bias"),),
    forms=(Form((Parameter("bias", "signal", (-0.5, 0.5), (-0.01, 0.01), 2e-4, "measured − true"),)),),
    equation="measured = true + bias",
    source="definition; Everett, Sensors for Mobile Robots, 1995, ch. 1",
    excited_by="comparison with a second sensor of the same motion",
    confused_with={
        "joint_offset": "a biased joint sensor also disagrees with the cylinder through the linkage; an offset only with the "
        "structure",
        "base_misalignment": "a shift of a measured point is not distinguishable from one of the base, and reported as that",
        "internal_leakage": "the error of leakage grows while the axis rests; a bias is constant",
        "sensor_scale": "a bias is the same everywhere; a scale error grows with the reading",
    },
    example={"bias": 0.05},
    need=Need("signal_travel", 10, "Record {axis} over its whole range together with the sensors before and behind it."),
)


@inlined
def step(x, p, i):
    return x + p[i]


@inlined
def undo(y, p, i):
    """The true value behind a measured one."""
    return y - p[i]
