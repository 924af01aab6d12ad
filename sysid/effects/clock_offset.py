"""``clock_offset``: a stream's stamps are wrong by a constant time."""

from __future__ import annotations

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
    excited_by="motion that both clocks see",
    confused_with={
        "input_delay": "an offset shifts every channel of one device alike, those without a command too",
        "clock_skew": "constant over a recording, or growing with it: motion early and late",
        "first_order_lag": "an offset shifts without smoothing, and channels without a command too",
    },
    example={"offset": -0.3},
    exempt=("causal", "finite", "time_invariant", "memoryless"),
    need=Need("any_motion", 10, "Record brisk starts and stops that both devices see."),
)


@inlined
def machine_time(t, p, i):
    """Machine time of a stamp ``t`` of the stream [s]."""
    return t + p[i]


@inlined
def stream_time(t, p, i):
    """The stamp that the stream gives to machine time ``t`` [s]."""
    return t - p[i]
