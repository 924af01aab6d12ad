"""The chain of effects in physical order, compiled. Reads top to bottom: command → speed → position → joint → structure.

A new effect is its file, its entry in the catalogue, and its line here. All functions take the flat parameter vector ``p`` of
:mod:`sysid.plant.layout`, in which the axis' block begins at ``b``, and the flat state ``s``, in which the axis' part begins
at ``m``.
"""

from __future__ import annotations

import math

import numpy as np

from sysid.effects import (
    armature_error,
    asymmetric_gain,
    backlash,
    command_rate_limit,
    coulomb_friction,
    damping_error,
    first_order_lag,
    flexible_drive,
    flow_saturation,
    force_constant_error,
    force_limit,
    gain_curve,
    gain_error,
    input_delay,
    internal_leakage,
    joint_compliance,
    load_dependent_flow,
    load_dependent_friction,
    oil_compressibility,
    second_order_lag,
    smooth_coulomb_friction,
    stiction,
    stiffness_error,
    stribeck_friction,
    temperature_drift,
    valve_deadband,
    valve_hysteresis,
    viscous_friction,
)
from sysid.effects.compiled import inlined
from sysid.plant.layout import AT, AXIS_WIDTH, STATE
from sysid.plant.machine_arrays import (
    DAMPING,
    GAIN,
    GIVE_TIME,
    HIGH,
    HIGHEST,
    IMPLICIT,
    KIND,
    LEAD,
    LOW,
    LOWEST,
    POSITION,
    SENSE,
    STIFFNESS,
    VELOCITY,
)
from sysid.plant.servo_law import held


@inlined
def opening(u, p, b, s, m):
    """Command → demanded opening of the valve, before everything that takes time."""
    return edge(valve_hysteresis.step(u, p, b + AT.valve_hysteresis, s, m + STATE.valve_hysteresis), p, b)


@inlined
def edge(u, p, b):
    """Position of the spool [command] → opening of its metering edge."""
    u = valve_deadband.step(u, p, b + AT.valve_deadband)
    u = gain_curve.step(u, p, b + AT.gain_curve)
    return flow_saturation.step(u, p, b + AT.flow_saturation)


@inlined
def late_opening(u, p, b, s, m, size, dt):
    """Demanded opening → the same behind the dead time and the friction of the spool at its centre, mean over the step.

    The spool stands in front of its edges: the command that frees it is one for both sides, whatever their overlap.
    """
    later, earlier, part = input_delay.ends(u, p, b + AT.input_delay, s, m + STATE.input_delay, size - STATE.input_delay, dt)
    if stiction.sticks(p, b + AT.stiction, s[m + STATE.first_order_lag]):
        frees = stiction.frees_at(p, b + AT.stiction, b + AT.valve_deadband)
        positive, negative = edge(frees, p, b), -edge(-frees, p, b)
        later, earlier = stiction.freed(later, positive, negative), stiction.freed(earlier, positive, negative)
    return (1.0 - part) * later + part * earlier


@inlined
def spool(u, p, b, s, m, size, dt):
    """Demanded opening → that of the spool behind dead time, its friction, ramp and lag, mean over the step."""
    u = late_opening(u, p, b, s, m, size, dt)
    u = command_rate_limit.step(u, p, b + AT.command_rate_limit, s, m + STATE.command_rate_limit, dt)
    return first_order_lag.step(u, p, b + AT.first_order_lag, s, m + STATE.first_order_lag, dt)


@inlined
def command_stage(u, p, b, s, m, size, gain, load, dt):
    """Command → demanded speed of a velocity axis [m/s or rad/s], mean over the step. ``load`` opposes positive motion.

    The dead time comes first in the machine. Static curves commute with it, and a fraction of a step is interpolated exactly
    only behind their kinks.
    """
    x = spool(opening(u, p, b, s, m), p, b, s, m, size, dt)
    x = gain_error.step(x, p, b + AT.gain_error)
    x = asymmetric_gain.step(x, p, b + AT.asymmetric_gain)
    x = temperature_drift.step(x, p, b + AT.temperature_drift, s, m + STATE.temperature_drift, dt)
    x = load_dependent_flow.step(x, p, b + AT.load_dependent_flow, load)
    v = internal_leakage.step(gain * x, p, b + AT.internal_leakage)
    v = stiction.step(v, p, b + AT.stiction, s, m + STATE.stiction, gain)
    return oil_compressibility.step(v, p, b + AT.oil_compressibility, s, m + STATE.oil_compressibility, dt)


