"""``clock_skew``: rate error of the clock of a stream."""

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="clock_skew",
    title="Clock skew",
    sentences=("The clock of {target} runs at a different rate ({skew} ppm).",),
    part="clock",
    stage="sensor",
    target="stream",
    slots=(Slot("skew"),),
    forms=(Form((Parameter("skew", "ppm", (-5000.0, 5000.0), (-200.0, 200.0), 20.0, "machine clock against stream clock"),)),),
    equation="t_machine = t_stream·(1 + 10⁻⁶·skew), t from the start of the recording",
    source="definition; 10–200 ppm between unsynchronised clocks (machine facts)",
    excited_by="minutes of motion recorded with both clocks",
    confused_with={"input_delay": "a skew grows over the recording; a delay is constant"},
    example={"skew": -5000.0},
    exempt=("causal", "finite", "time_invariant", "memoryless"),
    need=Need("longest_any_motion", 60, "Record motion with both devices for five minutes or more without interruption."),
)


@inlined
def machine_time(t, p, i):
    """Machine time of a stamp ``t`` of the stream [s]."""
    return t * (1.0 + 1e-6 * p[i])


@inlined
def stream_time(t, p, i):
    """The stamp that the stream gives to machine time ``t`` [s]."""
    return t / (1.0 + 1e-6 * p[i])
