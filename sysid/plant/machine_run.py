"""The whole machine step by step, compiled: all axes at once, since they share a pump and load each other by their weight.

:func:`observe` computes the outputs at a sample, :func:`advance` the state at the next one. The free run of a recording and
the lanes of :class:`sysid.plant.stepper.Stepper` are loops around these two.
"""

from __future__ import annotations

import numpy as np

from sysid.effects import pump_flow_limit, second_order_lag
from sysid.effects.compiled import inlined, kernel, loop
from sysid.plant import chain, residual, servo_arm
from sysid.plant.layout import AT, AXIS_WIDTH, STATE
from sysid.plant.machine_arrays import CYLINDER, FORCE, GAIN, HIGH, KIND, LOW, POSITION, SERVO, TABLE_LOW, TABLE_STEP, VELOCITY
from sysid.plant.pose import SCRATCH, pose
from sysid.plant.settled_pose import SETTLING

#: Places of :data:`sysid.plant.residual.STAGES`.
COMMAND, JOINT, INVERSE = range(3)


@inlined
def observe(p, arrays, s, load, scratch, drive, joints, structure, tip, nets, t):
    """State ``s`` (A · size,) → drive, joint sensors, structure, each (A,), end effector (3,), and the ``load`` (A,) there.

    Sag follows from the value of ``load`` on entry, that of the deflected posture one sample before. An axis without a position
    is NaN, and then so is the tip. ``nets`` and their memory ``t`` (R, M) are None where the plant has none.
    """
    missing = len(arrays.links) < 2
    size = len(s) // len(arrays.axes)
    for i in range(len(arrays.axes)):
        b, m = i * AXIS_WIDTH, i * size
        x = chain.servo_joint(p, b, s, m, arrays.axes, i) if arrays.axes[i, KIND] == SERVO else s[m + STATE.position]
        drive[i] = x
        if arrays.axes[i, CYLINDER] != 0.0 and not np.isnan(x):
            x = chain.look_up(x, arrays.tables, i, arrays.axes[i, TABLE_LOW], arrays.axes[i, TABLE_STEP])
        if np.isnan(x):
            joints[i] = np.nan
            structure[i] = np.nan
            missing = True
            continue
        joints[i] = x if arrays.axes[i, KIND] == SERVO else chain.joint_stage(x, p, b, s, m, load[i])
        if nets is not None:
            joints[i] += residual.contribution(nets, t, i, JOINT)
        structure[i] = chain.structure_stage(joints[i], p, b, s, m, load[i])
    if missing:
        tip[0] = np.nan
        tip[1] = np.nan
        tip[2] = np.nan
    else:
        pose(structure, p, arrays.links, arrays.base, scratch, tip, load)


@inlined
def settling(p, axes):
    """Observations after the first one in which a machine at rest settles under the load of its posture."""
    for i in range(axes):
        b = i * AXIS_WIDTH
        if p[b + AT.joint_compliance_drive] != 0.0 or p[b + AT.joint_compliance_structure] != 0.0:
            return SETTLING
    return 1


@inlined
def advance(p, arrays, s, load, demands, servos, command, dt, nets, t):
    """One step of all axes with ``command`` (A,); axes without a position stay as they are.

    ``demands`` (A,) and ``servos`` (:func:`sysid.plant.servo_arm.workspace`) are used inside.
    """
    if servos is not None:  # a branch of the type: what a machine does not have is not compiled
        servo_arm.advance(p, arrays, s, command, dt, servos, False)
        return
    size = len(s) // len(arrays.axes)
    demand = 0.0
    if nets is not None:
        for r in range(len(t)):
            i = int(nets.about[r, residual.AXIS])
            residual.update(nets, r, t[r], command, s[i * size + STATE.position], load[i], dt)
    for i in range(len(arrays.axes)):
        if np.isnan(s[i * size + STATE.position]):
            continue
        setpoint = command[i]
        if nets is not None and arrays.axes[i, KIND] == FORCE:
            setpoint -= residual.contribution(nets, t, i, INVERSE)
        demands[i] = chain.demand(setpoint, p, s, i * size, size, arrays.axes, i, load[i], dt)
        if arrays.axes[i, KIND] == VELOCITY:
            demand += abs(demands[i]) / arrays.axes[i, GAIN]
    share = pump_flow_limit.share(demand, p, arrays.machine + AT.pump_flow_limit)
    for i in range(len(arrays.axes)):
        if not np.isnan(s[i * size + STATE.position]):
            part = share if arrays.axes[i, KIND] == VELOCITY else 1.0
            if nets is None:
                chain.move(part * demands[i], s, i * size, arrays.axes, i, dt)
            else:
                extra = residual.contribution(nets, t, i, COMMAND)
                moved = part * demands[i] * (1.0 + extra) if arrays.axes[i, KIND] == VELOCITY else demands[i] + extra
                chain.move(within(moved, arrays.axes, i), s, i * size, arrays.axes, i, dt)


