"""Where a run of one axis starts: its state before the first sample, estimated from the first seconds of the measurement.

Compiled. Position and valve of a velocity axis (:mod:`sysid.plant.valve_start`), set-points on their way of a position axis
(:mod:`sysid.plant.servo_start`), position and speed of a force axis; then where the joint stands inside its play.
"""

from __future__ import annotations

import numpy as np

from sysid.effects.compiled import inlined, loop
from sysid.plant import chain
from sysid.plant.axis_loop import begin, run
from sysid.plant.layout import AT, AXIS_WIDTH, STATE
from sysid.plant.level import line, median, middle_and_spread, shift, squares
from sysid.plant.machine_arrays import CYLINDER, FORCE, HIGH, KIND, LOW, POSITION, TABLE_LOW, TABLE_STEP, VELOCITY
from sysid.plant.servo_start import start_servo
from sysid.plant.valve_start import LEVEL, SPIKE, start_valve

#: A force axis takes its speed from this long [s], corrected so many times.
SPEED_WINDOW, SPEED_ROUNDS = 1.0, 6


@inlined
def _again(s, begun):
    for k in range(len(s)):
        s[k] = begun[k]


@loop
def _first_measured(measured, first, last, low, high):
    for k in range(first, last):
        if not np.isnan(measured[k]):
            return measured[k]
    return min(max(0.0, low), high)


@loop
def _start_force(p, rig, i, s, begun, command, measured, load, share, first, last, dt, out, behind, own):
    """Position and speed at which nothing of a line is left in the differences of the first second, by secant steps.

    Where friction stops the axis, another speed makes no difference, and that of the step before is kept.
    """
    low, high = rig.axes[i, LOW], rig.axes[i, HIGH]
    said = out if rig.axes[i, CYLINDER] != 0.0 else behind
    near = min(last, first + round(SPEED_WINDOW / dt))
    changed, rise_before, gain = 0.0, 0.0, 1.0
    for turn in range(SPEED_ROUNDS):
        _again(s, begun)
        run(p, rig, i, s, command, load, share, first, near, dt, out, behind, own)
        place, rise = line(measured, said, first, near)
        begun[STATE.position] = min(max(begun[STATE.position] + place, low), high)
        rise /= dt
        if turn and abs(rise_before - rise) > 1e-3 * abs(changed):
            gain = min(max(changed / (rise_before - rise), 0.5), 5.0)
        rise_before = rise
        if turn < SPEED_ROUNDS - 1:
            changed = gain * rise
            begun[STATE.speed] += changed


@loop
def _start_level(p, rig, i, s, begun, command, measured, load, share, first, near, dt, out, behind, scratch, own):
    """The position alone, from the samples up to ``near``."""
    low, high = rig.axes[i, LOW], rig.axes[i, HIGH]
    said = out if rig.axes[i, CYLINDER] != 0.0 else behind
    _again(s, begun)
    run(p, rig, i, s, command, load, share, first, near, dt, out, behind, own)
    middle, spread = middle_and_spread(measured, said, first, near, near - first, scratch)
    if not np.isnan(middle):
        middle = shift(measured, said, first, near, near - first, middle, SPIKE * spread)
        begun[STATE.position] = min(max(begun[STATE.position] + middle, low), high)


@loop
def _start_joint(p, rig, i, s, begun, command, joint, load, share, first, near, dt, out, behind, scratch, own):
    """Where the joint behind a cylinder stands, from the samples up to ``near``."""
    b = i * AXIS_WIDTH
    _again(s, begun)
    run(p, rig, i, s, command, load, share, first, near, dt, out, behind, own)
    count = 0
    for k in range(first, near):
        behind[k] = chain.look_up(out[k], rig.tables, i, rig.axes[i, TABLE_LOW], rig.axes[i, TABLE_STEP])
        if not np.isnan(joint[k]) and not np.isnan(behind[k]):
            scratch[count] = joint[k] + p[b + AT.joint_compliance_drive] * load[k] - behind[k]
            count += 1
    if count:
        begun[STATE.backlash_drive] = behind[first] + median(scratch, count)


@loop
def _start_side(p, rig, i, s, begun, command, measured, load, share, first, far, dt, out, behind, own):
    """The side of the play that fits the samples up to ``far`` best, for an axis whose joint is driven."""
    half = 0.5 * p[i * AXIS_WIDTH + AT.backlash_drive]
    middle = begun[STATE.position]
    begun[STATE.backlash_drive] = middle
    low_cost, middle_cost, high_cost = 0.0, 0.0, 0.0
    for side in range(3):
        begun[STATE.position] = middle + (side - 1.0) * half
        _again(s, begun)
        run(p, rig, i, s, command, load, share, first, far, dt, out, behind, own)
        cost = squares(measured, behind, first, far)
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
    begun[STATE.position] = middle + play * half


@loop
def find_start(
    p, rig, i, s, begun, command, measured, joint, load, share, first, last, dt, window, settle, out, behind, scratch, work,
    follows, held, own,
):  # fmt: skip
    """State ``begun`` (size,) in which a stretch starts.

    Args:
        window: samples that show where the joint behind a cylinder stands, and what follows on from ``begun``.
        settle: samples that show on which side of a play the drive stands; those of the window cannot.
        follows: the stretch follows on the one that ended in ``begun``: the valve is known, only the place starts afresh.
        held: so is a first command that was held since long before.
        s, out, behind, scratch, work: used inside.
    """
    b, m = i * AXIS_WIDTH, np.int64(0)
    low, high, kind = rig.axes[i, LOW], rig.axes[i, HIGH], rig.axes[i, KIND]
    near = min(first + window, last)
    cylinder = rig.axes[i, CYLINDER] != 0.0
    # A joint behind a play stands still while the drive crosses it: the shorter, the surer that it has not been crossed. With
    # a lag, a short stretch does not tell that from a valve that opens.
    sudden = p[b + AT.first_order_lag] + p[b + AT.input_delay] == 0.0
    calm = window if sudden and not cylinder and p[b + AT.backlash_drive] > 0.0 else round(LEVEL / dt)
    level = follows or (held and kind != FORCE)
    position = _first_measured(measured, first, near if level else min(first + max(window, calm), last), low, high)
    speed = 0.0
    if kind == FORCE:
        for k in range(first, near):
            out[k] = 0.0
        speed = line(measured, out, first, near)[1] / dt
    if not follows:
        begin(begun, m, len(begun), position, speed, np.nan, p, b, first, dt)
    elif kind != POSITION:
        begun[STATE.position] = position
        begun[STATE.speed] = speed
        begun[STATE.backlash_drive] = np.nan
    if kind == VELOCITY and not level:
        start_valve(
            p, rig, i, s, begun, command, measured, load, share, first, last, calm, dt, out, behind, scratch, work, own
        )  # fmt: skip
    elif kind == FORCE and not follows:
        _start_force(p, rig, i, s, begun, command, measured, load, share, first, last, dt, out, behind, own)
    else:
        if kind == POSITION and not level:
            start_servo(p, rig, i, begun, command, measured, first, last, dt)
        _start_level(p, rig, i, s, begun, command, measured, load, share, first, near, dt, out, behind, scratch, own)
    if cylinder:
        _start_joint(p, rig, i, s, begun, command, joint, load, share, first, near, dt, out, behind, scratch, own)
    elif p[b + AT.backlash_drive] > 0.0:
        far = min(first + settle, last)
        _start_side(p, rig, i, s, begun, command, measured, load, share, first, far, dt, out, behind, own)
