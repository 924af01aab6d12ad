"""Where a velocity axis starts: its position, and what its valve did before the first sample; compiled.

A valve that was open moves the axis during the dead time and while the lag fades, and so shifts all that follows:
``x(t) = run(t) + δx + g·δv·τ(1 − e^(−t/τ)) + Σ g·δw_j·(S(t − a_j) − S(t − b_j))``, ``S(t) = t − τ(1 − e^(−t/τ))`` for t > 0.
Position x [m or rad], opening v of the valve and openings w_j on their way through the dead time, from a_j to b_j, are
estimated together by penalised least squares (Tarantola, Inverse Problem Theory, 2005, ch. 3). The prior: openings are normal
about the first command, held, with a standard deviation of one; the position may be any.

The formula is exact for a linear valve without friction. Where more than the noise was corrected, another run checks it.
"""

from __future__ import annotations

import math

import numpy as np

from sysid.effects import command_rate_limit, input_delay
from sysid.effects.compiled import inlined, loop
from sysid.plant import chain
from sysid.plant.axis_loop import run
from sysid.plant.layout import AT, AXIS_WIDTH, STATE
from sysid.plant.level import middle_and_spread, shift
from sysid.plant.machine_arrays import CYLINDER, GAIN, HIGH, LOW

#: The position is that of so many seconds behind the transient.
LEVEL = 1.0
#: A lag has faded after so many time constants; it is waited for no longer than this [s].
FADED, LONGEST_FADE = 4.0, 2.0
#: The dead time holds openings of this length [s], longer ones where there would be more than ``PIECES``.
PIECE, PIECES = 0.05, 8
#: Samples are taken together in bins of this length [s]; later than the dead time, of this share of the time since then.
BIN, WIDER = 0.025, 0.125
#: Runs of the first seconds at most; a correction [standard deviations of the noise] that needs no other one.
ROUNDS, EXACT = 6, 0.1
#: Further away [standard deviations of the noise] than this is a spike.
SPIKE = 8.0
#: Least noise [share of the way of an open valve in a step]: the prior weighs a little where the measurement has none.
QUIET = 1e-3

UNKNOWNS = 2 + PIECES
#: Rows of the work space behind the square matrix: what is estimated, the same before the last correction, right-hand side,
#: influences, limits of the pieces.
VALUES, KEPT, RIGHT, COLUMN, EDGES, ROWS = range(UNKNOWNS, UNKNOWNS + 6)


@inlined
def _way(t, slow):
    """Integral of a valve that opens at 0 with the time constant ``slow``, S(t)."""
    if t <= 0.0:
        return 0.0
    if t > 30.0 * slow:
        return t - slow
    return t - slow * (1.0 - math.exp(-t / slow))


@inlined
def _piece(back, cells, pieces):
    """In which piece of the dead time the command lies that came ``back`` ≥ 1 steps before the first; the oldest is 0."""
    return (cells - back) * pieces // cells


@loop
def _fill(p, b, begun, dt, work, cells, pieces):
    """The estimated openings into the state ``begun``."""
    valve = work[VALUES, 1]
    begun[STATE.command_rate_limit] = valve
    begun[STATE.first_order_lag] = valve
    if cells:
        at, size = STATE.input_delay, len(begun) - STATE.input_delay
        input_delay.fill(work[VALUES, 1 + pieces], p, b + AT.input_delay, begun, at, size, dt)
        for back in range(1, cells + 1):
            input_delay.put(work[VALUES, 2 + _piece(back, cells, pieces)], begun, at, size, back)


@loop
def _edges(delay, dt, work, cells, pieces):
    """When each piece begins to act [s], and when the last one has passed."""
    for back in range(1, cells + 1):
        work[EDGES, _piece(back, cells, pieces)] = max(0.0, delay - back * dt)
    for back in range(cells, 0, -1):
        j = _piece(back, cells, pieces)
        work[EDGES, j] = min(work[EDGES, j], max(0.0, delay - back * dt))
    work[EDGES, pieces] = delay


@loop
def _influence(t, gain, slow, work, pieces):
    """How far the axis is at time t [s] if each unknown is larger by one, into the work space."""
    work[COLUMN, 0] = 1.0
    work[COLUMN, 1] = gain * (t - _way(t, slow))
    if pieces:
        after = _way(t - work[EDGES, 0], slow)
        for j in range(pieces):
            before = after
            after = _way(t - work[EDGES, j + 1], slow)
            work[COLUMN, 2 + j] = gain * (before - after)


@loop
def _compare(measured, said, first, near, dt, delay, slow, gain, middle, bound, work, count, pieces, whole):
    """Add the differences measured − said, in bins, to the right-hand side; to the matrix as well where ``whole``.

    Returns the sum of their squares about their mean.
    """
    waited, k = first + delay / dt, first
    samples, summed, squared = 0, 0.0, 0.0
    while k < near:
        end = near
        if k < waited or slow > 0.0:  # without a lag all that comes later is one bin
            end = min(near, k + max(1, round(max(BIN / dt, WIDER * (k - waited)))))
        n, total, when = 0, 0.0, 0.0
        for j in range(k, end):
            if not np.isnan(measured[j]):
                away = measured[j] - said[j]
                if abs(away - middle) <= bound:
                    n += 1
                    total += away
                    squared += (away - middle) * (away - middle)
                    when += j - first
        k = end
        if n == 0:
            continue
        samples += n
        summed += total - n * middle
        _influence(when / n * dt, gain, slow, work, pieces)
        for row in range(count):
            c = work[COLUMN, row]
            work[RIGHT, row] += c * total
            if whole and c != 0.0:
                for column in range(row + 1):
                    work[row, column] += n * c * work[COLUMN, column]
    return squared - summed * summed / max(samples, 1)


