"""A servo axis by itself, compiled: its controller and friction, with the measured motion of the other joints as series.

Backlash separates the motor, whose position the controller reads and on which friction and armature act, from the joint and
its links: either crosses it by itself, and on a flank, which does not rebound, both move as one.

Source: Nordin and Gutman, Automatica 38 (2002), 1633–1649, on models of backlash; Moreau, in Nonsmooth Mechanics and
Applications (1988), on steps with inelastic impacts.
"""

from __future__ import annotations

import math

import numpy as np

from sysid.effects import input_delay
from sysid.effects.compiled import inlined, kernel, loop
from sysid.plant import chain, servo_law
from sysid.plant.axis_loop import begin
from sysid.plant.layout import AT, AXIS_WIDTH, STATE
from sysid.plant.machine_arrays import GIVE, HIGH, IMPLICIT, LEAD, LOW

# Rows of the series of an axis, (SERIES, n · F), F samples of the motion in a step of the command: inertia of the links about
# it; the sum over the steps before of their mean torques without its own acceleration; the change of the torque by its own
# position; its position and speed; the torque more that the other joints exert without implicit damping, which friction feels.
OWN, TORQUE, SLOPE, PLACE, SPEED, UNDAMPED = range(6)
SERIES = 6


@inlined
def _between(series, row, at):
    """A row at the place ``at`` [samples]."""
    k = int(at)
    if k + 1 >= series.shape[1]:
        return series[row, k]
    return series[row, k] + (at - k) * (series[row, k + 1] - series[row, k])


@inlined
def step(x, v, before, u, inertia, rest, slope, place, undamped, kp, kv, low, high, h, p, axes, i, own):
    """Position and speed after ``h`` (:mod:`sysid.plant.servo_law`).

    Args:
        before: speed of all that moves, before an impact with the motor's speed ``v``.
        inertia: of links and armature; the links' torque is ``rest + slope·(x − place)``.
        undamped: row of the series.
        own: whether it is a step of the described simulator.
    """
    half, explicit = (0.0, axes[i, IMPLICIT] < 0.0) if own else (0.5, False)
    b = i * AXIS_WIDTH
    w, after = v, v
    for _ in range(2):  # the second time with the friction of the mean speed
        viscous, gradual = chain.servo_friction(w, p, b)
        mass = inertia if own else chain.rotor(inertia, kv, viscous, axes, i)
        damping, stiffness = viscous + gradual, kp + slope
        push = kp * (u - x) - rest - slope * (x - place)
        if explicit:
            push -= kv * v
        else:
            damping += kv
        for limited in range(2):
            theta = 1.0 if own else servo_law.weight(h * damping / mass)
            brake = damping + half * h * stiffness
            free = mass / h * before - (1.0 - theta) * brake * v + push
            resistance, dry = mass / h + theta * brake, chain.dry(free, v, p, b)
            give, time = axes[i, GIVE], chain.give_time(axes, i, own)
            if own and give > 0.0:  # the friction is that of the motion without implicit damping
                alone = free - brake * v - undamped
                rubbing = alone - mass / h * servo_law.rub(alone, mass / h, v, 0.0, h, dry, give, time)
                after = (free - rubbing) / resistance
            else:
                after = servo_law.rub(free, resistance, v, theta, h, dry, give, time)
            w = (1.0 - theta) * v + theta * after
            force = kp * (u - x - half * h * w) - kv * (v if own else w)
            if limited == 1 or low <= force <= high:
                break
            mass = inertia if own else chain.rotor(inertia, 0.0, viscous, axes, i)
            damping, stiffness = viscous + gradual, slope  # at its limit the controller neither damps nor holds
            push = (high if force > high else low) - rest - slope * (x - place)
        if not chain.friction_changes(v, w, p, b):
            break
    return x + h * w, after


@inlined
def advance(s, m, u, links, armature, rest, slope, place, undamped, kp, kv, low, high, h, p, axes, i, own):
    """One step of motor and joint, of which the inertia ``links`` moves."""
    b, j, lead = i * AXIS_WIDTH, m + STATE.backlash_drive, axes[i, LEAD] if own else 0.0
    v = s[m + STATE.speed]
    x = s[m + STATE.position] + lead * v
    behind, half, before = chain.has_backlash(p, b), 0.5 * p[b + AT.backlash_drive], v
    mass, load, rise, more, offset, y, w = links + armature, rest, slope, undamped, 0.0, x, v
    if behind:
        w = s[j + 1]
        y = s[j] + lead * w
        mass, load, rise, more = servo_law.rotor_alone(armature, kp, h), 0.0, 0.0, 0.0  # the motor by itself at first
    for _ in range(2):
        far, fast = step(x, v, before, u, mass, load, rise, place - offset, more, kp, kv, low, high, h, p, axes, i, own)
        if not behind or offset != 0.0:
            y, w = far + offset, fast
            break
        free = 0.0  # a joint without masses rests
        if links > 0.0:
            free = w - h * (rest + slope * (y + (0.0 if own else 0.5 * h * w) - place)) / links
        ahead = y + h * (free if own else 0.5 * (w + free))
        if abs(ahead - far) <= half:
            y, w = ahead, free
            break
        offset, mass, load, rise, more = math.copysign(half, ahead - far), links + armature, rest, slope, undamped
        before = (links * w + armature * v) / mass
    s[m + STATE.position], s[m + STATE.speed] = far - lead * fast, fast
    if behind:
        s[j], s[j + 1] = y - lead * w, w


