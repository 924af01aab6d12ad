"""``oil_compressibility``: the oil column is a spring; the speed responds to the valve as a second-order system."""

import math

import numpy as np

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

#: Faster than any log can show: the effect is absent.
ABSENT = 1e3
#: State: speed and its slope, and the coefficients of a step.
MEMORY = 8

EFFECT = Effect(
    name="oil_compressibility",
    title="Oil spring",
    titles={"unknown": "Drive resonance"},
    sentences=("The {target} oscillates at {frequency} on the compressed oil.",),
    sentences_by={"unknown": ("The {target} oscillates at {frequency} on the compliance of its drive.",)},
    part="cylinder",
    stage="command",
    slots=(Slot("frequency", ABSENT), Slot("damping_ratio", 0.1)),
    forms=(
        Form(
            (
                Parameter("frequency", "Hz", (1.0, ABSENT), (4.0, 7.0, 12.0), 0.3, "natural frequency of load on oil"),
                Parameter("damping_ratio", "1", (0.005, 0.6), (0.05, 0.2), 0.5, "of the oscillation", secondary=True),
            )
        ),
    ),
    equation="v̈ + 2ζω·v̇ + ω²·(v − u) = 0, ω = 2π·frequency, exact for a speed demand held over the step",
    source="hydraulic natural frequency, Merritt 1967, §6.2; 5–13 Hz at 1:5, ζ 0.05–0.2 (machine facts)",
    excited_by="sharp starts and stops, sampled at ten times the frequency",
    confused_with={
        "first_order_lag": "a lag has no overshoot; oil oscillates, and moves on after the command stops",
        "input_delay": "a delay has no overshoot; oil oscillates at its natural frequency",
    },
    example={"frequency": 5.0, "damping_ratio": 0.1},
    need=Need("command_changes", 10, "Record 20 sharp starts and stops of {axis}, at 100 Hz or more."),
    actuations=("velocity",),
    memory=lambda dt: MEMORY,
)


@inlined
def step(u, p, i, s, j, dt):
    """Mean of v over the step, so that integrating it gives the exact displacement."""
    if p[i] >= ABSENT:
        return u
    if np.isnan(s[j]):
        s[j] = u
        s[j + 1] = 0.0
    if np.isnan(s[j + 2]):
        omega = 2.0 * math.pi * p[i]
        fade = p[i + 1] * omega
        damped = omega * math.sqrt(1.0 - p[i + 1] * p[i + 1])
        decay = math.exp(-fade * dt)
        sine = decay * math.sin(damped * dt) / damped
        cosine = decay * math.cos(damped * dt)
        s[j + 2] = cosine + fade * sine
        s[j + 3] = sine
        s[j + 4] = -omega * omega * sine
        s[j + 5] = cosine - fade * sine
        s[j + 6] = 2.0 * fade
        s[j + 7] = 1.0 / (omega * omega * dt)
    x = s[j] - u
    v = s[j + 1]
    after = s[j + 2] * x + s[j + 3] * v
    slope = s[j + 4] * x + s[j + 5] * v
    # The differential equation itself, integrated over the step.
    mean = u - ((slope - v) + s[j + 6] * (after - x)) * s[j + 7]
    s[j] = u + after
    s[j + 1] = slope
    return mean
