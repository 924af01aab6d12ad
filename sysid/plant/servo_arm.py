"""All servo axes of a machine at once, compiled: their controllers and friction on the coupled dynamics of the links.

``M(q)·q̈ + c(q, q̇) + g(q) = force − friction`` by the step of :mod:`sysid.plant.servo_law`, in which the forces of the
controllers are implicit and those of speeds and gravity are taken at the extrapolated middle of the step. Dry friction of all
joints is solved together: by an active set, of the joints that slide and those that friction holds, else by projected
Gauss-Seidel sweeps. A motor that crosses the backlash of its joint moves by itself, and nothing but its links moves that joint.

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 6; Mirtich and Canny, Symposium on Interactive 3D Graphics
(1995), on friction by impulses; Cottle, Pang, Stone, The Linear Complementarity Problem (1992), §5.2 (Gauss-Seidel).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sysid.effects import input_delay
from sysid.effects.compiled import inlined, kernel, loop
from sysid.machine.moved_bodies import PARAMETERS
from sysid.plant import chain, servo_axis, servo_law
from sysid.plant.arm_dynamics import BODY, dynamics, true_bodies
from sysid.plant.layout import AT, AXIS_WIDTH, STATE
from sysid.plant.machine_arrays import GIVE, IMPLICIT, KIND, LEAD, SERVO, MachineArrays

#: Longest step of a moving arm [s]: its posture counts as that of the middle of a step.
LONGEST = 0.002
#: Sweeps of the solution for dry friction, and the change of a speed, as a share of the largest, at which they end.
SWEEPS, SETTLED = 200, 1e-9
#: Resistance that holds a joint at rest, as a multiple of its own.
HELD = 1e12
#: Corrections for controllers that reach their force limits, and for the friction of the mean speed; the same for backlash.
PASSES = 4
#: A joint is on a flank of its backlash within this share of it.
ON_FLANK = 1e-9

# Rows of ``work`` after the mass matrix, the matrix of the step and its factor, each (A, A).
(
    _BIAS, _PLACE, _MIDDLE, _RATE, _KP, _KV, _LOWEST, _HIGHEST, _ARMATURE, _LATER, _EARLIER, _PART, _PUSH, _FREE, _AFTER, _MEAN,
    _SIDE, _THETA, _BRAKE, _SPEED, _OWN, _SLIP, _GRIP, _CREEP, _BEGIN, _JOINT, _SWING, _LOOSE, _OFFSET, _CROSSED, _WANTED,
    _UNDAMPED, _ROWS,
) = range(33)  # fmt: skip


class Workspace(NamedTuple):
    """Arrays that :func:`advance` uses inside."""

    work: npt.NDArray[np.float64]
    kept: npt.NDArray[np.float64]


def workspace(arrays: MachineArrays) -> Workspace | None:
    """The arrays for a machine of servos; None for another, whose runs are compiled without :func:`advance`."""
    axes, joints = len(arrays.axes), len(arrays.bodies)
    if arrays.axes[0, KIND] != SERVO:  # then none is
        return None
    return Workspace(np.empty((3 * axes + _ROWS, axes)), np.empty((joints, BODY + PARAMETERS)))


@loop
def advance(p, arrays, s, command, dt, servos, watched):
    """One step of all axes under the ``command`` (A,) held over it; nothing moves while an axis has no position.

    Args:
        s: state (A · size,); the arrays ``servos`` of a :class:`Workspace` are used inside.
        watched: as in :func:`_solve`.
    """
    axes, work = len(arrays.axes), servos.work
    size = len(s) // axes
    mass, at = work[:axes], work[3 * axes :]
    kept, bodies = servos.kept[:, :BODY], servos.kept[:, BODY:]
    for i in range(axes):
        if np.isnan(s[i * size + STATE.position]):
            return
    for i in range(axes):
        b, m = i * AXIS_WIDTH, i * size
        at[_KP, i], at[_KV, i], at[_LOWEST, i], at[_HIGHEST, i], at[_ARMATURE, i] = chain.servo_law(p, arrays.axes, i)
        at[_LATER, i], at[_EARLIER, i], at[_PART, i] = input_delay.ends(
            command[i], p, b + AT.input_delay, s, m + STATE.input_delay, size - STATE.input_delay, dt
        )
        (at[_PLACE, i], at[_SWING, i]), at[_RATE, i] = chain.servo_motion(p, b, s, m), 0.0
    true_bodies(p, arrays.links, arrays.bodies, bodies)
    dynamics(at[_PLACE], at[_SWING], arrays.links, bodies, kept, mass, at[_BIAS])
    count, own = math.ceil(dt / LONGEST - 1e-9), servo_law.own_steps(arrays.axes[0, LEAD], dt)
    for i in range(axes):
        b, m = i * AXIS_WIDTH, i * size
        chain.rest_on_flank(at[_BIAS, i], p, b, s, m)
        viscous, gradual = chain.servo_friction(s[m + STATE.speed], p, b)
        moving = at[_ARMATURE, i] + (0.0 if chain.has_backlash(p, b) else mass[i, i])
        count = max(count, servo_law.substeps(at[_KP, i], at[_KV, i] + viscous + gradual, moving, dt))
        if arrays.axes[i, LEAD] != arrays.axes[0, LEAD]:
            own = 0
    half = 0.5
    if own > 0:
        count, half = own, 0.0
    h = dt / count
    for k in range(count):
        for i in range(axes):
            b, m, lead = i * AXIS_WIDTH, i * size, arrays.axes[i, LEAD] if own > 0 else 0.0
            at[_SPEED, i] = s[m + STATE.speed]
            at[_BEGIN, i] = s[m + STATE.position] + lead * at[_SPEED, i]
            at[_WANTED, i] = chain.servo_setpoint(
                at[_EARLIER, i], at[_LATER, i], at[_PART, i], k, count, p, b, s, m, h, own > 0
            )
            place, at[_SWING, i] = chain.servo_motion(p, b, s, m)
            at[_JOINT, i] = place + lead * at[_SWING, i]
            at[_PLACE, i] = at[_JOINT, i] + half * h * at[_SWING, i]
            at[_MIDDLE, i] = at[_SWING, i] + half * h * at[_RATE, i]
            at[_OFFSET, i] = at[_JOINT, i] - at[_BEGIN, i]
            at[_LOOSE, i] = abs(at[_OFFSET, i]) < 0.5 * (1.0 - ON_FLANK) * p[b + AT.backlash_drive]
        dynamics(at[_PLACE], at[_MIDDLE], arrays.links, bodies, kept, mass, at[_BIAS])
        for i in range(axes):
            mass[i, i] += at[_ARMATURE, i]
        for _ in range(PASSES):
            for i in range(axes):
                at[_SIDE, i] = 0.0
                at[_MEAN, i] = at[_SPEED, i]
            _solve(p, arrays.axes, h, own > 0, watched, work)
            if not _changes_flank(p, arrays.axes, h, own > 0, work):
                break
        for i in range(axes):
            m, lead, j = i * size, arrays.axes[i, LEAD] if own > 0 else 0.0, i * size + STATE.backlash_drive
            ahead, fast = at[_BEGIN, i] + h * at[_MEAN, i], at[_AFTER, i]
            at[_RATE, i] = (fast - at[_SWING, i]) / h
            if at[_LOOSE, i] != 0.0:
                s[j], s[j + 1] = at[_JOINT, i] + h * at[_MEAN, i] - lead * fast, fast
                ahead, fast = at[_CROSSED, i], at[_PUSH, i]
            elif chain.has_backlash(p, i * AXIS_WIDTH):
                s[j], s[j + 1] = ahead + at[_OFFSET, i] - lead * fast, fast
            s[m + STATE.position], s[m + STATE.speed] = ahead - lead * fast, fast
            chain.stop(s, m, arrays.axes, i)
            if s[m + STATE.speed] != fast:
                at[_RATE, i] = (s[m + STATE.speed] - at[_SWING, i]) / h


@inlined
def _changes_flank(p, about, h, own, work):
    """Whether a joint leaves or reaches a flank of its backlash in the step, against what :func:`_solve` took it for.

    Places and speeds after the step of motors that cross their backlash are left in the rows ``_CROSSED`` and ``_PUSH``.
    """
    axes, found = work.shape[1], False
    mass, at = work[:axes], work[3 * axes :]
    for i in range(axes):
        half = 0.5 * p[i * AXIS_WIDTH + AT.backlash_drive]
        if half == 0.0:
            continue
        if at[_LOOSE, i] != 0.0:
            rotor = servo_law.rotor_alone(at[_ARMATURE, i], at[_KP, i], h)
            at[_CROSSED, i], at[_PUSH, i] = servo_axis.step(
                at[_BEGIN, i], at[_SPEED, i], at[_SPEED, i], at[_WANTED, i], rotor, 0.0, 0.0, 0.0, 0.0, at[_KP, i],
                at[_KV, i], at[_LOWEST, i], at[_HIGHEST, i], h, p, about, i, own,
            )  # fmt: skip
            offset = at[_JOINT, i] + h * at[_MEAN, i] - at[_CROSSED, i]
            if abs(offset) > half:
                at[_LOOSE, i], at[_OFFSET, i], found = 0.0, math.copysign(half, offset), True
        else:
            force = at[_BIAS, i] - at[_ARMATURE, i] * (at[_AFTER, i] - at[_SWING, i]) / h
            for j in range(axes):
                force += mass[i, j] * (at[_AFTER, j] - at[_SWING, j]) / h
            if force * at[_OFFSET, i] > 0.0:
                at[_LOOSE, i], found = 1.0, True
    return found


@inlined
def _solve(p, about, h, own, watched, work):
    """Speeds after a step, and their means over it; ``own``: whether it is one of the described simulator.

    ``watched``: leave the speeds without implicit damping in the row ``_UNDAMPED``, where friction gives way as in MuJoCo.
    """
    axes = work.shape[1]
    mass, matrix, factor, at = work[:axes], work[axes : 2 * axes], work[2 * axes : 3 * axes], work[3 * axes :]
    for turn in range(PASSES):
        settled = True
        for i in range(axes):
            b, w = i * AXIS_WIDTH, at[_MEAN, i]
            if at[_LOOSE, i] != 0.0:
                at[_OWN, i] = mass[i, i] - at[_ARMATURE, i]
                at[_PUSH, i], at[_BRAKE, i], at[_THETA, i], at[_CREEP, i] = -at[_BIAS, i], 0.0, 1.0 if own else 0.5, 0.0
                if at[_OWN, i] <= 0.0:  # a joint without masses rests
                    at[_OWN, i], at[_SWING, i] = 1.0, 0.0
                continue
            viscous, gradual = chain.servo_friction(w, p, b)
            damping, kv, stiffness, push = viscous + gradual, 0.0, 0.0, -at[_BIAS, i]
            if at[_SIDE, i] == 0.0:
                kv, stiffness = at[_KV, i], at[_KP, i]
                push += at[_KP, i] * (at[_WANTED, i] - at[_BEGIN, i])
                if own and about[i, IMPLICIT] < 0.0:
                    push -= kv * at[_SPEED, i]
                else:
                    damping += kv
            else:
                push += at[_HIGHEST, i] if at[_SIDE, i] > 0.0 else at[_LOWEST, i]
            at[_PUSH, i] = push
            if own:
                at[_OWN, i], at[_THETA, i], at[_CREEP, i], at[_BRAKE, i] = mass[i, i], 1.0, 0.0, damping
                continue
            at[_OWN, i] = chain.rotor(mass[i, i], kv, viscous, about, i)
            at[_THETA, i] = at[_CREEP, i] = servo_law.weight(h * damping / at[_OWN, i])
            at[_BRAKE, i] = damping + 0.5 * h * stiffness
        rubs = False
        for i in range(axes):
            free = at[_PUSH, i] - (1.0 - at[_THETA, i]) * at[_BRAKE, i] * at[_SPEED, i]
            for j in range(axes):
                matrix[i, j] = (at[_OWN, i] if j == i else mass[i, j]) / h
                free += matrix[i, j] * at[_SWING, j]
            if at[_LOOSE, i] == 0.0:
                links = mass[i, i] - at[_ARMATURE, i]
                free += (at[_OWN, i] - links) / h * (at[_SPEED, i] - at[_SWING, i])
            matrix[i, i] += at[_THETA, i] * at[_BRAKE, i]
            at[_FREE, i] = free
            at[_AFTER, i] = free
            rubs |= _dry(free, at[_SPEED, i], p, i, at) > 0.0
        gives = own
        for i in range(axes):
            gives &= about[i, GIVE] > 0.0
        apart = gives and (rubs or watched)
        if apart:  # the friction is that of the motion without implicit damping
            for i in range(axes):
                matrix[i, i] -= at[_BRAKE, i]
                at[_FREE, i] -= at[_BRAKE, i] * at[_SPEED, i]
                at[_AFTER, i] = at[_FREE, i]
        if rubs:
            if not _slide_or_hold(p, about, h, own, matrix, factor, at):
                _rub(p, about, h, own, matrix, at)
        elif apart:
            at[_GRIP, :] = 0.0
            _divide(matrix, factor, at[_GRIP], at[_AFTER])
        if apart:
            for i in range(axes):
                at[_UNDAMPED, i] = at[_AFTER, i]
            for i in range(axes):
                at[_FREE, i] = at[_BRAKE, i] * at[_SPEED, i]
                for j in range(axes):
                    at[_FREE, i] += matrix[i, j] * at[_AFTER, j]
            for i in range(axes):
                matrix[i, i] += at[_BRAKE, i]
                at[_AFTER, i] = at[_FREE, i]
        if apart or not rubs:
            at[_GRIP, :] = 0.0
            _divide(matrix, factor, at[_GRIP], at[_AFTER])
        for i in range(axes):
            if at[_LOOSE, i] != 0.0:
                at[_MEAN, i] = (1.0 - at[_THETA, i]) * at[_SWING, i] + at[_THETA, i] * at[_AFTER, i]
                continue
            w = (1.0 - at[_THETA, i]) * at[_SPEED, i] + at[_THETA, i] * at[_AFTER, i]
            if turn == 0 and chain.friction_changes(at[_MEAN, i], w, p, i * AXIS_WIDTH):
                settled = False
            at[_MEAN, i] = w
            if at[_SIDE, i] == 0.0:
                force = at[_KP, i] * (at[_WANTED, i] - at[_BEGIN, i]) - at[_KV, i] * at[_SPEED, i]
                if not own:
                    force += at[_KV, i] * (at[_SPEED, i] - w) - 0.5 * at[_KP, i] * h * w
                if force > at[_HIGHEST, i] or force < at[_LOWEST, i]:
                    at[_SIDE, i] = math.copysign(1.0, force)
                    settled = False
        if settled:
            break


@inlined
def _dry(moved, v, p, i, at):
    """Dry friction of an axis, which its motor alone has."""
    return chain.dry(moved, v, p, i * AXIS_WIDTH) if at[_LOOSE, i] == 0.0 else 0.0


@inlined
def _divide(matrix, factor, more, x):
    """Solve ``(matrix + diag(more)) · x = x`` in place by the Cholesky factor."""
    axes = len(x)
    for i in range(axes):
        for j in range(i + 1):
            total = matrix[i, j] + more[i] if i == j else matrix[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            factor[i, j] = math.sqrt(total) if i == j else total / factor[j, j]
        total = x[i]
        for k in range(i):
            total -= factor[i, k] * x[k]
        x[i] = total / factor[i, i]
    for i in range(axes - 1, -1, -1):
        total = x[i]
        for k in range(i + 1, axes):
            total -= factor[k, i] * x[k]
        x[i] = total / factor[i, i]


@inlined
def _slide_or_hold(p, about, h, own, matrix, factor, at):
    """:func:`_rub` by an active set, from the joints that slide before the step; False where it finds none."""
    axes = matrix.shape[0]
    for i in range(axes):
        at[_SLIP, i] = 0.0 if at[_SPEED, i] == 0.0 else math.copysign(1.0, at[_SPEED, i])
    for _ in range(2 * axes):
        for i in range(axes):
            v, give = at[_SPEED, i], about[i, GIVE]
            ahead = chain.give_time(about, i, own) / h
            at[_AFTER, i] = at[_FREE, i] - at[_SLIP, i] * _dry(at[_SLIP, i], v, p, i, at)
            at[_GRIP, i] = 0.0
            if at[_SLIP, i] == 0.0 and _dry(1.0, v, p, i, at) + _dry(-1.0, v, p, i, at) > 0.0:
                if give == 0.0:
                    at[_AFTER, i] = 0.0
                    at[_GRIP, i] = HELD * matrix[i, i]
                else:
                    at[_AFTER, i] -= (1.0 - at[_CREEP, i] - ahead) * v / give
                    at[_GRIP, i] = (at[_CREEP, i] + ahead) / give
        _divide(matrix, factor, at[_GRIP], at[_AFTER])
        found = True
        for i in range(axes):
            v, give, slips = at[_SPEED, i], about[i, GIVE], at[_SLIP, i]
            if give == 0.0:
                if slips != 0.0:
                    if slips * at[_AFTER, i] < 0.0:
                        at[_SLIP, i], found = 0.0, False
                    continue
                if at[_GRIP, i] == 0.0:  # no dry friction
                    continue
                at[_AFTER, i] = 0.0
                friction = at[_FREE, i]
                for j in range(axes):
                    friction -= matrix[i, j] * at[_AFTER, j]
            else:
                mean = (1.0 - at[_CREEP, i]) * v + at[_CREEP, i] * at[_AFTER, i]
                friction = (mean + chain.give_time(about, i, own) / h * (at[_AFTER, i] - v)) / give
            dry = _dry(friction, v, p, i, at)
            if dry == 0.0:
                continue
            if slips == 0.0 and abs(friction) > dry:
                at[_SLIP, i], found = math.copysign(1.0, friction), False
            elif slips != 0.0 and friction * slips < dry:
                at[_SLIP, i], found = 0.0, False
        if found:
            return True
    return False


@inlined
def _rub(p, about, h, own, matrix, at):
    """Speeds behind dry friction: ``matrix · after + friction = free``, friction against the speed or holding it at zero."""
    axes = matrix.shape[0]
    for i in range(axes):
        at[_AFTER, i] = at[_SPEED, i]
    for _ in range(SWEEPS):
        moved, largest = 0.0, 0.0
        for i in range(axes):
            free = at[_FREE, i]
            for j in range(axes):
                if j != i:
                    free -= matrix[i, j] * at[_AFTER, j]
            v, dry = at[_SPEED, i], _dry(free, at[_SPEED, i], p, i, at)
            time = chain.give_time(about, i, own)
            after = servo_law.rub(free, matrix[i, i], v, at[_CREEP, i], h, dry, about[i, GIVE], time)
            moved = max(moved, abs(after - at[_AFTER, i]))
            largest = max(largest, abs(after))
            at[_AFTER, i] = after
        if moved <= SETTLED * largest:
            break


@kernel
def run_servos(p, arrays, commands, s, dt, places, speeds, undamped, servos):
    """Motion of servo axes from the state ``s`` (A · size,) under ``commands`` (n, A), each held until the next.

    Args:
        places, speeds: out, (n, A).
        undamped: out, (n, A): torque more that the other joints exert on each without implicit damping, in one step of the
            described simulator [N·m or N].
        servos: a :class:`Workspace`.
    """
    axes, work = commands.shape[1], servos.work
    size = len(s) // axes
    for k in range(len(commands)):
        for i in range(axes):
            places[k, i], speeds[k, i] = chain.servo_motion(p, i * AXIS_WIDTH, s, i * size)
        work[3 * axes + _UNDAMPED, :] = np.nan
        advance(p, arrays, s, commands[k], dt, servos, True)
        for i in range(axes):
            undamped[k, i] = 0.0
            for j in range(axes):
                if j != i and not np.isnan(work[3 * axes + _UNDAMPED, j]):
                    undamped[k, i] += work[i, j] * (work[3 * axes + _UNDAMPED, j] - work[3 * axes + _AFTER, j]) / dt