@inlined
def _next(law, entry, links, rest, slope, place, undamped, j, count, s, m, dt, p, axes, i, own):
    """Step ``j`` of the ``count`` of a sample, from the setpoint on."""
    u = chain.servo_setpoint(entry[1], entry[0], entry[2], j, count, p, i * AXIS_WIDTH, s, m, dt / count, own)
    advance(
        s, m, u, links, law[4], rest, slope, place, undamped, law[0], law[1], law[2], law[3], dt / count, p, axes, i, own
    )  # fmt: skip
    chain.stop(s, m, axes, i)


@loop
def run(ps, arrays, i, ss, laws, entries, command, series, first, last, dt, out):
    """Samples ``first … last`` of axis ``i`` in every lane, from the states ``ss`` (lanes, size).

    A step waits for the one before it: the lanes advance side by side, so that the processor works on several at a time.

    Args:
        ps: parameters (lanes, P).
        laws, entries: places for the controller (lanes, 5) and the input of a sample (lanes, 3).
        out: position before the step of each sample, (lanes, n).
    """
    b, size, m = i * AXIS_WIDTH, ss.shape[1], np.int64(0)
    fine, lead = series.shape[1] // len(command), arrays.axes[i, LEAD]
    own = servo_law.own_steps(lead, dt)
    for lane in range(len(ps)):
        laws[lane, 0], laws[lane, 1], laws[lane, 2], laws[lane, 3], laws[lane, 4] = chain.servo_law(ps[lane], arrays.axes, i)
    for k in range(first, last):
        torque = _between(series, TORQUE, fine * k)
        for lane in range(len(ps)):
            p, s = ps[lane], ss[lane]
            entries[lane, 0], entries[lane, 1], entries[lane, 2] = input_delay.ends(
                command[k], p, b + AT.input_delay, s, m + STATE.input_delay, size - STATE.input_delay, dt
            )
            out[lane, k] = chain.servo_joint(p, b, s, m, arrays.axes, i)
            chain.rest_on_flank(_between(series, TORQUE, fine * (k + 1.0)) - torque, p, b, s, m)
        if own > 0:
            behind = torque
            for j in range(own):
                ahead = _between(series, TORQUE, fine * (k + (j + 1) / own))
                at, rest = fine * (k + j / own), (ahead - behind) * own / fine
                links, slope, undamped = _between(series, OWN, at), _between(series, SLOPE, at), _between(series, UNDAMPED, at)
                place = _between(series, PLACE, at) + lead * _between(series, SPEED, at)
                for lane in range(len(ps)):
                    _next(
                        laws[lane], entries[lane], links, rest, slope, place, undamped, j, own, ss[lane], m, dt, ps[lane],
                        arrays.axes, i, True,
                    )  # fmt: skip
                behind = ahead
            continue
        for lane in range(len(ps)):
            p, s, law, behind = ps[lane], ss[lane], laws[lane], torque
            viscous, gradual = chain.servo_friction(s[m + STATE.speed], p, b)
            moving = law[4] if chain.has_backlash(p, b) else law[4] + _between(series, OWN, fine * (k + 0.5))
            count = max(servo_law.substeps(law[0], law[1] + viscous + gradual, moving, dt), fine)
            for j in range(count):
                ahead = _between(series, TORQUE, fine * (k + (j + 1) / count))
                at, rest, behind = fine * (k + (j + 0.5) / count), (ahead - behind) * count / fine, ahead
                links, slope, place = _between(series, OWN, at), _between(series, SLOPE, at), _between(series, PLACE, at)
                _next(law, entries[lane], links, rest, slope, place, 0.0, j, count, s, m, dt, p, arrays.axes, i, False)


@kernel
def drive_servo(ps, arrays, i, command, series, places, speeds, segments, dt, size, out):
    """Free runs of servo axis ``i`` from its command over all segments.

    Args:
        ps: parameters (lanes, P).
        command: (n,), ``series``: (SERIES, n · F).
        places, speeds: (n,), in which the segments begin.
        segments: (m, 2) first and last+1 sample of each stretch with commands.
        out: position of the joint, (lanes, n).
    """
    lanes = len(ps)
    ss, laws, entries = np.empty((lanes, size)), np.empty((lanes, 5)), np.empty((lanes, 3))
    for row in range(len(segments)):
        first, last = segments[row, 0], segments[row, 1]
        for lane in range(lanes):
            start(ps[lane], arrays, i, ss[lane], places[first], speeds[first], first, dt)
        run(ps, arrays, i, ss, laws, entries, command, series, first, last, dt, out)


@inlined
def start(p, arrays, i, s, place, speed, first, dt):
    """State ``s`` (size,) in which a stretch begins, from its place and speed; the first command was held before."""
    b = i * AXIS_WIDTH
    place = min(max(place, arrays.axes[i, LOW]), arrays.axes[i, HIGH])
    begin(s, np.int64(0), len(s), place, speed, np.nan, p, b, first, dt)


@kernel
def starts_of(p, arrays, i, places, speeds, segments, dt, out):
    """:func:`start` of each of the stretches ``segments`` (m, 2), (m, size), from places and speeds (n,)."""
    for row in range(len(segments)):
        first = segments[row, 0]
        start(p, arrays, i, out[row], places[first], speeds[first], first, dt)
