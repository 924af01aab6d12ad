"""``input_delay``: the command acts after a constant time (bus, valve electronics, oil column)."""

import math

import numpy as np

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

#: The longest delay a plant can hold [s]; 0.7 s is reported for a full-size walking excavator (machine facts).
LONGEST = 0.8


def _memory(dt: float) -> int:
    return math.ceil(LONGEST / dt) + 6


EFFECT = Effect(
    name="input_delay",
    title="Dead time",
    sentences=("The {target} starts to react only {delay} after the command.",),
    part="valve",
    stage="command",
    slots=(Slot("delay"),),
    forms=(Form((Parameter("delay", "s", (0.0, LONGEST), (0.02, 0.06, 0.15, 0.3), 0.005, "dead time"),)),),
    equation="y(t) = u(t − delay), linear between samples",
    source="Ljung, System Identification, 2nd ed., §4.2",
    excited_by="command changes that are short against the recording",
    example={"delay": 0.15},
    need=Need("command_changes", 10, "Record 20 sharp starts and stops of {axis}."),
    actuations=("velocity", "position", "servo"),
    memory=_memory,
    surrogate_test=0.05,
)


@inlined
def retime(p, i, s, j, dt):
    """Apply the delay of ``p`` to the held samples."""
    if not np.isnan(s[j]):
        s[j + 1] = math.floor(p[i] / dt)
        s[j + 2] = p[i] / dt - s[j + 1]


@inlined
def fill(u, p, i, s, j, size, dt):
    """Fill the buffer as after a long constant input ``u``."""
    s[j] = 0.0
    retime(p, i, s, j, dt)
    for k in range(j + 3, j + size):
        s[k] = u


@inlined
def put(u, s, j, size, back):
    """Before the first step: the input ``back`` ≥ 1 steps earlier."""
    s[j + size - back] = u


@inlined
def ends(u, p, i, s, j, size, dt):
    """The two held inputs that act in this step, the later first, and the share of the step in which the earlier one acts.

    Ring buffer at ``s[j+3 : j+size]``, its head in ``s[j]``, whole steps of the delay and the rest in the two after it.
    """
    ring = size - 3
    first = j + 3
    if np.isnan(s[j]):
        fill(u, p, i, s, j, size, dt)
    head = int(s[j])
    s[first + head] = u
    near = head - int(s[j + 1])
    if near < 0:
        near += ring
    far = near - 1
    if far < 0:
        far += ring
    head += 1
    if head == ring:
        head = 0
    s[j] = head
    return s[first + near], s[first + far], s[j + 2]


@inlined
def step(u, p, i, s, j, size, dt):
    """Linear interpolation is exact for the integral of a held command over the step, so the delay is a smooth parameter."""
    later, earlier, part = ends(u, p, i, s, j, size, dt)
    return (1.0 - part) * later + part * earlier