@inlined
def within(demands, axes, i):
    """The position of a servo, limited to its stops; speeds are limited by :func:`sysid.plant.chain.move`."""
    return min(max(demands, axes[i, LOW]), axes[i, HIGH]) if axes[i, KIND] == POSITION else demands


@inlined
def enter(p, arrays, i, s, size, load, start, command, dt, nets, t):
    """Put axis ``i`` into the state ``start`` (size,) before its first sample, at which it gets ``command``."""
    for j in range(size):
        s[i * size + j] = start[j]
    load[i] = 0.0
    if nets is not None:
        residual.reset_axis(nets, t, i)
    if arrays.axes[i, KIND] == POSITION:
        where = chain.demand(command, p, s, i * size, size, arrays.axes, i, 0.0, dt)
        s[i * size + STATE.position] = where
        s[i * size + STATE.second_order_lag + second_order_lag.LOAD] = np.nan  # the load of the place is not known yet


@loop
def _run(
    p, arrays, commands, edges, starts, dt, size, drive, joints, tip, s, load, demands, servos, structure, row, scratch, at,
    nets, t,
):  # fmt: skip
    count, axes = drive.shape
    for k in range(count):
        fresh = False
        for i in range(axes):
            if at[i] < edges.shape[1] and k == edges[i, at[i], 1]:
                s[i * size + STATE.position] = np.nan
                at[i] += 1
            if at[i] < edges.shape[1] and k == edges[i, at[i], 0]:
                fresh = True
                enter(p, arrays, i, s, size, load, starts[i, at[i]], commands[k, i], dt, nets, t)
        observe(p, arrays, s, load, scratch, drive[k], joints[k], structure, tip[k], nets, t)
        if fresh:  # again with the load of the posture, until the machine has settled in it
            for _ in range(settling(p, axes)):
                for i in range(axes):
                    if at[i] < edges.shape[1] and k == edges[i, at[i], 0]:
                        s[i * size + STATE.backlash_structure] = np.nan
                observe(p, arrays, s, load, scratch, drive[k], joints[k], structure, tip[k], nets, t)
        for i in range(axes):
            row[i] = commands[k, i]
            if arrays.axes[i, KIND] == POSITION and k + 1 < len(commands):
                row[i] = commands[k + 1, i]
        advance(p, arrays, s, load, demands, servos, row, dt, nets, t)


@kernel
def run_machine(p, arrays, commands, edges, starts, dt, drive, joints, tip, s, load, servos, nets, t):
    """Free run of all axes from their commands.

    Args:
        commands: (n or n + 1, A), held where they are missing inside a stretch.
        edges: (A, m, 2) first and last+1 sample of each axis' stretches, in order; beyond the last one n + 1.
        starts: (A, m, size) as :func:`sysid.plant.axis_run.find_starts` gives them.
        drive, joints: out, (n, A), NaN outside of the stretches; ``tip`` (n, 3), NaN where any joint is.
        s, load: (A · size,) NaN and (A,) zero before; after it the state that the n steps lead to.
        servos: of :func:`sysid.plant.servo_arm.workspace`.
        nets: residual networks, with their memory ``t``; both None where the plant has none.
    """
    axes = commands.shape[1]
    size = len(s) // axes
    demands, structure, row = np.zeros(axes), np.zeros(axes), np.zeros(axes)
    scratch = np.empty((len(arrays.links), SCRATCH))
    at = np.zeros(axes, dtype=np.int64)
    _run(
        p, arrays, commands, edges, starts, dt, size, drive, joints, tip, s, load, demands, servos, structure, row, scratch, at,
        nets, t,
    )  # fmt: skip
