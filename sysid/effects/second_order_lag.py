"""``second_order_lag``: the control loop of a servo against the inertia of its load, with overshoot or without."""

import numpy as np

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot
from sysid.effects.oscillator import transition

#: Time constants below this are absent [s].
ABSENT = 1e-6
#: State: position and its rate, the coefficients of a step, and from ``LOAD`` on the deflecting load and its rate.
MEMORY, LOAD = 8, 6

EFFECT = Effect(
    name="second_order_lag",
    title="Second-order lag",
    titles={"position": "Second-order lag of the servo"},
    sentences=(
        "The {target} follows its command with a second-order lag of {time_constant}, damping ratio {damping_ratio}.",
        "The {target} follows its command with a second-order lag of {time_constant}.",
    ),
    part="valve",
    stage="command",
    slots=(Slot("time_constant"), Slot("damping_ratio", 0.7)),
    forms=(
        Form(
            (
                Parameter(
                    "time_constant", "s", (0.0, 0.5), (0.03, 0.06, 0.1), 0.003, "1/ω, ω the natural frequency of the loop"
                ),
                Parameter("damping_ratio", "1", (0.03, 4.0), (0.7,), 0.1, "of the closed loop", secondary=True),
            )
        ),
    ),
    equation="T²·ẍ + 2ζT·ẋ + x = u, exact for a command held over the step; sag follows its load in the same way",
    source="proportional control with damping of an inertia: Siciliano et al., Robotics, 2009, §8.3",
    excited_by="starts, stops and reversals of the command",
    confused_with={
        "first_order_lag": "a first-order lag begins to move with its full speed at once; a second-order lag accelerates first",
        "input_delay": "a delay does not smooth; a second-order lag also begins slowly, and may overshoot",
        "command_rate_limit": "a rate limit is a plateau of speed at large steps; a lag rises in proportion to the step",
    },
    example={"time_constant": 0.06, "damping_ratio": 0.5},
    need=Need("command_changes", 10, "Record 20 sharp starts and stops of {axis}."),
    actuations=("position",),
    generalises=("first_order_lag",),
    memory=lambda dt: MEMORY,
)


@inlined
def step(u, p, i, s, j, dt):
    """Position at the end of the step."""
    if p[i] < ABSENT:
        return u
    if np.isnan(s[j + 2]):
        transition(1.0 / p[i], p[i + 1], s, j + 2, dt)
    return _advance(u, s, j, j + 2)


@inlined
def follow_load(load, p, i, s, j, dt):
    """Let the deflecting load of the step follow the gravity ``load``; missing loads leave it as it is."""
    if p[i] < ABSENT or np.isnan(load):
        return
    if np.isnan(s[j + 2]):
        transition(1.0 / p[i], p[i + 1], s, j + 2, dt)
    _advance(load, s, j + LOAD, j + 2)


@inlined
def deflecting_load(load, p, i, s, j):
    """The load under which the axis sags: behind the loop, or ``load`` itself where it is absent or has not begun."""
    if p[i] < ABSENT or np.isnan(s[j + LOAD]):
        return load
    return s[j + LOAD]


@inlined
def _advance(u, s, at, c):
    """Advance the state at ``at`` by a step with the input ``u``; a state that has not begun is at rest there."""
    if np.isnan(s[at]):
        s[at] = u
        s[at + 1] = 0.0
        return u
    x, v = s[at] - u, s[at + 1]
    s[at] = u + s[c] * x + s[c + 1] * v
    s[at + 1] = s[c + 2] * x + s[c + 3] * v
    return s[at]