@loop
def _factor(work, count):
    """Cholesky factor of the symmetric matrix, in its place."""
    for row in range(count):
        for column in range(row + 1):
            total = work[row, column]
            for k in range(column):
                total -= work[row, k] * work[column, k]
            if column < row:
                work[row, column] = total / work[column, column]
            else:
                work[row, row] = math.sqrt(max(total, 1e-300))


@loop
def _solve(work, count):
    """Solution in the place of the right-hand side."""
    for row in range(count):
        for k in range(row):
            work[RIGHT, row] -= work[row, k] * work[RIGHT, k]
        work[RIGHT, row] /= work[row, row]
    for row in range(count - 1, -1, -1):
        for k in range(row + 1, count):
            work[RIGHT, row] -= work[k, row] * work[RIGHT, k]
        work[RIGHT, row] /= work[row, row]


@inlined
def _move_to(begun, x, low, high):
    """The axis at ``x``, its joint as far behind the drive as before."""
    x = min(max(x, low), high)
    begun[STATE.backlash_drive] += x - begun[STATE.position]
    begun[STATE.position] = x


@loop
def start_valve(p, rig, i, s, begun, command, measured, load, share, first, last, calm, dt, out, behind, scratch, work, own):
    """Correct the state ``begun`` (size,) of a velocity axis.

    Args:
        calm: samples behind the transient that the position is estimated from.
        s, out, behind, scratch, work: used inside.
    """
    b, m = i * AXIS_WIDTH, np.int64(0)
    low, high = rig.axes[i, LOW], rig.axes[i, HIGH]
    said = out if rig.axes[i, CYLINDER] != 0.0 else behind
    gain = rig.axes[i, GAIN] * p[b + AT.gain_error] * share[first]
    slow, delay = p[b + AT.first_order_lag], p[b + AT.input_delay]
    if p[b + AT.command_rate_limit] < command_rate_limit.ABSENT:
        slow += 0.5 / p[b + AT.command_rate_limit]
    cells = math.ceil(delay / dt - 1e-9)
    pieces = min(PIECES, math.ceil(delay / PIECE), cells)
    count = 1 if cells == 0 and slow < 1e-6 else 2 + pieces
    near = min(last, first + math.ceil((delay + min(FADED * slow, LONGEST_FADE)) / dt) + calm)
    work[VALUES, 0] = begun[STATE.position]
    held = 0.0
    if count > 1:
        held = chain.opening(command[first], p, b, begun, m)
        for j in range(1, count):
            work[VALUES, j] = held
        _edges(delay, dt, work, cells, pieces)
    middle, bound, noise = 0.0, 0.0, 0.0
    least, final = np.inf, count == 1
    for turn in range(ROUNDS):
        if count > 1:
            _fill(p, b, begun, dt, work, cells, pieces)
        for k in range(len(s)):
            s[k] = begun[k]
        run(p, rig, i, s, command, load, share, first, near, dt, out, behind, own)
        if turn == 0:
            middle, noise = middle_and_spread(measured, said, first, near, calm, scratch)
            if np.isnan(middle):
                return
            bound = SPIKE * noise + 2.0 * gain * (slow + delay)
            noise = max(noise, QUIET * gain * dt)
        if final or turn == ROUNDS - 1:
            _move_to(begun, begun[STATE.position] + shift(measured, said, first, near, calm, middle, bound), low, high)
            return
        for row in range(count):
            work[RIGHT, row] = noise * noise * (held - work[VALUES, row]) if row else 0.0
            for column in range(row + 1):
                if turn == 0:
                    work[row, column] = noise * noise if row == column and row else 0.0
        cost = _compare(measured, said, first, near, dt, delay, slow, gain, middle, bound, work, count, pieces, turn == 0)
        if cost > least + noise * noise:  # the valve is bent too much: back to what fitted better
            final = True
            for j in range(1, count):
                work[VALUES, j] = work[KEPT, j]
            continue
        least = min(cost, least)
        if turn == 0:
            _factor(work, count)
        _solve(work, count)
        _move_to(begun, begun[STATE.position] + work[RIGHT, 0], low, high)
        changed = 0.0
        for j in range(1, count):
            work[KEPT, j] = work[VALUES, j]
            work[VALUES, j] += work[RIGHT, j]
            changed += abs(work[RIGHT, j]) * gain * (slow if j == 1 else delay / pieces)
        middle = 0.0
        if changed <= EXACT * noise:
            break
    _fill(p, b, begun, dt, work, cells, pieces)
