"""``first_order_lag``: spool and pilot stage follow the command with a time constant."""

import math

import numpy as np

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

#: Smaller time constants are no lag [s].
ABSENT = 1e-6

EFFECT = Effect(
    name="first_order_lag",
    title="First-order lag",
    titles={"hydraulic": "Valve lag", "position": "Servo lag", "servo": "Lag of the setpoint"},
    sentences=("The {target} follows its command with a lag of {time_constant}.",),
    part="valve",
    stage="command",
    slots=(Slot("time_constant"),),
    forms=(Form((Parameter("time_constant", "s", (0.0, 2.0), (0.03, 0.1, 0.3), 0.005, "time constant"),)),),
    equation="T·ẋ = u − x, exact for a command held over the step",
    source="Merritt, Hydraulic Control Systems, 1967, ch. 7; 20–80 ms on small proportional valves (machine facts)",
    excited_by="starts, stops and reversals of the command",
    confused_with={
        "input_delay": "a delay has phase linear in frequency at flat gain; a lag smooths as well",
        "valve_hysteresis": "the loop of a hysteresis has the same width at any rate; that of a lag grows with the rate",
        "command_rate_limit": "a rate limit is a plateau of acceleration at large steps; a lag rises in proportion to the step",
    },
    example={"time_constant": 0.15},
    need=Need("command_changes", 10, "Record 20 sharp starts and stops of {axis}."),
    actuations=("velocity", "position", "servo"),
    memory=lambda dt: 3,
    surrogate_test=0.05,
)


@inlined
def across(u, p, i, s, j, dt):
    """x before a step of any length, and its mean over it; ``s[j]`` is x."""
    if np.isnan(s[j]) or p[i] < ABSENT:
        s[j] = u
        return u, u
    before, decay = s[j], math.exp(-dt / p[i])
    s[j] = u + (before - u) * decay
    return before, u + (before - u) * (1.0 - decay) * p[i] / dt


@inlined
def step(u, p, i, s, j, dt):
    """Mean of x over the step, so that integrating it gives the exact displacement.

    ``s[j]`` is x, ``s[j+1]`` the decay over a step, ``s[j+2]`` the mean of the decay over a step.
    """
    if np.isnan(s[j]):
        s[j] = u
    constant = p[i]
    if constant < ABSENT:
        s[j] = u
        return u
    if np.isnan(s[j + 1]):
        s[j + 1] = math.exp(-dt / constant)
        s[j + 2] = (1.0 - s[j + 1]) * constant / dt
    away = s[j] - u
    s[j] = u + away * s[j + 1]
    return u + away * s[j + 2]