@inlined
def position_stage(u, p, b, s, m, size, load, dt):
    """Commanded position → position of a servo axis at the end of the step (the other stages take means over the step).

    Under a ``load`` the servo is a spring; its sag, which :func:`joint_stage` subtracts, follows the load through its loop.
    The rate limit commutes with the dead time. It comes first, so that a ramp begins with its step.
    """
    limit, ramp, lag = b + AT.command_rate_limit, m + STATE.command_rate_limit, p[b + AT.first_order_lag]
    if lag < first_order_lag.ABSENT and p[b + AT.second_order_lag] >= second_order_lag.ABSENT:
        u = command_rate_limit.step(u, p, limit, s, ramp, dt)
    else:
        u = command_rate_limit.held(u, lag, p, limit, s, ramp, dt)
    u = input_delay.step(u, p, b + AT.input_delay, s, m + STATE.input_delay, size - STATE.input_delay, dt)
    first_order_lag.step(u, p, b + AT.first_order_lag, s, m + STATE.first_order_lag, dt)
    u = s[m + STATE.first_order_lag]
    second_order_lag.follow_load(load, p, b + AT.second_order_lag, s, m + STATE.second_order_lag, dt)
    return second_order_lag.step(u, p, b + AT.second_order_lag, s, m + STATE.second_order_lag, dt)


@inlined
def force_stage(u, p, b, s, m, inertia, dt):
    """Command [N or N·m] held over a step → mean speed of the drive; the state takes the speed after it."""
    u = force_constant_error.step(u, p, b + AT.force_constant_error)
    mass, v = inertia * p[b + AT.inertia_error], s[m + STATE.speed]
    if p[b + AT.flexible_drive] >= flexible_drive.ABSENT:
        after = _against_friction(v, u, v, dt / mass, p, b)
        if v == 0.0 or (v > 0.0 and after > 0.0) or (v < 0.0 and after < 0.0):
            s[m + STATE.speed] = after
            return 0.5 * (v + after)
        stop = _time_to_stop(v, u, mass, p, b)  # dry friction changes its direction within the step
        after = _against_friction(0.0, u, 0.0, (dt - stop) / mass, p, b)
        s[m + STATE.speed] = after
        return 0.5 * (v * stop + after * (dt - stop)) / dt
    i, j, moved = b + AT.flexible_drive, m + STATE.flexible_drive, 0.0
    count = flexible_drive.substeps(p, i, dt)
    short = dt / count
    flexible_drive.begin(v, p, i, s, j, short)
    for _ in range(count):
        free, mobility = flexible_drive.free_speed(v, p, i, s, j), flexible_drive.mobility(mass, p, i, s, j, short)
        after = _against_friction(free, u, v, mobility, p, b)
        moved += flexible_drive.advance((after - free) / mobility, v, mass, p, i, s, j, short)
        v = after
    s[m + STATE.speed] = v
    return moved / dt


@inlined
def _time_to_stop(v, u, mass, p, b):
    """Time [s] in which a force ``u`` and the dry friction against ``v`` stop the motion, with the friction of :func:`dry`."""
    along = math.copysign(1.0, v) * (u - p[b + AT.load_bias])
    return mass * abs(v) / (dry(v, v, p, b) - along)


@inlined
def servo_law(p, axes, i):
    """Stiffness, damping, lowest and highest force of the controller of a servo axis, and its armature."""
    b = i * AXIS_WIDTH
    kp = stiffness_error.step(axes[i, STIFFNESS], p, b + AT.stiffness_error)
    kv = damping_error.step(axes[i, DAMPING], p, b + AT.damping_error)
    low = force_limit.lowest(axes[i, LOWEST], p, b + AT.force_limit)
    high = force_limit.highest(axes[i, HIGHEST], p, b + AT.force_limit)
    return kp, kv, low, high, armature_error.step(axes[i, GAIN], p, b + AT.armature_error)


