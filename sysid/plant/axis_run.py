"""Runs of one axis by itself, compiled: from its command over whole recordings, and from its cylinder to its joint.

What the other axes do to it enters as series: the gravity ``load`` at measured joints, the ``share`` of its demand that
the pump feeds. The whole machine at once is :mod:`sysid.plant.machine_run`, which takes its starts from here.
"""

from __future__ import annotations

import numpy as np

from sysid.effects.compiled import kernel
from sysid.plant import chain, residual
from sysid.plant.axis_loop import begin, run
from sysid.plant.axis_start import find_start
from sysid.plant.layout import AT, AXIS_WIDTH, STATE
from sysid.plant.level import ENOUGH, median
from sysid.plant.machine_arrays import CYLINDER, GAIN, TABLE_LOW, TABLE_STEP
from sysid.plant.valve_start import ROWS, UNKNOWNS


@kernel
def find_starts(p, rig, i, command, measured, joint, load, share, segments, dt, window, settle, size, starts, own):
    """State before the first sample of each of the stretches ``segments`` (m, 2) into ``starts`` (m, size).

    No stretch is run to its end.
    """
    s, scratch, work = np.empty(size), np.empty(max(window, ENOUGH) + 1), np.empty((ROWS, UNKNOWNS + 1))
    drive, behind = np.empty(len(command)), np.empty(len(command))
    for row in range(len(segments)):
        find_start(
            p, rig, i, s, starts[row], command, measured, joint, load, share, segments[row, 0], segments[row, 1], dt, window,
            settle, drive, behind, scratch, work, False, False, own,
        )  # fmt: skip


@kernel
def drive_axis(p, rig, i, command, measured, load, share, segments, dt, window, settle, size, held, drive, behind, own):
    """Free run of axis ``i`` from its command over all segments.

    Args:
        command, measured: (n,); ``measured`` is the signal that the command drives, NaN where missing.
        load: gravity load about the joint, (n,); ``share`` of the demand that the pump feeds, (n,).
        segments: (m, 2) first and last+1 sample of each stretch with commands; where one begins at the end of the one before,
            the valve goes on as it is and only the place starts afresh.
        held: the first command was held since long before; else what the valve did then is estimated.
        drive, behind: out, (n,): position of the drive, and of the joint behind the play where the joint is driven.
        own: the network that the axis carries, or None.
    """
    s, begun, scratch, work = np.empty(size), np.empty(size), np.empty(max(window, ENOUGH) + 1), np.empty((ROWS, UNKNOWNS + 1))
    for row in range(len(segments)):
        first, last = segments[row, 0], segments[row, 1]
        follows = row > 0 and segments[row - 1, 1] == first
        find_start(
            p, rig, i, s, begun, command, measured, measured, load, share, first, last, dt, window, settle, drive, behind,
            scratch, work, follows, held, own,
        )  # fmt: skip
        run(p, rig, i, begun, command, load, share, first, last, dt, drive, behind, own)
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
                s[STATE.backlash_drive] = x + median(scratch, count)
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
