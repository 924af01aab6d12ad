"""Runs of one axis by itself, compiled: from its command over whole recordings, and from its cylinder to its joint.

What the other axes do to it enters as series: the gravity ``load`` at measured joints, the ``share`` of its demand that
the pump feeds. The whole machine at once is :mod:`sysid.plant.machine_run`, which takes its starts from here.
"""

from __future__ import annotations

import math

import numpy as np

from sysid.effects.compiled import inlined, kernel, loop
from sysid.plant import chain, residual
from sysid.plant.layout import AT, AXIS_WIDTH, STATE
from sysid.plant.rig import CYLINDER, FORCE, GAIN, HIGH, KIND, LOW, POSITION, TABLE_LOW, TABLE_STEP, VELOCITY

#: What a start is made of: position of the drive, its speed, joint behind the play before it sags.
START = 3


@inlined
def begin(s, m, size, position, speed, joint, p, b, first, dt):
    """State of an axis that begins at sample ``first`` of its recording; ``joint`` NaN begins in the middle of the play."""
    for k in range(m, m + size):
        s[k] = np.nan
    s[m + STATE.position] = position
    s[m + STATE.speed] = speed
    s[m + STATE.backlash_drive] = joint
    if p[b + AT.temperature_drift] != 0.0:
        s[m + STATE.temperature_drift] = math.exp(-first * dt / p[b + AT.temperature_drift + 1])


@loop
def _run(p, rig, i, s, command, load, share, first, last, start, dt, drive, joint, own):
    """Samples ``first … last`` from ``start``; ``joint`` is only written where the joint itself is driven.

    ``own`` is the network that the axis carries (:class:`sysid.plant.residual.Own`), or None.
    """
    b, size, m = i * AXIS_WIDTH, len(s), np.int64(0)  # a plain 0 would be a type of its own, and compile all of it once more
    fed, jointed = rig.axes[i, KIND] == VELOCITY, rig.axes[i, CYLINDER] == 0.0
    begin(s, m, size, start[0], start[1], start[2], p, b, first, dt)
    if own is not None:
        residual.forget(own.memory)
    for k in range(first, last):
        if own is None:
            wanted = chain.ask(command[k], p, s, m, size, rig.axes, i, load[k], dt)
            drive[k] = chain.move(wanted * share[k] if fed else wanted, s, m, rig.axes, i, dt)
        else:
            extra = 0.0
            if rig.axes[i, KIND] != POSITION:
                extra = residual.look(own.nets, own.row, own.memory, own.commands[k], s[m + STATE.position], load[k], dt)
            elif k > first:  # a servo stands at a sample where the step before has led it
                extra = residual.look(
                    own.nets, own.row, own.memory, own.commands[k - 1], s[m + STATE.position], load[k - 1], dt
                )
            if rig.axes[i, KIND] == FORCE:
                wanted = chain.ask(command[k] - extra, p, s, m, size, rig.axes, i, load[k], dt)
            else:
                wanted = chain.ask(command[k], p, s, m, size, rig.axes, i, load[k], dt)
                wanted = wanted * share[k] * (1.0 + extra) if fed else wanted + extra
                if rig.axes[i, KIND] == POSITION:
                    wanted = min(max(wanted, rig.axes[i, LOW]), rig.axes[i, HIGH])
            drive[k] = chain.move(wanted, s, m, rig.axes, i, dt)
        if jointed:
            joint[k] = chain.joint_stage(drive[k], p, b, s, m, load[k])


