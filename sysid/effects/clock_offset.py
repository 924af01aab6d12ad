"""``clock_offset``: a stream's stamps are wrong by a constant time."""

from __future__ import annotations

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="clock_offset",
    stage="sensor",
    target="stream",
    slots=(Slot("offset"),),
    forms=(Form((Parameter("offset", "s", (-0.5, 0.5), (-0.05, -0.01, 0.01, 0.05), 0.002, "t_machine − t_stream"),)),),
    equation="t_machine = t_stream + offset",
    source="definition; latency of motion capture 5–30 ms (machine facts)",
    excited_by="motion that both clocks see",
    confused_with=("input_delay", "clock_skew", "first_order_lag"),
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
