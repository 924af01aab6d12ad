"""The chain of effects in physical order, compiled. Reads top to bottom: command → speed → position → joint → tip → tool.

All kernels take the flat parameter vector ``p`` of :mod:`sysid.plant.layout`; ``b`` is where an axis' block begins.
State is kept in flat arrays in which NaN means "not begun": the first step of an effect fills its own state.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from sysid.effects import (
    asymmetric_gain,
    backlash,
    command_rate_limit,
    coulomb_friction,
    first_order_lag,
    flow_saturation,
    gain_curve,
    gain_error,
    gripper_sway,
    input_delay,
    internal_leakage,
    stiction,
    valve_deadband,
    valve_hysteresis,
    viscous_friction,
)
from sysid.plant import cache, layout

assert cache.CACHE_FOLDER is not None  # chosen before anything compiles

WIDTH = layout.AXIS_WIDTH
_DELAY = layout.axis_place("input_delay")
_HYSTERESIS = layout.axis_place("valve_hysteresis")
_DEADBAND = layout.axis_place("valve_deadband")
_CURVE = layout.axis_place("gain_curve")
_SATURATION = layout.axis_place("flow_saturation")
_RATE = layout.axis_place("command_rate_limit")
_LAG = layout.axis_place("first_order_lag")
_GAIN = layout.axis_place("gain_error")
_ASYMMETRY = layout.axis_place("asymmetric_gain")
_LEAKAGE = layout.axis_place("internal_leakage")
_STICTION = layout.axis_place("stiction")
_COULOMB = layout.axis_place("coulomb_friction")
_VISCOUS = layout.axis_place("viscous_friction")
_INERTIA = layout.axis_place("inertia_error")
_BIAS = layout.axis_place("load_bias")
_PLAY_DRIVE = layout.axis_place("backlash", "drive")
_PLAY_STRUCTURE = layout.axis_place("backlash", "structure")
_OFFSET = layout.axis_place("joint_offset")
_LENGTH = layout.axis_place("link_length_error")

VELOCITY, POSITION, FORCE = 0, 1, 2

# State of one axis, one number each, then the ring of the delay.
_S_POSITION, _S_SPEED, _S_LAG, _S_PLAY, _S_HYSTERESIS, _S_RATE, _S_STICTION, S_RING = 0, 1, 2, 3, 4, 5, 6, 7


def axis_memory(dt: float) -> int:
    """State values of one axis."""
    return S_RING + input_delay.EFFECT.memory(dt)


@njit(inline="always")
def command_stage(u, p, b, s, m, size, gain, dt):
    """Command → speed of a velocity axis [m/s or rad/s], mean over the step."""
    u = input_delay.step(u, p, b + _DELAY, s, m + S_RING, size - S_RING, dt)
    u = valve_hysteresis.step(u, p, b + _HYSTERESIS, s, m + _S_HYSTERESIS)
    u = valve_deadband.step(u, p, b + _DEADBAND)
    u = gain_curve.step(u, p, b + _CURVE)
    u = flow_saturation.step(u, p, b + _SATURATION)
    u = command_rate_limit.step(u, p, b + _RATE, s, m + _S_RATE, dt)
    x = first_order_lag.step(u, p, b + _LAG, s, m + _S_LAG, dt)
    x = gain_error.step(x, p, b + _GAIN)
    x = asymmetric_gain.step(x, p, b + _ASYMMETRY)
    x = stiction.step(x, p, b + _STICTION, s, m + _S_STICTION)
    return internal_leakage.step(gain * x, p, b + _LEAKAGE)


@njit(inline="always")
def position_stage(u, p, b, s, m, size, dt):
    """Commanded position → position of a servo axis."""
    u = input_delay.step(u, p, b + _DELAY, s, m + S_RING, size - S_RING, dt)
    u = command_rate_limit.step(u, p, b + _RATE, s, m + _S_RATE, dt)
    return first_order_lag.step(u, p, b + _LAG, s, m + _S_LAG, dt)


@njit(inline="always")
def force_stage(u, v, p, b, inertia, dt):
    """Force [N or N·m] → speed after the step.

    Coulomb friction is applied last and may stop the motion but not turn it round (implicit step), so the axis
    sticks without chattering.
    """
    mass = inertia * p[b + _INERTIA]
    slope = p[b + _VISCOUS] if v > 0.0 else p[b + _VISCOUS + 1]
    free = (v + dt / mass * (u - p[b + _BIAS])) / (1.0 + dt / mass * slope)
    hold = dt / mass * coulomb_friction.limit(free, p, b + _COULOMB) / (1.0 + dt / mass * slope)
    if free > hold:
        return free - hold
    if free < -hold:
        return free + hold
    return 0.0


@njit(cache=True, nogil=True)
def force_at_motion(p, b, inertia, v, a, out):
    """Force that the model needs for a measured motion: speeds ``v`` and accelerations ``a``, each (n,)."""
    for k in range(len(v)):
        out[k] = (
            inertia * p[b + _INERTIA] * a[k]
            + coulomb_friction.force(v[k], p, b + _COULOMB)
            + viscous_friction.force(v[k], p, b + _VISCOUS)
            + p[b + _BIAS]
        )


@njit(inline="always")
def look_up(x, table, low, step):
    """Linear interpolation in an even table, extended along its end slopes."""
    last = len(table) - 1
    t = (x - low) / step
    k = math.floor(t)
    if k < 0:
        k = 0
    elif k >= last:
        k = last - 1
    return table[k] + (t - k) * (table[k + 1] - table[k])


@njit(inline="always")
def advance(u, p, b, s, m, size, kind, gain, low, high, dt):
    """One step of one axis up to what its command drives; returns the position *before* the step, on the sample grid."""
    position = s[m + _S_POSITION]
    if kind == POSITION:
        position = position_stage(u, p, b, s, m, size, dt)
        position = min(max(position, low), high)
        s[m + _S_POSITION] = position
        return position
    if kind == VELOCITY:
        speed = command_stage(u, p, b, s, m, size, gain, dt)
        s[m + _S_SPEED] = speed
    else:
        before = s[m + _S_SPEED]
        s[m + _S_SPEED] = force_stage(u, before, p, b, gain, dt)
        speed = 0.5 * (before + s[m + _S_SPEED])
    moved = position + dt * speed
    if moved > high:
        moved = high
        s[m + _S_SPEED] = min(s[m + _S_SPEED], 0.0)
    elif moved < low:
        moved = low
        s[m + _S_SPEED] = max(s[m + _S_SPEED], 0.0)
    s[m + _S_POSITION] = moved
    return position


@njit(inline="always")
def _run(command, p, b, s, m, size, kind, gain, low, high, dt, first, last, position, speed, play, plays, out_drive, out_play):
    """Samples ``first … last`` of one axis from a given start; ``play`` in [−1, 1] is where in its play the output begins."""
    for k in range(m, m + size):
        s[k] = np.nan
    s[m + _S_POSITION] = position
    s[m + _S_SPEED] = speed
    if plays:
        s[m + _S_PLAY] = position - play * 0.5 * p[b + _PLAY_DRIVE]
    for k in range(first, last):
        drive = advance(command[k], p, b, s, m, size, kind, gain, low, high, dt)
        out_drive[k] = drive
        if plays:
            out_play[k] = backlash.step(drive, p, b + _PLAY_DRIVE, s, m + _S_PLAY)
        else:
            out_play[k] = drive


@njit(inline="always")
def _median_difference(measured, simulated, first, last, scratch):
    count = 0
    for k in range(first, last):
        if not np.isnan(measured[k]):
            scratch[count] = measured[k] - simulated[k]
            count += 1
    return np.median(scratch[:count]) if count else 0.0


@njit(inline="always")
def _squares(measured, simulated, first, last):
    total = 0.0
    for k in range(first, last):
        if not np.isnan(measured[k]):
            total += (measured[k] - simulated[k]) ** 2
    return total


@njit(cache=True, nogil=True)
def drive_axis(p, b, command, measured, segments, kind, gain, low, high, dt, window, settle, plays, size, out_drive, out_play):
    """Free run of one axis from its command over all segments.

    Each segment starts so that the median of (measured − simulated) over its first ``window`` samples is zero.
    That window cannot show on which side of a play the drive stands: where the axis ``plays`` before the measured
    signal, the side that fits the first ``settle`` samples best is taken.

    Args:
        command, measured: (n,); ``measured`` is the signal that the command drives, NaN where missing.
        segments: (m, 2) first and last+1 sample of each stretch with commands.
        gain: speed at command 1, or inertia of a force axis.
        plays: whether the play lies between the drive and the measured signal.
        out_drive, out_play: (n,) position of the drive, and behind the play.
    """
    s = np.empty(size)
    scratch = np.empty(window)
    for row in range(len(segments)):
        first = segments[row, 0]
        last = segments[row, 1]
        near = min(first + window, last)
        begin = np.nan
        for k in range(first, near):
            if not np.isnan(measured[k]):
                begin = measured[k]
                break
        if np.isnan(begin):
            begin = min(max(0.0, low), high)
        speed = 0.0
        if kind == FORCE:
            speed = _slope(measured, first, near, dt)
        _run(command, p, b, s, 0, size, kind, gain, low, high, dt, first, near, begin, speed, 0.0, False, out_drive, out_play)
        begin += _median_difference(measured, out_drive, first, near, scratch)
        begin = min(max(begin, low), high)
        play = 0.0
        if plays and p[b + _PLAY_DRIVE] > 0.0:
            far = min(first + settle, last)
            half = 0.5 * p[b + _PLAY_DRIVE]
            costs = np.empty(3)
            for side in range(3):
                phi = side - 1.0
                start = begin + phi * half
                _run(
                    command,
                    p,
                    b,
                    s,
                    0,
                    size,
                    kind,
                    gain,
                    low,
                    high,
                    dt,
                    first,
                    far,
                    start,
                    speed,
                    phi,
                    True,
                    out_drive,
                    out_play,
                )
                costs[side] = _squares(measured, out_play, first, far)
            bend = costs[0] - 2.0 * costs[1] + costs[2]
            if bend > 0.0:
                play = min(max(0.5 * (costs[0] - costs[2]) / bend, -1.0), 1.0)
            elif costs[0] < costs[2]:
                play = -1.0
            elif costs[2] < costs[0]:
                play = 1.0
            begin += play * half
        _run(command, p, b, s, 0, size, kind, gain, low, high, dt, first, last, begin, speed, play, plays, out_drive, out_play)


@njit(inline="always")
def _slope(values, first, last, dt):
    """Least-squares slope of the samples that are there [1/s]."""
    n = 0
    st = 0.0
    sy = 0.0
    for k in range(first, last):
        if not np.isnan(values[k]):
            n += 1
            st += k - first
            sy += values[k]
    if n < 3:
        return 0.0
    top = 0.0
    bottom = 0.0
    for k in range(first, last):
        if not np.isnan(values[k]):
            top += (k - first - st / n) * (values[k] - sy / n)
            bottom += (k - first - st / n) ** 2
    return top / bottom / dt


@njit(cache=True, nogil=True)
def joint_axis(p, b, cylinder, measured, table, low, step, window, out):
    """Cylinder [m] (n,) → joint behind linkage and play (n,). NaN in stays NaN and keeps the play's state.

    The play begins where the first measured joint values say it stands.
    """
    s = np.empty(1)
    s[0] = np.nan
    scratch = np.empty(window)
    count = 0
    for k in range(len(cylinder)):
        if count == window:
            break
        if not np.isnan(cylinder[k]) and not np.isnan(measured[k]):
            scratch[count] = measured[k] - look_up(cylinder[k], table, low, step)
            count += 1
    begun = False
    for k in range(len(cylinder)):
        if np.isnan(cylinder[k]):
            out[k] = np.nan
            continue
        x = look_up(cylinder[k], table, low, step)
        if not begun:
            begun = True
            if count:
                s[0] = x + np.median(scratch[:count])
        out[k] = backlash.step(x, p, b + _PLAY_DRIVE, s, 0)


@njit(cache=True, nogil=True)
def tip(p, base, joints, origins, axes, prismatic, order, end, out):
    """Joints (n, A) → end effector (n, 3).

    ``origins`` (A, 4, 4) lead from the frame moved by the previous joint to the frame of this one, in chain order;
    ``order`` (A,) gives the column of ``joints`` for each; ``end`` (4, 4) leads from the last joint to the tip.
    """
    count = len(order)
    plays = np.full(count, np.nan)
    q = np.empty(count)
    rotation = np.empty((3, 3))
    spare = np.empty((3, 3))
    local = np.empty((3, 3))
    position = np.empty(3)
    shift = np.empty(3)
    base_rotation = np.empty((3, 3))
    _rotation_vector(p[base + 3], p[base + 4], p[base + 5], base_rotation)
    for k in range(len(joints)):
        there = True
        for j in range(count):
            column = order[j]
            if np.isnan(joints[k, column]):
                there = False
                break
            b = column * WIDTH
            q[j] = backlash.step(joints[k, column], p, b + _PLAY_STRUCTURE, plays, column) + p[b + _OFFSET]
        if not there:
            out[k, 0] = np.nan
            out[k, 1] = np.nan
            out[k, 2] = np.nan
            continue
        for r in range(3):
            position[r] = 0.0
            for c in range(3):
                rotation[r, c] = 1.0 if r == c else 0.0
        for j in range(count + 1):
            frame = origins[j] if j < count else end
            stretch = 1.0
            if j > 0:
                longer = p[order[j - 1] * WIDTH + _LENGTH]
                if longer != 0.0:
                    length = math.sqrt(frame[0, 3] ** 2 + frame[1, 3] ** 2 + frame[2, 3] ** 2)
                    if length > 1e-9:
                        stretch = 1.0 + longer / length
            for r in range(3):
                along = rotation[r, 0] * frame[0, 3] + rotation[r, 1] * frame[1, 3] + rotation[r, 2] * frame[2, 3]
                position[r] += stretch * along
            if j == count:
                break
            _product(rotation, frame, spare)
            if prismatic[j]:
                for r in range(3):
                    shift[r] = q[j] * axes[j, r]
                for r in range(3):
                    position[r] += spare[r, 0] * shift[0] + spare[r, 1] * shift[1] + spare[r, 2] * shift[2]
                    for c in range(3):
                        rotation[r, c] = spare[r, c]
            else:
                _rotation_vector(q[j] * axes[j, 0], q[j] * axes[j, 1], q[j] * axes[j, 2], local)
                _product(spare, local, rotation)
        for r in range(3):
            out[k, r] = (
                base_rotation[r, 0] * position[0]
                + base_rotation[r, 1] * position[1]
                + base_rotation[r, 2] * position[2]
                + p[base + r]
            )


@njit(inline="always")
def _product(a, b, out):
    for r in range(3):
        for c in range(3):
            out[r, c] = a[r, 0] * b[0, c] + a[r, 1] * b[1, c] + a[r, 2] * b[2, c]


@njit(inline="always")
def _rotation_vector(x, y, z, out):
    """Rotation matrix of a rotation vector (Rodrigues)."""
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < 1e-12:
        out[0, 0] = out[1, 1] = out[2, 2] = 1.0
        out[0, 1], out[0, 2], out[1, 0], out[1, 2], out[2, 0], out[2, 1] = -z, y, z, -x, -y, x
        return
    x, y, z = x / angle, y / angle, z / angle
    sine = math.sin(angle)
    versine = 1.0 - math.cos(angle)
    out[0, 0] = 1.0 - versine * (y * y + z * z)
    out[0, 1] = versine * x * y - sine * z
    out[0, 2] = versine * x * z + sine * y
    out[1, 0] = versine * x * y + sine * z
    out[1, 1] = 1.0 - versine * (x * x + z * z)
    out[1, 2] = versine * y * z - sine * x
    out[2, 0] = versine * x * z - sine * y
    out[2, 1] = versine * y * z + sine * x
    out[2, 2] = 1.0 - versine * (x * x + y * y)


@njit(cache=True, nogil=True)
def tool(p, at, pivot, measured, window, dt, out):
    """Boom tip (n, 3) → tool (n, 3). After a gap in the tip the swing restarts from the first measured samples."""
    s = np.empty(gripper_sway.MEMORY)
    start = np.empty(4)
    begun = False
    for k in range(len(pivot)):
        if np.isnan(pivot[k, 0]):
            out[k, 0] = np.nan
            out[k, 1] = np.nan
            out[k, 2] = np.nan
            begun = False
            continue
        if not begun:
            begun = True
            last = k
            while last < min(k + window, len(pivot)) and not np.isnan(pivot[last, 0]):
                last += 1
            start[0] = pivot[k, 0]
            start[1] = pivot[k, 1]
            start[2] = 0.0
            start[3] = 0.0
            for _ in range(3):
                _begin(s, start)
                for i in range(k, last):
                    gripper_sway.step(pivot[i, 0], pivot[i, 1], pivot[i, 2], p, at, s, 0, dt, out[i])
                _correct_start(p, at, measured, out, k, last, dt, start)
            _begin(s, start)
        gripper_sway.step(pivot[k, 0], pivot[k, 1], pivot[k, 2], p, at, s, 0, dt, out[k])


@njit(inline="always")
def _begin(s, start):
    """State of the swing with the bob at ``start[:2]`` moving at ``start[2:]``; the pivot begins where it is first seen."""
    for i in range(len(s)):
        s[i] = np.nan
    for i in range(4):
        s[i] = start[i]


@njit(inline="always")
def _correct_start(p, at, measured, out, first, last, dt, start):
    """Least-squares correction of place and speed of the bob from what is left over the first samples.

    A change of the start dies out as a free swing: ``e^(−ζωt)(δx·cos ωt + (δv + ζω·δx)/ω·sin ωt)``.
    """
    length = p[at]
    if length < 1e-3:
        return
    rate = math.sqrt(gripper_sway.GRAVITY / length)
    fade = p[at + 1] * rate
    for c in range(2):
        a11 = a12 = a22 = b1 = b2 = 0.0
        for k in range(first, last):
            if np.isnan(measured[k, c]):
                continue
            t = (k - first) * dt
            decay = math.exp(-fade * t)
            by_speed = decay * math.sin(rate * t) / rate
            by_place = decay * math.cos(rate * t) + fade * by_speed
            left = measured[k, c] - out[k, c]
            a11 += by_place * by_place
            a12 += by_place * by_speed
            a22 += by_speed * by_speed
            b1 += by_place * left
            b2 += by_speed * left
        bottom = a11 * a22 - a12 * a12
        if bottom > 1e-9 * a11 * a22:
            start[c] += (b1 * a22 - b2 * a12) / bottom
            start[2 + c] += (a11 * b2 - a12 * b1) / bottom