@loop
def _median(values, count):
    """Median of the first ``count`` values, zero of none; sorts them (a start has some twenty)."""
    for k in range(1, count):
        x = values[k]
        at = k
        while at > 0 and values[at - 1] > x:
            values[at] = values[at - 1]
            at -= 1
        values[at] = x
    return 0.5 * (values[(count - 1) // 2] + values[count // 2]) if count else 0.0


@loop
def _median_difference(measured, simulated, first, last, scratch):
    count = 0
    for k in range(first, last):
        if not np.isnan(measured[k]):
            scratch[count] = measured[k] - simulated[k]
            count += 1
    return _median(scratch, count)


@loop
def _squares(measured, simulated, first, last):
    total = 0.0
    for k in range(first, last):
        if not np.isnan(measured[k]):
            total += (measured[k] - simulated[k]) ** 2
    return total


@loop
def slope(values, first, last, dt):
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


@loop
def _find_start(
    p, rig, i, s, command, measured, joint, load, share, first, last, dt, window, settle, out, behind, scratch, start, own
):
    """Where a stretch starts, into ``start``: the median of (measured − simulated) over its first ``window`` samples is zero.

    That window cannot show on which side of a play the drive stands: where the joint itself is driven, the side that fits the
    first ``settle`` samples best is taken.
    """
    b = i * AXIS_WIDTH
    low, high = rig.axes[i, LOW], rig.axes[i, HIGH]
    near = min(first + window, last)
    position = np.nan
    for k in range(first, near):
        if not np.isnan(measured[k]):
            position = measured[k]
            break
    if np.isnan(position):
        position = min(max(0.0, low), high)
    start[0] = position
    start[1] = slope(measured, first, near, dt) if rig.axes[i, KIND] == FORCE else 0.0
    start[2] = np.nan
    _run(p, rig, i, s, command, load, share, first, near, start, dt, out, behind, own)
    if rig.axes[i, CYLINDER] != 0.0:
        position += _median_difference(measured, out, first, near, scratch)
    else:
        position += _median_difference(measured, behind, first, near, scratch)
    start[0] = min(max(position, low), high)
    if rig.axes[i, CYLINDER] != 0.0:
        count = 0
        for k in range(first, near):
            behind[k] = chain.look_up(out[k], rig.tables, i, rig.axes[i, TABLE_LOW], rig.axes[i, TABLE_STEP])
            if not np.isnan(joint[k]) and not np.isnan(behind[k]):
                scratch[count] = joint[k] + p[b + AT.joint_compliance_drive] * load[k] - behind[k]
                count += 1
        if count:
            start[2] = behind[first] + _median(scratch, count)
        return
    half = 0.5 * p[b + AT.backlash_drive]
    if half <= 0.0:
        return
    far = min(first + settle, last)
    middle = start[0]
    low_cost, middle_cost, high_cost = 0.0, 0.0, 0.0
    for side in range(3):
        start[0] = middle + (side - 1.0) * half
        start[2] = middle
        _run(p, rig, i, s, command, load, share, first, far, start, dt, out, behind, own)
        cost = _squares(measured, behind, first, far)
        if side == 0:
            low_cost = cost
        elif side == 1:
            middle_cost = cost
        else:
            high_cost = cost
    bend = low_cost - 2.0 * middle_cost + high_cost
    play = 0.0
    if bend > 0.0:
        play = min(max(0.5 * (low_cost - high_cost) / bend, -1.0), 1.0)
    elif low_cost < high_cost:
        play = -1.0
    elif high_cost < low_cost:
        play = 1.0
    start[0] = middle + play * half
    start[2] = middle


@kernel
def find_starts(p, rig, i, command, measured, joint, load, share, segments, dt, window, settle, size, starts, own):
    """A start for each of the stretches ``segments`` (m, 2) into ``starts`` (m, START); no stretch is run to its end."""
    s, scratch = np.empty(size), np.empty(window)
    drive, behind = np.empty(len(command)), np.empty(len(command))
    for row in range(len(segments)):
        _find_start(
            p, rig, i, s, command, measured, joint, load, share, segments[row, 0], segments[row, 1], dt, window, settle, drive,
            behind, scratch, starts[row], own,
        )  # fmt: skip


@kernel
def drive_axis(p, rig, i, command, measured, load, share, segments, dt, window, settle, size, drive, behind, own):
    """Free run of axis ``i`` from its command over all segments.

    Args:
        command, measured: (n,); ``measured`` is the signal that the command drives, NaN where missing.
        load: gravity load about the joint, (n,); ``share`` of the demand that the pump feeds, (n,).
        segments: (m, 2) first and last+1 sample of each stretch with commands.
        drive, behind: out, (n,): position of the drive, and of the joint behind the play where the joint is driven.
        own: the network that the axis carries, or None.
    """
    s, scratch, start = np.empty(size), np.empty(window), np.empty(START)
    for row in range(len(segments)):
        first, last = segments[row, 0], segments[row, 1]
        _find_start(
            p,
            rig,
            i,
            s,
            command,
            measured,
            measured,
            load,
            share,
            first,
            last,
            dt,
            window,
            settle,
            drive,
            behind,
            scratch,
            start,
            own,
        )
        _run(p, rig, i, s, command, load, share, first, last, start, dt, drive, behind, own)
        if rig.axes[i, CYLINDER] != 0.0:
            for k in range(first, last):
                behind[k] = drive[k]


@kernel
def add_demand(p, rig, i, command, load, segments, dt, size, total):
    """Add |speed|/gain that a velocity axis asks for to ``total`` (n,)."""
    b = i * AXIS_WIDTH
    s, m = np.empty(size), np.int64(0)
    gain = rig.axes[i, GAIN]
    for row in range(len(segments)):
        begin(s, m, size, 0.0, 0.0, np.nan, p, b, segments[row, 0], dt)
        for k in range(segments[row, 0], segments[row, 1]):
            total[k] += abs(chain.ask(command[k], p, s, m, size, rig.axes, i, load[k], dt)) / gain


@kernel
def joint_axis(p, rig, i, cylinder, measured, load, window, dt, out, own):
    """Cylinder [m] (n,) → joint behind linkage, play and sag (n,). NaN in stays NaN and keeps the play's state.

    The play begins where the first measured joint values say it stands.
    """
    b = i * AXIS_WIDTH
    low, step = rig.axes[i, TABLE_LOW], rig.axes[i, TABLE_STEP]
    s, m = np.full(STATE.input_delay, np.nan), np.int64(0)
    scratch = np.empty(window)
    count = 0
    for k in range(len(cylinder)):
        if count == window:
            break
        if not np.isnan(cylinder[k]) and not np.isnan(measured[k]) and not np.isnan(load[k]):
            sag = p[b + AT.joint_compliance_drive] * load[k]
            scratch[count] = measured[k] + sag - chain.look_up(cylinder[k], rig.tables, i, low, step)
            count += 1
    begun = False
    if own is not None:
        residual.forget(own.memory)
    for k in range(len(cylinder)):
        if np.isnan(cylinder[k]):
            out[k] = np.nan
            if own is not None:
                residual.look(own.nets, own.row, own.memory, own.commands[k], np.nan, 0.0, dt)
            continue
        x = chain.look_up(cylinder[k], rig.tables, i, low, step)
        if not begun:
            begun = True
            if count:
                s[STATE.backlash_drive] = x + _median(scratch, count)
        out[k] = chain.joint_stage(x, p, b, s, m, load[k])
        if own is not None:  # what it said at the beginning of the step that led here
            out[k] += own.memory[residual.ADDS]
            weight = 0.0 if np.isnan(load[k]) else load[k]
            residual.look(own.nets, own.row, own.memory, own.commands[k], cylinder[k], weight, dt)


@kernel
def force_axis(p, rig, i, x, v, a, dt, out, own):
    """Force that the model needs for a measured motion: positions ``x``, speeds ``v``, accelerations ``a``, each (n,)."""
    if own is not None:
        residual.forget(own.memory)
    for k in range(len(v)):
        out[k] = chain.force_at_motion(v[k], a[k], p, i * AXIS_WIDTH, rig.axes[i, GAIN])
        if own is not None:
            out[k] += residual.look(own.nets, own.row, own.memory, own.commands[k], x[k], 0.0, dt)
