"""``command_rate_limit``: ramp in the valve driver or the joystick electronics."""

import math

import numpy as np

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

#: Faster than any log can show: the effect is absent.
ABSENT = 1e4
_STARTS = (0.5, 1.5, 4.0, 10.0, 40.0, 160.0)
#: A shorter lag, in steps, has settled at the end of a step.
SHORT = 0.03

EFFECT = Effect(
    name="command_rate_limit",
    title="Command rate limit",
    titles={"position": "Servo speed limit"},
    sentences=("The command of the {target} changes at {rate} at most.",),
    sentences_by={"position": ("The servo of the {target} moves at {rate} at most.",)},
    part="valve",
    stage="command",
    slots=(Slot("rate", ABSENT),),
    forms=(Form((Parameter("rate", "command/s", (0.05, ABSENT), _STARTS, 0.02, "largest change of the command"),)),),
    equation="|dy/dt| ≤ rate",
    source="data sheets of proportional valve amplifiers (ramp time)",
    excited_by="large sudden changes of the command",
    confused_with={"flow_saturation": "a rate limit is a plateau of acceleration; saturation is a plateau of speed"},
    example={"rate": 2.0},
    need=Need("command_changes", 10, "Record 10 sudden full commands of {axis}."),
    actuations=("velocity", "position"),
    memory=lambda dt: 2,
    surrogate_test=6.0,
)


@inlined
def step(u, p, i, s, j, dt):
    """Mean of the ramp over the step; ``s[j]`` is its end, ``s[j+1]`` the reciprocal of the largest change per step."""
    if np.isnan(s[j]):
        s[j] = u
    if p[i] >= ABSENT:
        s[j] = u
        return u
    reach = p[i] * dt
    if np.isnan(s[j + 1]):
        s[j + 1] = 1.0 / reach if reach > 0.0 else 0.0
    before = s[j]
    change = u - before
    if change > reach:
        s[j] = before + reach
        return before + 0.5 * reach
    if change < -reach:
        s[j] = before - reach
        return before - 0.5 * reach
    s[j] = u
    return u - 0.5 * change * abs(change) * s[j + 1]


@inlined
def held(u, lag, p, i, s, j, dt):
    """Input that has the effect of the ramp on a lag of time constant ``lag`` at the end of the step, if held over it.

    From L to L' in the time r, the lag goes from 0 to x = L' − ρT − (L − ρT)·e^(−r/T), ρ = (L' − L)/r, and then to
    L' + (x − L')·e^(−(dt − r)/T). Without a lag it is the end of the ramp.
    """
    if np.isnan(s[j]):
        s[j] = u
    before = s[j]
    if p[i] >= ABSENT or u == before:
        s[j] = u
        return u
    reach = p[i] * dt
    end = before + min(max(u - before, -reach), reach)
    s[j] = end
    if lag < SHORT * dt or end == before:
        return end
    slope = math.copysign(p[i], u - before)
    ramp = (end - before) / slope
    x = end - slope * lag - (before - slope * lag) * math.exp(-ramp / lag)
    x = end + (x - end) * math.exp(-(dt - ramp) / lag)
    return x / (1.0 - math.exp(-dt / lag))
