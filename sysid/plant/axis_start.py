"""Start state of a run of one axis, before its first sample, estimated from the first seconds of the measurement; compiled.

Position and valve of a velocity axis (:mod:`sysid.plant.valve_start`), setpoints in the dead time of a position axis
(:mod:`sysid.plant.servo_start`), position and speed of a force axis; then the position of the joint inside its backlash.
"""

from __future__ import annotations

import numpy as np

from sysid.effects.compiled import inlined, loop
from sysid.plant import chain
from sysid.plant.axis_loop import begin, run
from sysid.plant.layout import AT, AXIS_WIDTH, STATE
from sysid.plant.level import first_motion, line, mean, median, middle_and_spread, shift
from sysid.plant.machine_arrays import CYLINDER, FORCE, HIGH, KIND, LOW, POSITION, TABLE_LOW, TABLE_STEP, VELOCITY
from sysid.plant.servo_start import start_servo
from sysid.plant.valve_start import LEVEL_SECONDS, SPIKE, start_valve

#: The speed of a force axis is estimated from this time [s], in this number of iterations.
SPEED_WINDOW, SPEED_ROUNDS = 1.0, 6
#: Iterations for the position of the drive in its backlash.
SIDE_ROUNDS = 2


@inlined
def _copy_state(s, start):
    for k in range(len(s)):
        s[k] = start[k]


@loop
def _first_measured(measured, first, last, low, high):
    for k in range(first, last):
        if not np.isnan(measured[k]):
            return measured[k]
    return min(max(0.0, low), high)


@loop
def _start_force(p, arrays, i, s, start, command, measured, load, share, first, last, dt, out, behind, net):
    """Position and speed at which the differences of the first second have no offset and no slope, by secant steps.

    Where friction stops the axis, the speed has no influence, and that of the step before is kept.
    """
    low, high = arrays.axes[i, LOW], arrays.axes[i, HIGH]
    simulated = out if arrays.axes[i, CYLINDER] != 0.0 else behind
    near = min(last, first + round(SPEED_WINDOW / dt))
    changed, rise_before, gain = 0.0, 0.0, 1.0
    for iteration in range(SPEED_ROUNDS):
        _copy_state(s, start)
        run(p, arrays, i, s, command, load, share, first, near, dt, out, behind, net)
        place, rise = line(measured, simulated, first, near)
        start[STATE.position] = min(max(start[STATE.position] + place, low), high)
        rise /= dt
        if iteration and abs(rise_before - rise) > 1e-3 * abs(changed):
            gain = min(max(changed / (rise_before - rise), 0.5), 5.0)
        rise_before = rise
        if iteration < SPEED_ROUNDS - 1:
            changed = gain * rise
            start[STATE.speed] += changed


@loop
def _start_level(p, arrays, i, s, start, command, measured, load, share, first, near, dt, out, behind, scratch, net):
    """The position alone, from the samples up to ``near``."""
    low, high = arrays.axes[i, LOW], arrays.axes[i, HIGH]
    simulated = out if arrays.axes[i, CYLINDER] != 0.0 else behind
    _copy_state(s, start)
    run(p, arrays, i, s, command, load, share, first, near, dt, out, behind, net)
    middle, spread = middle_and_spread(measured, simulated, first, near, near - first, scratch)
    if not np.isnan(middle):
        middle = shift(measured, simulated, first, near, near - first, middle, SPIKE * spread)
        start[STATE.position] = min(max(start[STATE.position] + middle, low), high)


@loop
def _start_joint(p, arrays, i, s, start, command, joint, load, share, first, near, dt, out, behind, scratch, net):
    """Position of the joint behind a cylinder, from the samples up to ``near``."""
    b = i * AXIS_WIDTH
    _copy_state(s, start)
    run(p, arrays, i, s, command, load, share, first, near, dt, out, behind, net)
    count = np.int64(0)  # a literal 0 has another type and would be compiled separately
    for k in range(first, near):
        behind[k] = chain.look_up(out[k], arrays.tables, i, arrays.axes[i, TABLE_LOW], arrays.axes[i, TABLE_STEP])
        if not np.isnan(joint[k]) and not np.isnan(behind[k]):
            scratch[count] = joint[k] + p[b + AT.joint_compliance_drive] * load[k] - behind[k]
            count += 1
    if count:
        start[STATE.backlash_drive] = behind[first] + median(scratch, count)


