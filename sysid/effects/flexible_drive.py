"""``flexible_drive``: a spring and a damper between motor and load, which oscillate against each other."""

import math

import numpy as np

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot
from sysid.effects.oscillator import transition

#: Frequency above which the drive is rigid [Hz].
ABSENT = 1e3
#: State of a run: twist of the spring, speed of the load, and the transition matrix of a substep.
MEMORY = 6
#: State of a force at measured motion: twist, its rate, their transition matrix, and the acceleration before.
INVERSE_MEMORY = 7
#: Longest substep, in the inverse circular frequency of the resonance: friction changes with each half oscillation.
LONGEST = 1.0

EFFECT = Effect(
    name="flexible_drive",
    title="Flexible drive",
    sentences=(
        "The motor of the {target} moves a load of {inertia_ratio} times its inertia through a spring: the load oscillates at "
        "{frequency} while the motor is held.",
        "The load of the {target} oscillates at {frequency} on the spring of its drive.",
    ),
    part="cylinder",
    stage="force",
    slots=(Slot("frequency", ABSENT), Slot("damping_ratio", 0.05), Slot("inertia_ratio")),
    forms=(
        Form(
            (
                Parameter(
                    "frequency", "Hz", (1.0, ABSENT), (15.0,), 0.1, "of the load while the motor is held (antiresonance)",
                    scale="response",
                ),
                Parameter(
                    "damping_ratio", "1", (0.001, 0.6), (0.03,), 0.02, "of the load while the motor is held", secondary=True,
                    scale="response",
                ),
                Parameter(
                    "inertia_ratio", "1", (0.0, 100.0), (1.0,), 0.02, "inertia of the load / inertia of the motor",
                    scale="response",
                ),
            )
        ),
    ),
    equation="F = (Jm + Jl·H(s))·a, H = (2ζω·s + ω²)/(s² + 2ζω·s + ω²), ω = 2π·frequency, Jl = inertia_ratio·Jm, Jm + Jl = M",
    source="two-mass drive: Zhang and Furusho, Speed control of two-inertia system by PI/PID control, IEEE TIE 47 (2000)",
    excited_by="forces and motion around the antiresonance and above it",
    confused_with={
        "inertia_error": "a wrong inertia is the same at all frequencies; above its resonance a flexible drive moves like the "
        "motor alone",
        "viscous_friction": "the damper of the spring acts around the antiresonance, viscous friction at all frequencies",
        "oil_compressibility": "the same spring behind a motor whose speed is commanded shows its load alone: velocity axes",
    },
    example={"frequency": 2.0, "damping_ratio": 0.05, "inertia_ratio": 2.0},
    need=Need(
        "force_changes", 10, "Record {axis} with a multisine or steps up to twice its resonance, sampled at ten times as much."
    ),
    actuations=("force",),
    memory=lambda dt: MEMORY,
)  # fmt: skip


@inlined
def load_acceleration(a, p, i, s, j, dt):
    """Acceleration of the load at a sample at which the motor has the acceleration ``a`` [m/s² or rad/s²].

    Exact for an acceleration that is linear between samples; the state at the first sample is that of a constant one.
    """
    omega = 2.0 * math.pi * p[i]
    square, fade = omega * omega, 2.0 * p[i + 1] * omega
    if np.isnan(s[j]):
        s[j], s[j + 1] = a / square, 0.0
        transition(omega, p[i + 1], s, j + 2, dt)
    else:
        rate = (a - s[j + 6]) / (dt * square)  # of the twist that follows the acceleration
        x, v = s[j] - (s[j + 6] - fade * rate) / square, s[j + 1] - rate
        s[j] = (a - fade * rate) / square + s[j + 2] * x + s[j + 3] * v
        s[j + 1] = rate + s[j + 4] * x + s[j + 5] * v
    s[j + 6] = a
    return square * s[j] + fade * s[j + 1]


@inlined
def mean(motor, load, p, i):
    """Mean of values of motor and load by their inertias: that of the centre of mass."""
    return (motor + p[i + 2] * load) / (1.0 + p[i + 2])


@inlined
def substeps(p, i, dt):
    """Number of substeps of a step of a run."""
    return max(1, math.ceil(2.0 * math.pi * p[i] * math.sqrt(1.0 + p[i + 2]) * dt / LONGEST))


@inlined
def begin(v, p, i, s, j, dt):
    """State before the first substep of ``dt``: no twist, motor and load with speed ``v``."""
    if np.isnan(s[j]):
        s[j], s[j + 1] = 0.0, v
    if np.isnan(s[j + 2]):
        root = math.sqrt(1.0 + p[i + 2])
        transition(2.0 * math.pi * p[i] * root, p[i + 1] * root, s, j + 2, dt)


@inlined
def free_speed(v, p, i, s, j):
    """Speed of the motor after a substep without force; the centre of mass keeps its speed."""
    share = p[i + 2] / (1.0 + p[i + 2])
    twisting = v - s[j + 1]
    return v + share * (s[j + 4] * s[j] + s[j + 5] * twisting - twisting)


@inlined
def mobility(mass, p, i, s, j, dt):
    """Speed of the motor after a substep per force held over it; ``mass`` of motor and load together."""
    square = (2.0 * math.pi * p[i]) ** 2 * (1.0 + p[i + 2])
    return dt / mass - s[j + 4] * p[i + 2] / (mass * square)


@inlined
def advance(force, v, mass, p, i, s, j, dt):
    """Twist and speed of the load after a substep with a held force on the motor of speed ``v``; returns its displacement."""
    ratio = p[i + 2]
    share, motor = ratio / (1.0 + ratio), mass / (1.0 + ratio)
    still = force / (motor * (2.0 * math.pi * p[i]) ** 2 * (1.0 + ratio))  # twist at which the spring balances the force
    twist, twisting = s[j], v - s[j + 1]
    centre = v - share * twisting
    s[j] = still + s[j + 2] * (twist - still) + s[j + 3] * twisting
    after = s[j + 4] * (twist - still) + s[j + 5] * twisting
    faster = centre + dt * force / mass
    s[j + 1] = faster - (1.0 - share) * after
    return dt * 0.5 * (centre + faster) + share * (s[j] - twist)