@inlined
def servo_setpoint(earlier, later, part, k, count, p, b, s, m, h, own):
    """Setpoint of the controller in step ``k`` of ``count``; ``own``: in a step of the described simulator, at its begin."""
    u = held(earlier, later, part, k, count)
    before, mean = first_order_lag.across(u, p, b + AT.first_order_lag, s, m + STATE.first_order_lag, h)
    return before if own else mean


@inlined
def rotor(armature, kv, friction, axes, i):
    """Inertia of the rotor as the steps of the described simulator make it, with the damping ``kv`` of an active controller.

    ``friction``: viscous friction, which is implicit in them.
    """
    return armature + axes[i, LEAD] * (axes[i, IMPLICIT] * kv + friction)


@inlined
def give_time(axes, i, own):
    """Time in which the dry friction of a servo axis gives way [s]; ``own``: in steps of the described simulator."""
    return axes[i, GIVE_TIME] + (axes[i, LEAD] if own else 0.0)


@inlined
def has_backlash(p, b):
    """Whether a servo moves its joint through a backlash."""
    return p[b + AT.backlash_drive] > 0.0


@inlined
def servo_motion(p, b, s, m):
    """Position and speed of the joint of a servo axis; those of the motor until its backlash has begun."""
    j = m + STATE.backlash_drive
    if has_backlash(p, b) and not np.isnan(s[j]):
        return s[j], s[j + 1]
    return s[m + STATE.position], s[m + STATE.speed]


@inlined
def servo_joint(p, b, s, m, axes, i):
    """Joint of a servo axis at a sample: steps of the described simulator are half a step ahead of the motion."""
    place, speed = servo_motion(p, b, s, m)
    return place + axes[i, LEAD] * speed


@inlined
def rest_on_flank(force, p, b, s, m):
    """Let the joint begin where the motor was, on the flank that a ``force`` of the motor presses [N·m or N]."""
    j, half = m + STATE.backlash_drive, 0.5 * p[b + AT.backlash_drive]
    if half > 0.0 and np.isnan(s[j]):
        s[j], s[j + 1] = s[m + STATE.position], s[m + STATE.speed]
        s[m + STATE.position] += half if force > 0.0 else -half if force < 0.0 else 0.0


@inlined
def servo_friction(w, p, b):
    """Viscous and smooth dry friction of a servo axis over its speed, at the speed ``w`` [N·m·s/rad or N·s/m]."""
    viscous = p[b + AT.viscous_friction] if w > 0.0 else p[b + AT.viscous_friction + 1]
    return viscous, smooth_coulomb_friction.slope(w, p, b + AT.smooth_coulomb_friction)


@inlined
def friction_changes(v, w, p, b):
    """Whether :func:`servo_friction` at the speed ``w`` may differ from that at ``v``."""
    return (v > 0.0) != (w > 0.0) or p[b + AT.smooth_coulomb_friction] != 0.0


@inlined
def dry(moved, v, p, b):
    """Largest dry friction [N or N·m] against a motion of the sign of ``moved``, at the speed ``v`` before the step."""
    return coulomb_friction.limit(moved, p, b + AT.coulomb_friction) + stribeck_friction.magnitude(
        v, p, b + AT.stribeck_friction
    )


@inlined
def _against_friction(free, u, v, mobility, p, b):
    """Speed after a step under a force ``u`` held over it, which changes it from ``free`` by ``mobility`` times the force.

    Dry friction is applied last and may stop the motion but not reverse it (implicit step), so the axis sticks without
    chattering. ``v``: speed before the step, which decides the direction of viscous friction.
    """
    slope = p[b + AT.viscous_friction] if v > 0.0 else p[b + AT.viscous_friction + 1]
    slope += smooth_coulomb_friction.slope(v, p, b + AT.smooth_coulomb_friction)
    moved = (free + mobility * (u - p[b + AT.load_bias])) / (1.0 + mobility * slope)
    hold = mobility * dry(moved, v, p, b) / (1.0 + mobility * slope)
    if moved > hold:
        return moved - hold
    if moved < -hold:
        return moved + hold
    return 0.0


