"""One step of a servo: its controller, dry and viscous friction and inertia, as one implicit equation; compiled.

The speed of a step is ``w = (1 − θ)·v + θ·v′`` from the speeds v before and v′ after it. ``M·(v′ − v)/h`` equals the forces at
the speed w and at the position ``x + h·w/2`` in the middle of the step, so that the error falls with h². θ makes the decay of
the speed by damping exact: 1/2 (trapezoidal rule) where damping is slow against the step, towards 1 (implicit Euler) where
it is fast, so that a stiff servo on a light link is stable. Dry friction acts on v′ and may stop the motion, not reverse it.

Where the steps of the described simulator fill a step between samples, they are taken as they are: w = v′, with the forces at
the position and speed before the step, of which damping alone is implicit.

Source: MuJoCo 4, *Computation*, numerical integration, and constraint model (friction loss); exponentially fitted θ: Liniger
and Willoughby, SIAM J. Numer. Anal. 7 (1970), 47–66.
"""

from __future__ import annotations

import math

from sysid.effects.compiled import inlined

#: Largest step over the time in which the controller corrects an error: errors of a step are below a thousandth there.
SHARE = 0.15
#: Most steps between two samples; beyond it, motion that is faster than the steps is damped.
MOST = 200


@inlined
def substeps(kp, damping, mass, dt):
    """Steps within ``dt`` for a servo: an overdamped one corrects errors at the rate kp/damping, else at √(kp/mass)."""
    slow = max(math.sqrt(kp * mass), damping)
    return MOST if kp * dt >= SHARE * MOST * slow else max(math.ceil(kp * dt / (SHARE * slow)), 1)


@inlined
def rotor_alone(armature, kp, h):
    """Inertia of a rotor that crosses a backlash: one that the controller turns back within a step follows it instead."""
    return max(armature, kp * h * h)


@inlined
def own_steps(half, dt):
    """Steps of the described simulator within ``dt``, from half of one [s]; 0 where it has none, or they do not fill it."""
    if half <= 0.0:
        return 0
    count = math.floor(0.5 * dt / half + 0.5)
    return count if abs(2.0 * half * count - dt) < 1e-6 * dt else 0


@inlined
def weight(z):
    """θ for a decay of the speed by exp(−z) in the step."""
    if z < 0.5:
        return 0.5 + z / 12.0 * (1.0 - z * z / 60.0)
    return 1.0 / (1.0 - math.exp(-z)) - 1.0 / z


@inlined
def held(earlier, later, part, k, count):
    """Mean over step ``k`` of ``count`` between two samples of a command that changes after the share ``part``."""
    change = part * count - k
    if change <= 0.0:
        return later
    return earlier if change >= 1.0 else change * earlier + (1.0 - change) * later


@inlined
def rub(free, resistance, v, theta, h, dry, give, time):
    """Speed after a step: ``resistance·v′ = free`` behind dry friction of at most ``dry``.

    Friction that does not give way may hold, and does not reverse the motion. Otherwise it is ``(w + time·(v′ − v)/h)/give`` up
    to ``dry``, as a constraint of MuJoCo makes it.
    """
    if give == 0.0:
        if abs(free) <= dry:
            return 0.0
        return (free - math.copysign(dry, free)) / resistance
    ahead = time / h
    after = (give * free - ((1.0 - theta) - ahead) * v) / (give * resistance + theta + ahead)
    friction = (1.0 - theta) * v + theta * after + ahead * (after - v)  # times ``give``
    if abs(friction) <= give * dry:
        return after
    return (free - math.copysign(dry, friction)) / resistance
