"""Start state of a velocity axis: its position, and the opening of its valve before the first sample; compiled.

A valve that was open moves the axis during the dead time and while the lag decays, which shifts the whole run:
``x(t) = run(t) + δx + g·δv·τ(1 − e^(−t/τ)) + Σ g·δw_j·(S(t − a_j) − S(t − b_j))``, ``S(t) = t − τ(1 − e^(−t/τ))`` for t > 0.
Position x [m or rad], opening v of the valve and openings w_j in the dead time, from a_j to b_j, are estimated together by
penalised least squares (Tarantola, Inverse Problem Theory, 2005, ch. 3). Prior: openings are normal about the first command
with a standard deviation of one; the position is free.

The formula is exact for a linear valve without friction. A correction larger than the noise is checked by another run.
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

#: The position is estimated from this time [s] behind the transient.
LEVEL_SECONDS = 1.0
#: A lag has decayed after this number of time constants, and counts as decayed after this time [s].
FADED, LONGEST_FADE = 4.0, 2.0
#: The dead time is divided into openings of this length [s], longer ones where there would be more than ``PIECES``.
PIECE, PIECES = 0.05, 8
#: Samples are averaged in bins of this length [s]; after the dead time, of this share of the time since its end.
BIN, WIDER = 0.025, 0.125
#: Most runs of the first seconds; a correction [standard deviations of the noise] that ends the iteration.
ROUNDS, TOLERANCE = 6, 0.1
#: A correction is kept if the squares about their mean fall by this share of what the linear formula promises.
LEAST_SHARE = 0.1
#: A difference above this [standard deviations of the noise] is an outlier.
SPIKE = 8.0
#: Least noise [share of the travel of an open valve in a step], so that the prior has a weight where the measurement has none.
MIN_NOISE = 1e-3

UNKNOWNS = 2 + PIECES
#: Rows of the work space behind the square matrix: what is estimated, the same before the last correction, right-hand side,
#: influences, limits of the pieces.
VALUES, PREVIOUS, RIGHT, COLUMN, EDGES, ROWS = range(UNKNOWNS, UNKNOWNS + 6)


@inlined
def _travel(t, slow):
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
def _fill(p, b, start, dt, work, cells, pieces):
    """The estimated openings into the state ``start``."""
    valve = work[VALUES, 1]
    start[STATE.command_rate_limit] = valve
    start[STATE.first_order_lag] = valve
    if cells:
        at, size = STATE.input_delay, len(start) - STATE.input_delay
        input_delay.fill(work[VALUES, 1 + pieces], p, b + AT.input_delay, start, at, size, dt)
        for back in range(1, cells + 1):
            input_delay.put(work[VALUES, 2 + _piece(back, cells, pieces)], start, at, size, back)


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
    """Derivative of the position at time t [s] by each unknown, into the work space."""
    work[COLUMN, 0] = 1.0
    work[COLUMN, 1] = gain * (t - _travel(t, slow))
    if pieces:
        after = _travel(t - work[EDGES, 0], slow)
        for j in range(pieces):
            before = after
            after = _travel(t - work[EDGES, j + 1], slow)
            work[COLUMN, 2 + j] = gain * (before - after)


@loop
def _compare(measured, simulated, first, near, dt, delay, slow, gain, middle, bound, work, count, pieces, whole):
    """Add the differences measured − simulated, in bins, to the right-hand side; to the matrix as well where ``whole``.

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
                away = measured[j] - simulated[j]
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
def _move_to(start, x, low, high):
    """The axis at ``x``, its joint as far behind the drive as before."""
    x = min(max(x, low), high)
    start[STATE.backlash_drive] += x - start[STATE.position]
    start[STATE.position] = x


@loop
def start_valve(p, arrays, i, s, start, command, measured, load, share, first, last, calm, dt, out, behind, scratch, work, net):
    """Correct the state ``start`` (size,) of a velocity axis.

    Args:
        calm: samples behind the transient from which the position is estimated.
        s, out, behind, scratch, work: used inside.
    """
    b, m = i * AXIS_WIDTH, np.int64(0)
    low, high = arrays.axes[i, LOW], arrays.axes[i, HIGH]
    simulated = out if arrays.axes[i, CYLINDER] != 0.0 else behind
    gain = arrays.axes[i, GAIN] * p[b + AT.gain_error] * share[first]
    slow, delay = p[b + AT.first_order_lag], p[b + AT.input_delay]
    if p[b + AT.command_rate_limit] < command_rate_limit.ABSENT:
        slow += 0.5 / p[b + AT.command_rate_limit]
    cells = math.ceil(delay / dt - 1e-9)
    pieces = min(PIECES, math.ceil(delay / PIECE), cells)
    count = 1 if cells == 0 and slow < 1e-6 else 2 + pieces
    near = min(last, first + math.ceil((delay + min(FADED * slow, LONGEST_FADE)) / dt) + calm)
    work[VALUES, 0] = start[STATE.position]
    held = 0.0
    if count > 1:
        held = chain.opening(command[first], p, b, start, m)
        for j in range(1, count):
            work[VALUES, j] = held
        _edges(delay, dt, work, cells, pieces)
    middle, bound, noise = 0.0, 0.0, 0.0
    least, promised, final = np.inf, 0.0, count == 1
    for iteration in range(ROUNDS):
        if count > 1:
            _fill(p, b, start, dt, work, cells, pieces)
        for k in range(len(s)):
            s[k] = start[k]
        run(p, arrays, i, s, command, load, share, first, near, dt, out, behind, net)
        if iteration == 0:
            middle, noise = middle_and_spread(measured, simulated, first, near, calm, scratch)
            if np.isnan(middle):
                return
            bound = SPIKE * noise + 2.0 * gain * (slow + delay)
            noise = max(noise, MIN_NOISE * gain * dt)
        if final or iteration == ROUNDS - 1:
            _move_to(start, start[STATE.position] + shift(measured, simulated, first, near, calm, middle, bound), low, high)
            return
        for row in range(count):
            work[RIGHT, row] = noise * noise * (held - work[VALUES, row]) if row else 0.0
            for column in range(row + 1):
                if iteration == 0:
                    work[row, column] = noise * noise if row == column and row else 0.0
        cost = _compare(
            measured, simulated, first, near, dt, delay, slow, gain, middle, bound, work, count, pieces, iteration == 0
        )
        # The valve is too nonlinear, or the joint rests in its backlash and shows nothing of the valve: back to the fit before.
        if cost > least + noise * noise or cost > least - LEAST_SHARE * promised:
            final = True
            for j in range(1, count):
                work[VALUES, j] = work[PREVIOUS, j]
            continue
        least = min(cost, least)
        if iteration == 0:
            _factor(work, count)
        for row in range(count):
            work[COLUMN, row] = work[RIGHT, row]
        _solve(work, count)
        promised = -(work[COLUMN, 0] * work[COLUMN, 0]) / (work[0, 0] * work[0, 0])
        for row in range(count):
            promised += work[COLUMN, row] * work[RIGHT, row]
        _move_to(start, start[STATE.position] + work[RIGHT, 0], low, high)
        changed = 0.0
        for j in range(1, count):
            work[PREVIOUS, j] = work[VALUES, j]
            work[VALUES, j] += work[RIGHT, j]
            changed += abs(work[RIGHT, j]) * gain * (slow if j == 1 else delay / pieces)
        middle = 0.0
        if changed <= TOLERANCE * noise:
            break
    _fill(p, b, start, dt, work, cells, pieces)