@loop
def _start_side(p, arrays, i, s, start, command, measured, load, share, first, moved, far, dt, out, behind, net):
    """Position in the backlash of an axis whose joint is driven, so that the samples from ``moved`` to ``far`` have no offset.

    Once the drive has crossed the backlash, the joint is displaced as much as the start of the drive is. Each round displaces
    the start by the mean difference; the second corrects for the samples in which the first was not across yet.
    """
    half = 0.5 * p[i * AXIS_WIDTH + AT.backlash_drive]
    middle = start[STATE.position]
    start[STATE.backlash_drive] = middle
    for _ in range(SIDE_ROUNDS):
        _copy_state(s, start)
        run(p, arrays, i, s, command, load, share, first, far, dt, out, behind, net)
        place = start[STATE.position] + mean(measured, behind, moved, far)
        start[STATE.position] = min(max(place, middle - half), middle + half)


@loop
def find_start(
    p, arrays, i, s, start, command, measured, joint, load, share, first, last, dt, window, settle, out, behind, scratch, work,
    follows, held, net,
):  # fmt: skip
    """State ``start`` (size,) in which a stretch starts.

    Args:
        window: samples for the position of the joint behind a cylinder, and for that of a stretch that ``follows``.
        settle: samples after the first motion for the position of the drive in its backlash; those before do not show it.
        follows: the stretch follows the one that ended in ``start``: the valve is known, only the position is estimated.
        held: the first command was held for a long time before: the valve is known as well.
        s, out, behind, scratch, work: used inside.
    """
    b, m = i * AXIS_WIDTH, np.int64(0)
    low, high, kind = arrays.axes[i, LOW], arrays.axes[i, HIGH], arrays.axes[i, KIND]
    near = min(first + window, last)
    cylinder = arrays.axes[i, CYLINDER] != 0.0
    # A joint behind backlash rests while the drive crosses it; in a short window it is less likely to have been crossed. With
    # a lag, a short window does not distinguish that from a valve that opens.
    sudden = p[b + AT.first_order_lag] + p[b + AT.input_delay] == 0.0
    calm = window if sudden and not cylinder and p[b + AT.backlash_drive] > 0.0 else round(LEVEL_SECONDS / dt)
    level = follows or (held and kind != FORCE)
    position = _first_measured(measured, first, near if level else min(first + max(window, calm), last), low, high)
    speed = 0.0
    if kind == FORCE:
        for k in range(first, near):
            out[k] = 0.0
        speed = line(measured, out, first, near)[1] / dt
    if not follows:
        begin(start, m, len(start), position, speed, np.nan, p, b, first, dt)
    elif kind != POSITION:
        start[STATE.position] = position
        start[STATE.speed] = speed
        start[STATE.backlash_drive] = np.nan
    if kind == VELOCITY and not level:
        start_valve(
            p, arrays, i, s, start, command, measured, load, share, first, last, calm, dt, out, behind, scratch, work, net
        )  # fmt: skip
    elif kind == FORCE and not follows:
        _start_force(p, arrays, i, s, start, command, measured, load, share, first, last, dt, out, behind, net)
    else:
        if kind == POSITION and not level:
            start_servo(p, arrays, i, start, command, measured, load, first, last, dt, out)
        _start_level(p, arrays, i, s, start, command, measured, load, share, first, near, dt, out, behind, scratch, net)
    if cylinder:
        _start_joint(p, arrays, i, s, start, command, joint, load, share, first, near, dt, out, behind, scratch, net)
    elif p[b + AT.backlash_drive] > 0.0:
        moved = first_motion(measured, first, last)
        far = min(moved + settle, last)
        _start_side(p, arrays, i, s, start, command, measured, load, share, first, moved, far, dt, out, behind, net)