@inlined
def force_at_motion(v, a, load, p, b, inertia):
    """Command [N or N·m] that the model needs for a measured motion of the motor: speed ``v`` and acceleration ``a``.

    ``a`` is that of the centre of mass of motor and load, where a spring is between them. ``load``: torque of the links, which
    the transmission carries; it causes friction here and is not contained.
    """
    force = (
        inertia * p[b + AT.inertia_error] * a
        + coulomb_friction.force(v, p, b + AT.coulomb_friction)
        + viscous_friction.force(v, p, b + AT.viscous_friction)
        + stribeck_friction.force(v, p, b + AT.stribeck_friction)
        + smooth_coulomb_friction.force(v, p, b + AT.smooth_coulomb_friction)
        + load_dependent_friction.force(v, load, p, b + AT.load_dependent_friction, b + AT.smooth_coulomb_friction)
        + p[b + AT.load_bias]
    )
    return force / p[b + AT.force_constant_error]


@inlined
def demand(u, p, s, m, size, axes, i, load, dt):
    """Demand of axis ``i`` of ``MachineArrays.axes`` in this step: mean speed, or the position of a servo.

    ``load`` is the gravity load about the joint.
    """
    b, kind, gain = i * AXIS_WIDTH, axes[i, KIND], axes[i, GAIN]
    if kind == VELOCITY:
        return command_stage(u, p, b, s, m, size, gain, axes[i, SENSE] * load, dt)
    if kind == POSITION:
        if not np.isnan(s[m + STATE.setpoint]):  # before the recording, from what it led to
            u = s[m + STATE.setpoint]
            s[m + STATE.setpoint] = np.nan
        return min(max(position_stage(u, p, b, s, m, size, load, dt), axes[i, LOW]), axes[i, HIGH])
    return force_stage(u, p, b, s, m, gain, dt)


@inlined
def stop(s, m, axes, i):
    """Hold an axis with a speed at its end stops."""
    if s[m + STATE.position] > axes[i, HIGH]:
        s[m + STATE.position] = axes[i, HIGH]
        s[m + STATE.speed] = min(s[m + STATE.speed], 0.0)
    elif s[m + STATE.position] < axes[i, LOW]:
        s[m + STATE.position] = axes[i, LOW]
        s[m + STATE.speed] = max(s[m + STATE.speed], 0.0)


@inlined
def move(demanded, s, m, axes, i, dt):
    """Motion of the step, up to the end stops; returns the position *before* it, on the sample grid."""
    if axes[i, KIND] == POSITION:
        s[m + STATE.position] = demanded
        return demanded
    if axes[i, KIND] == VELOCITY:
        s[m + STATE.speed] = demanded
    position = s[m + STATE.position]
    s[m + STATE.position] = position + dt * demanded
    stop(s, m, axes, i)
    return position


@inlined
def joint_stage(x, p, b, s, m, load):
    """Drive (behind the linkage) → joint at its sensor; ``load`` is the gravity moment about the joint."""
    q = backlash.step(x, p, b + AT.backlash_drive, s, m + STATE.backlash_drive)
    deflecting = second_order_lag.deflecting_load(load, p, b + AT.second_order_lag, s, m + STATE.second_order_lag)
    return joint_compliance.step(q, p, b + AT.joint_compliance_drive, deflecting)


@inlined
def structure_stage(q, p, b, s, m, load):
    """Joint at its sensor → joint of the structure."""
    q = backlash.step(q, p, b + AT.backlash_structure, s, m + STATE.backlash_structure) + p[b + AT.joint_offset]
    return joint_compliance.step(q, p, b + AT.joint_compliance_structure, load)


@inlined
def look_up(x, tables, i, low, step):
    """Linear interpolation in row ``i`` of even tables, extended along its end slopes."""
    last = tables.shape[1] - 1
    t = (x - low) / step
    k = math.floor(t)
    if k < 0:
        k = 0
    elif k >= last:
        k = last - 1
    return tables[i, k] + (t - k) * (tables[i, k + 1] - tables[i, k])
