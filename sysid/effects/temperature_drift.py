"""``temperature_drift``: as the oil warms up, the gain changes from its cold to its warm value."""

import math

import numpy as np

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="temperature_drift",
    title="Warm-up drift",
    sentences=("As the oil warms up, the speed of the {target} drifts by {fraction}.",),
    sentences_by={"unknown": ("As the drive warms up, the speed of the {target} drifts by {fraction}.",)},
    part="valve",
    stage="command",
    slots=(Slot("fraction"), Slot("time_constant", 600.0)),
    forms=(
        Form(
            (
                Parameter(
                    "fraction",
                    "1",
                    (-0.6, 0.6),
                    (-0.1, 0.1, -0.1, 0.1, -0.1, 0.1),
                    0.01,
                    "increase of the gain when warm, as a share of the cold one",
                ),
                Parameter(
                    "time_constant",
                    "s",
                    (5.0, 7200.0),
                    (100.0, 100.0, 10.0, 10.0, 1000.0, 1000.0),
                    1200.0,
                    "of warming up, from the first sample",
                    secondary=True,
                ),
            )
        ),
    ),
    equation="v = gain·x·(1 + fraction·(1 − e^(−t/time_constant))), t from the start of the recording",
    source="viscosity of hydraulic oil over temperature: Jelali & Kroll 2003, §3.3; 5–20 % (machine facts)",
    excited_by="the same motion early and late in a recording of minutes",
    confused_with={"gain_error": "a gain error is constant; warm-up changes with time: compare the same motion early and late"},
    example={"fraction": 0.3, "time_constant": 5.0},
    exempt=("time_invariant",),
    need=Need("longest_motion", 60, "Record {axis} moving evenly to and fro for ten minutes from a cold start."),
    actuations=("velocity",),
    proportional=True,
    memory=lambda dt: 2,
)


@inlined
def step(x, p, i, s, j, dt):
    """``s[j]`` is e^(−t/T), ``s[j+1]`` its factor in a step; set ``s[j]`` before the first step to begin later."""
    if p[i] == 0.0:
        return x
    if np.isnan(s[j]):
        s[j] = 1.0
    if np.isnan(s[j + 1]):
        s[j + 1] = math.exp(-dt / p[i + 1])
    y = x * (1.0 + p[i] * (1.0 - s[j]))
    s[j] *= s[j + 1]
    return y
