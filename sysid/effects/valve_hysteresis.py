"""``valve_hysteresis``: friction and magnetic remanence of the spool: the opening follows the command with hysteresis."""

import numpy as np

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="valve_hysteresis",
    title="Spool hysteresis",
    titles={"unknown": "Command hysteresis"},
    sentences=("The spool of the {target} has a hysteresis of {width} of its command.",),
    sentences_by={"unknown": ("The drive of the {target} has a hysteresis of {width} of its command.",)},
    part="valve",
    stage="command",
    slots=(Slot("width"),),
    forms=(Form((Parameter("width", "1", (0.0, 0.5), (0.02, 0.06, 0.15), 0.004, "full width, in command"),)),),
    equation="y = min(max(y, u − width/2), u + width/2)",
    source="Jelali & Kroll 2003, §3.4; 1–6 % on proportional valves (machine facts)",
    excited_by="command reversals at any rate, small ones included",
    confused_with={"input_delay": "a delay is a time independent of amplitude; a hysteresis loses a fixed part of the command"},
    example={"width": 0.15},
    rate_independent=True,
    need=Need("command_changes", 10, "Record 20 slow reversals of the command of {axis} around three values."),
    actuations=("velocity",),
    memory=lambda dt: 1,
)


@inlined
def step(u, p, i, s, j):
    """``s[j]`` is the output; it starts in the middle of the hysteresis."""
    half = 0.5 * p[i]
    if np.isnan(s[j]):
        s[j] = u
    if s[j] > u + half:
        s[j] = u + half
    elif s[j] < u - half:
        s[j] = u - half
    return s[j]
