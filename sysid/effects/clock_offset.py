"""``clock_offset``: constant error of the time stamps of a stream."""

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="clock_offset",
    title="Clock offset",
    sentences=("The clock of {target} is off by {offset}.",),
    part="clock",
    stage="sensor",
    target="stream",
    slots=(Slot("offset"),),
    forms=(Form((Parameter("offset", "s", (-0.5, 0.5), (-0.05, -0.01, 0.01, 0.05), 0.002, "t_machine − t_stream"),)),),
    equation="t_machine = t_stream + offset",
    source="definition; latency of motion capture 5–30 ms (machine facts)",
    excited_by="motion recorded with both clocks",
    confused_with={
        "input_delay": "an offset shifts every channel of one device alike, including those without a command",
        "clock_skew": "an offset is constant over a recording; a skew grows with time: compare motion early and late",
        "first_order_lag": "an offset shifts without smoothing, including channels without a command",
    },
    example={"offset": -0.3},
    exempt=("causal", "finite", "time_invariant", "memoryless"),
    need=Need("any_motion", 10, "Record fast starts and stops with both devices."),
)


@inlined
def machine_time(t, p, i):
    """Machine time of a stamp ``t`` of the stream [s]."""
    return t + p[i]


@inlined
def stream_time(t, p, i):
    """The stamp that the stream gives to machine time ``t`` [s]."""
    return t - p[i]
