"""The control law, compiled: setpoints and measured positions of all copies → valve commands.

    e = r(t) − y(t);  v = feed·ṙ(t + θ) + Kp·e + I  (+ backlash compensation where the setpoint reverses)
    effective = (v/gain)^(1/exponent);  command = effective + dead-band of that direction, limited in rate and range

The setpoint of a step is for ``preview`` after the end of the step. With preview the speed is fed forward by the dead time θ,
so that the axis is not late.
"""

from __future__ import annotations

import math

import numpy as np

from sysid.effects.compiled import inlined, kernel
from sysid_rl.control.tuning import INTEGRAL_SHARE, REST_SHARE, AxisTuning

(
    SERVO, UP, DOWN, EXPONENT, POSITIVE, NEGATIVE, LIMIT, CREEP, BACKLASH, DEAD_TIME, PROPORTIONAL, INTEGRAL, FEED, RATE,
    LOW, HIGH,
) = range(len(AxisTuning.__dataclass_fields__))  # fmt: skip

#: State of an axis: integral [speed], last command, position in the backlash; then past setpoints, the newest first.
INTEGRAL_SUM, LAST, POSITION, RING = range(4)


@inlined
def _past(s, steps):
    """The setpoint ``steps`` ago, linearly interpolated."""
    whole = math.floor(steps)
    part = steps - whole
    y = s[RING + whole]
    return y if part == 0.0 else (1.0 - part) * y + part * s[RING + whole + 1]


@inlined
def _effective(v, a):
    """The effective command (behind the dead-band) for the speed ``v``."""
    x = v / a[UP] if v >= 0.0 else v / a[DOWN]
    x = min(max(x, -a[LIMIT]), a[LIMIT])
    if a[EXPONENT] != 1.0 and x != 0.0:
        x = math.copysign(abs(x) ** (1.0 / a[EXPONENT]), x)
    return x


@inlined
def _with_deadband(x, v, a):
    """Add the dead-band to the effective command ``x``, in proportion near rest."""
    still = REST_SHARE * min(a[UP], a[DOWN])
    share = min(1.0, abs(v) / still)
    return x + share * (a[POSITIVE] if v > 0.0 else -a[NEGATIVE])


@kernel
def look_up(tables, starts, steps, joints, out):
    """Joints (n, A) → driven coordinates by even tables (A, points), extrapolated linearly."""
    last = tables.shape[1] - 1
    for lane in range(len(joints)):
        for i in range(joints.shape[1]):
            if math.isnan(steps[i]):
                out[lane, i] = joints[lane, i]
                continue
            t = (joints[lane, i] - starts[i]) / steps[i]
            k = min(max(math.floor(t), 0), last - 1)
            out[lane, i] = tables[i, k] + (t - k) * (tables[i, k + 1] - tables[i, k])


@kernel
def fill(tuning, state, which, drive):
    """Set the lanes ``which`` to rest at ``drive`` (len(which), A)."""
    for row in range(len(which)):
        for i in range(len(tuning)):
            s = state[which[row], i]
            s[INTEGRAL_SUM] = 0.0
            s[LAST] = drive[row, i] if tuning[i, SERVO] != 0.0 else 0.0
            s[POSITION] = 0.0
            s[RING:] = drive[row, i]


@kernel
def command(tuning, state, setpoints, measured, preview, dt, out):
    """One step of all copies.

    Args:
        tuning: (A, 16), rows of :class:`sysid_rl.control.tuning.AxisTuning`.
        state: (n, A, RING + setpoints kept), in and out.
        setpoints, measured: of the driven coordinates, (n, A).
        preview: time from the end of the step to that of the setpoints [s].
        out: commands, (n, A).
    """
    for lane in range(len(setpoints)):
        for i in range(len(tuning)):
            a, s = tuning[i], state[lane, i]
            for k in range(len(s) - 1, RING, -1):
                s[k] = s[k - 1]
            s[RING] = min(max(setpoints[lane, i], a[LOW]), a[HIGH])
            if a[SERVO] != 0.0:
                s[LAST] = _past(s, preview / dt)
                out[lane, i] = s[LAST]
                continue
            top = min(a[UP], a[DOWN])
            error = _past(s, preview / dt + 1.0) - measured[lane, i]
            early = max(0.0, preview - a[DEAD_TIME]) / dt
            fed = (_past(s, early) - _past(s, early + 1.0)) / dt
            v = a[FEED] * min(max(fed, -top), top) + a[PROPORTIONAL] * error + s[INTEGRAL_SUM] + a[CREEP]
            if a[BACKLASH] > 0.0:
                half = 0.5 * a[BACKLASH]
                if abs(fed) > REST_SHARE * top and fed * v > 0.0:  # at rest, noise would cause reversals
                    left = math.copysign(half, v) - s[POSITION]
                    v += min(max(left / dt, -top), top)
                s[POSITION] = min(max(s[POSITION] + min(max(v, -top), top) * dt, -half), half)
            x = _effective(v, a)
            wanted = _with_deadband(x, v, a)
            reach = a[RATE] * dt
            u = min(max(wanted, -1.0, s[LAST] - reach), 1.0, s[LAST] + reach)
            if s[RING] <= a[LOW] or s[RING] >= a[HIGH]:
                s[INTEGRAL_SUM] = 0.0  # an integral against an end stop would not unwind
            elif u == wanted or (wanted - u) * error < 0.0:  # anti-windup
                bound = INTEGRAL_SHARE * top
                s[INTEGRAL_SUM] = min(max(s[INTEGRAL_SUM] + a[INTEGRAL] * error * dt, -bound), bound)
            s[LAST] = u
            out[lane, i] = u


def ring_size(preview: float, dt: float) -> int:
    """Number of setpoints to keep: those within the preview, and more to interpolate."""
    return int(np.ceil(preview / dt)) + 4
