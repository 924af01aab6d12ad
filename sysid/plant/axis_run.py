"""Runs of one axis by itself, compiled: from its command over whole recordings, and from its cylinder to its joint.

The influence of the other axes enters as series: the gravity ``load`` at measured joints and the ``share`` of its demand that
the pump supplies. :mod:`sysid.plant.machine_run` runs the whole machine, from the start states computed here.
"""

from __future__ import annotations

import numpy as np

from sysid.effects import flexible_drive
from sysid.effects.compiled import inlined, kernel
from sysid.plant import chain, residual
from sysid.plant.axis_loop import begin, run
from sysid.plant.axis_start import find_start
from sysid.plant.layout import AT, AXIS_WIDTH, STATE
from sysid.plant.level import MEDIAN_SAMPLES, median
from sysid.plant.machine_arrays import CYLINDER, GAIN, TABLE_LOW, TABLE_STEP
from sysid.plant.valve_start import ROWS, UNKNOWNS


@kernel
def find_starts(p, arrays, i, command, measured, joint, load, share, segments, dt, window, settle, size, starts, net):
    """State before the first sample of each of the stretches ``segments`` (m, 2) into ``starts`` (m, size).

    No stretch is run to its end.
    """
    s, scratch, work = np.empty(size), np.empty(max(window, MEDIAN_SAMPLES) + 1), np.empty((ROWS, UNKNOWNS + 1))
    drive, behind = np.empty(len(command)), np.empty(len(command))
    no = np.bool_(False)  # a literal has another type and would be compiled separately
    for row in range(len(segments)):
        find_start(
            p, arrays, i, s, starts[row], command, measured, joint, load, share, segments[row, 0], segments[row, 1], dt, window,
            settle, drive, behind, scratch, work, no, no, net,
        )  # fmt: skip


@kernel
def drive_axis(p, arrays, i, command, measured, load, share, segments, dt, window, settle, size, held, drive, behind, net):
    """Free run of axis ``i`` from its command over all segments.

    Args:
        command, measured: (n,); ``measured`` is the signal that the command drives, NaN where missing.
        load: gravity load about the joint, (n,); ``share`` of the demand that the pump supplies, (n,).
        segments: (m, 2) first and last+1 sample of each stretch with commands; where one begins at the end of the one before,
            the valve keeps its state and only the position is estimated again.
        held: the first command was held for a long time before; else the earlier state of the valve is estimated.
        drive, behind: out, (n,): position of the drive, and of the joint behind the backlash where the joint is driven.
        net: residual network of the axis, or None.
    """
    s, begun, scratch, work = (
        np.empty(size),
        np.empty(size),
        np.empty(max(window, MEDIAN_SAMPLES) + 1),
        np.empty((ROWS, UNKNOWNS + 1)),
    )
    for row in range(len(segments)):
        first, last = segments[row, 0], segments[row, 1]
        follows = row > 0 and segments[row - 1, 1] == first
        find_start(
            p, arrays, i, s, begun, command, measured, measured, load, share, first, last, dt, window, settle, drive, behind,
            scratch, work, follows, held, net,
        )  # fmt: skip
        run(p, arrays, i, begun, command, load, share, first, last, dt, drive, behind, net)
        if arrays.axes[i, CYLINDER] != 0.0:
            for k in range(first, last):
                behind[k] = drive[k]


@kernel
def add_demand(p, arrays, i, command, load, segments, dt, size, total):
    """Add the demanded |speed|/gain of a velocity axis to ``total`` (n,)."""
    b = i * AXIS_WIDTH
    s, m = np.empty(size), np.int64(0)
    gain = arrays.axes[i, GAIN]
    for row in range(len(segments)):
        begin(s, m, size, 0.0, 0.0, np.nan, p, b, segments[row, 0], dt)
        for k in range(segments[row, 0], segments[row, 1]):
            total[k] += abs(chain.demand(command[k], p, s, m, size, arrays.axes, i, load[k], dt)) / gain


@kernel
def joint_axis(p, arrays, i, cylinder, measured, load, window, dt, out, net):
    """Cylinder [m] (n,) → joint behind linkage, backlash and sag (n,). NaN stays NaN and keeps the state of the backlash.

    The initial state of the backlash follows from the first measured joint values.
    """
    b = i * AXIS_WIDTH
    low, step = arrays.axes[i, TABLE_LOW], arrays.axes[i, TABLE_STEP]
    s, m = np.full(STATE.input_delay, np.nan), np.int64(0)
    scratch = np.empty(window)
    count = np.int64(0)
    for k in range(len(cylinder)):
        if count == window:
            break
        if not np.isnan(cylinder[k]) and not np.isnan(measured[k]) and not np.isnan(load[k]):
            sag = p[b + AT.joint_compliance_drive] * load[k]
            scratch[count] = measured[k] + sag - chain.look_up(cylinder[k], arrays.tables, i, low, step)
            count += 1
    begun = False
    if net is not None:
        residual.reset_memory(net.memory)
    for k in range(len(cylinder)):
        if np.isnan(cylinder[k]):
            out[k] = np.nan
            if net is not None:
                residual.update_stage(net, k, np.nan, 0.0, dt)
            continue
        x = chain.look_up(cylinder[k], arrays.tables, i, low, step)
        if not begun:
            begun = True
            if count:
                s[STATE.backlash_drive] = x + median(scratch, count)
        out[k] = chain.joint_stage(x, p, b, s, m, load[k])
        if net is not None:  # output at the beginning of the step that led here
            out[k] += net.memory[residual.OUTPUT]
            weight = 0.0 if np.isnan(load[k]) else load[k]
            residual.update_stage(net, k, cylinder[k], weight, dt)


@inlined
def _sharpened(a, k):
    """Sample ``k`` of values (n,) from which linear interpolation gives those of a smooth curve to fourth order.

    Linear interpolation multiplies the spectrum by sinc² = 1 − (ω·dt)²/12 + …, which second differences compensate.
    """
    if k == 0 or k == len(a) - 1:
        return a[k]
    return a[k] - (a[k + 1] - 2.0 * a[k] + a[k - 1]) / 12.0


@kernel
def force_axis(p, arrays, i, x, v, a, torque, dt, out, net):
    """Force that the model needs for a measured motion under a torque of links ``torque``, which it does not contain.

    Positions ``x``, speeds ``v``, accelerations ``a``, each (n,).
    """
    b, s = i * AXIS_WIDTH, np.full(flexible_drive.INVERSE_MEMORY, np.nan)
    flexible = p[b + AT.flexible_drive] < flexible_drive.ABSENT
    if net is not None:
        residual.reset_memory(net.memory)
    for k in range(len(v)):
        mean = a[k]
        if flexible:
            load = flexible_drive.load_acceleration(_sharpened(a, k), p, b + AT.flexible_drive, s, 0, dt)
            mean = flexible_drive.mean(a[k], load, p, b + AT.flexible_drive)
        out[k] = chain.force_at_motion(v[k], mean, torque[k], p, b, arrays.axes[i, GAIN])
        if net is not None:
            out[k] += residual.update_stage(net, k, x[k], 0.0, dt)
