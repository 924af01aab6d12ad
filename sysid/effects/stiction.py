"""``stiction``: spool or seals stick: no motion until the command reaches break-away, then full flow until release.

Seals stick behind the valve: the speed that it demands frees them. A spool sticks at its centre, in front of its metering edges
and its lag: its command frees it, the same on both sides whatever their overlap.
"""

import numpy as np

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

#: Smallest share of its flow that a valve meters: below it the axis is at rest.
REST = 1e-4
_BOUNDS = (0.0, 0.95)

EFFECT = Effect(
    name="stiction",
    title="Stiction",
    sentences=(
        "The {target} sticks until its command reaches {breakaway} and stops again at {release}.",
        "The {target} sticks until its command reaches {breakaway}.",
        "The valve spool of the {target} sticks at its centre until the command exceeds its overlap by {spool_breakaway}.",
    ),
    part="cylinder",
    stage="command",
    slots=(Slot("breakaway"), Slot("release"), Slot("spool_breakaway"), Slot("spool_release")),
    forms=(
        Form(
            (
                Parameter(
                    "breakaway",
                    "1",
                    _BOUNDS,
                    (0.015, 0.05, 0.15, 0.3),
                    0.004,
                    "effective command at which motion begins",
                    stepwise=True,
                ),
                Parameter(
                    "release",
                    "1",
                    _BOUNDS,
                    (0.005, 0.02, 0.05, 0.15),
                    0.004,
                    "effective command at which it ends",
                    stepwise=True,
                    secondary=True,
                ),
            )
        ),
        Form(
            (
                Parameter(
                    "spool_breakaway",
                    "1",
                    _BOUNDS,
                    (0.3, 0.15, 0.05, 0.015),
                    0.004,
                    "a spool that sticks at its centre: command beyond the smaller overlap that frees it",
                    stepwise=True,
                ),
                Parameter(
                    "spool_release",
                    "1",
                    _BOUNDS,
                    (0.03, 0.01, 0.002, 0.001),
                    0.004,
                    "opening, behind its lag, below which it sticks again",
                    stepwise=True,
                    secondary=True,
                ),
            ),
            part="valve",
        ),
    ),
    equation=f"at rest until |x| > breakaway, then y = x until |x| < release ({REST:g} at the least)",
    source="Karnopp, J. Dyn. Syst. Meas. Control 107 (1985); spools: Sweeney, Engineering 172 (1951), hydraulic lock",
    excited_by="slow starts from rest and slow stops on both sides",
    confused_with={
        "valve_deadband": "a dead-band starts and stops motion at one command; stiction starts it higher, with a jump"
    },
    example={"breakaway": 0.35, "release": 0.12},
    need=Need("command_changes", 10, "Record 20 slow starts from rest and slow stops of {axis} on both sides."),
    actuations=("velocity",),
    memory=lambda dt: 1,
)


@inlined
def step(v, p, i, s, j, gain):
    """Seals: speed ``v`` is ``gain``·effective command; ``s[j]`` is 1 while moving.

    The release is between :data:`REST`, since a lag never reaches zero, and the break-away.
    """
    if np.isnan(s[j]):
        s[j] = 0.0
    size = abs(v)
    if s[j] == 0.0:
        if size > p[i] * gain:
            s[j] = 1.0
    elif size < min(max(p[i + 1], REST), p[i]) * gain:
        s[j] = 0.0
    return v if s[j] == 1.0 else 0.0


@inlined
def sticks(p, i, x):
    """Whether a spool with the opening ``x`` sticks at its centre."""
    return p[i + 2] > 0.0 and abs(x) < max(p[i + 3], REST)


@inlined
def frees_at(p, i, deadband):
    """Command that frees the spool, on both sides; the parameters of the overlaps begin at ``deadband``."""
    return p[i + 2] + min(p[deadband], p[deadband + 1])


@inlined
def freed(u, positive, negative):
    """Demanded opening of a spool that sticks at its centre until the demand reaches ``positive`` or −``negative``."""
    return 0.0 if -negative < u < positive else u
