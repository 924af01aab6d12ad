"""The tool below the end effector over whole recordings, and the start state of its swing; compiled."""

from __future__ import annotations

import math

import numpy as np

from sysid.effects import gripper_sway
from sysid.effects.compiled import inlined, kernel, loop
from sysid.machine.kinematics import GRAVITY

#: The start of a swing is estimated from this number of periods, or from this time [s] where that is longer.
PERIODS, MIN_SECONDS = 2.0, 3.0
#: Most runs of that stretch, the first ones of a single period; a correction [standard deviations of the noise] that ends the
#: iteration.
ROUNDS, COARSE, TOLERANCE = 7, 2, 0.3
#: Prior: the tool is at rest; standard deviations of its deflection [lengths], and of a constant error of tip and tool [m].
DEFLECTION_SD, OFFSET_SD = 0.3, 0.005
#: Largest deflection at the start [lengths].
LARGEST = 0.9


@kernel
def swing(p, at, pivot, measured, dt, out):
    """End effector (n, 3) → tool (n, 3). After a gap in the end effector the swing starts again from the measured tool."""
    s, best, trial = np.empty(gripper_sway.MEMORY), np.empty(gripper_sway.MEMORY), np.empty(gripper_sway.MEMORY)
    normal = np.empty((2, 3, 4))
    columns, work = np.empty((4, _most_samples(p, at, dt, len(pivot)), 2)), np.empty((7, 5))
    begun = False
    for k in range(len(pivot)):
        if np.isnan(pivot[k, 0]):
            out[k, 0] = np.nan
            out[k, 1] = np.nan
            out[k, 2] = np.nan
            begun = False
            continue
        if not begun:
            begun = True
            _find_start(
                p, at, pivot, measured, k, _last_sample(p, at, pivot, k, dt), dt, s, best, trial, normal, columns, work, out
            )
            _copy(s, best)
        gripper_sway.step(pivot[k, 0], pivot[k, 1], pivot[k, 2], p, at, s, 0, dt, out[k])


@kernel
def start(p, at, pivot, measured, dt, found):
    """State ``found`` (MEMORY,) before the first sample with which the swing below ``pivot`` (n, 3) fits ``measured`` best."""
    s, trial = np.empty(gripper_sway.MEMORY), np.empty(gripper_sway.MEMORY)
    normal, out = np.empty((2, 3, 4)), np.empty((len(pivot), 3))
    columns, work = np.empty((4, _most_samples(p, at, dt, len(pivot)), 2)), np.empty((7, 5))
    _find_start(p, at, pivot, measured, 0, _last_sample(p, at, pivot, 0, dt), dt, s, found, trial, normal, columns, work, out)


@loop
def _most_samples(p, at, dt, rows):
    """Most samples, of ``rows``, from which the start is estimated."""
    period = 2.0 * math.pi * math.sqrt(max(p[at], 0.0) / GRAVITY)
    return min(rows, max(5, math.ceil(max(MIN_SECONDS, PERIODS * period) / dt)))


@loop
def _last_sample(p, at, pivot, first, dt):
    """Last+1 sample from which the start is estimated."""
    last, end = first, first + _most_samples(p, at, dt, len(pivot) - first)
    while last < end and not np.isnan(pivot[last, 0]):
        last += 1
    return last


@inlined
def _copy(into, values):
    for j in range(len(into)):
        into[j] = values[j]


@loop
def _rest_state(pivot, first, last, dt, state):
    """State of a tool at rest below a pivot that moves as in its first samples, one step before the first of them."""
    ahead = min(first + 2, last - 1)
    for c in range(3):
        speed = (pivot[ahead, c] - pivot[first, c]) / ((ahead - first) * dt) if ahead > first else 0.0
        state[4 + c] = pivot[first, c] - speed * dt
        state[7 + c] = speed
    for c in range(2):
        state[c] = state[4 + c]
        state[2 + c] = state[7 + c]


@loop
def _find_start(p, at, pivot, measured, first, last, dt, s, best, trial, normal, columns, work, out):
    """Most probable start, into ``best``, by Gauss-Newton with the derivatives of a linear pendulum, else numerical ones."""
    length = p[at]
    _rest_state(pivot, first, last, dt, best)
    if length < 1e-3:
        return
    rate = math.sqrt(GRAVITY / length)
    lowest = np.inf
    _copy(trial, best)
    for iteration in range(ROUNDS):
        # First one period, then the whole stretch.
        end = last if iteration >= COARSE else min(last, first + math.ceil(2.0 * math.pi / rate / dt))
        if iteration == COARSE:
            lowest = np.inf
        _copy(s, trial)
        for k in range(first, end):
            gripper_sway.step(pivot[k, 0], pivot[k, 1], pivot[k, 2], p, at, s, 0, dt, out[k])
        cost, count = _normal_equations(p, at, measured, out, first, end, dt, normal)
        if count == 0 and iteration < COARSE:
            continue
        if count == 0:
            return
        if iteration >= COARSE and not cost < lowest:
            _find_start_numerically(
                p, at, pivot, measured, first, last, dt, lowest / count, s, best, trial, normal, columns, work, out
            )
            return
        lowest, moved = cost, 0.0
        _copy(best, trial)
        for c in range(2):
            away, speed = best[c] - best[4 + c], best[2 + c] - best[7 + c]
            by_place, by_speed = _solve_direction(normal[c], cost / count, away, speed, length, rate)
            trial[c] = best[4 + c] + min(max(away + by_place, -LARGEST * length), LARGEST * length)
            trial[2 + c] = best[2 + c] + by_speed
            moved = max(moved, abs(by_place), abs(by_speed) / rate)
        if iteration >= COARSE and moved < TOLERANCE * math.sqrt(cost / count):
            _copy(best, trial)
            return


@loop
def _find_start_numerically(p, at, pivot, measured, first, last, dt, variance, s, best, trial, normal, columns, work, out):
    """The same for a swing so large that its period depends on its amplitude: derivatives are differences of runs."""
    rate = math.sqrt(GRAVITY / p[at])
    step, lowest = work[5], np.inf
    _copy(trial, best)
    for _ in range(ROUNDS):
        _copy(s, trial)
        for k in range(first, last):
            gripper_sway.step(pivot[k, 0], pivot[k, 1], pivot[k, 2], p, at, s, 0, dt, out[k])
        cost, count = _normal_equations(p, at, measured, out, first, last, dt, normal)
        if cost < lowest:
            lowest, variance = cost, cost / count
            _copy(best, trial)
            _differences(p, at, pivot, first, last, dt, s, best, out, work[6], columns)
            _numerical_step(p[at], rate, measured, out, first, last, variance, best, columns, work)
        else:
            for j in range(4):
                step[j] *= 0.5
        moved = 0.0
        for j in range(4):
            trial[j] = best[j] + step[j]
            moved = max(moved, abs(step[j]) / (1.0 if j < 2 else rate))
        if moved < TOLERANCE * math.sqrt(variance):
            return


@loop
def _differences(p, at, pivot, first, last, dt, s, best, out, moved, columns):
    """Derivatives of the run ``out`` by the places and speeds of ``best``, into ``columns`` (4, n, 2)."""
    for j in range(4):
        small = 1e-4 * p[at] if j < 2 else 1e-4 * math.sqrt(GRAVITY * p[at])
        _copy(s, best)
        s[j] += small
        for k in range(first, last):
            gripper_sway.step(pivot[k, 0], pivot[k, 1], pivot[k, 2], p, at, s, 0, dt, moved)
            for c in range(2):
                columns[j, k - first, c] = (moved[c] - out[k, c]) / small


@loop
def _numerical_step(length, rate, measured, out, first, last, variance, best, columns, work):
    """Gauss-Newton step by ``columns`` into row 5 of ``work``: with the prior, a constant error eliminated by direction."""
    a, means, step = work, work[4], work[5]
    for i in range(4):
        for j in range(5):
            a[i, j] = 0.0
    for c in range(2):
        count = 0
        for j in range(5):
            means[j] = 0.0
        for k in range(last - first):
            left = measured[first + k, c] - out[first + k, c]
            if not np.isnan(left):
                for i in range(4):
                    means[i] += columns[i, k, c]
                    for j in range(4):
                        a[i, j] += columns[i, k, c] * columns[j, k, c]
                    a[i, 4] += columns[i, k, c] * left
                means[4] += left
                count += 1
        for i in range(4):
            for j in range(5):
                a[i, j] -= means[i] * means[j] / max(count, 1)
    for j in range(4):
        prior = DEFLECTION_SD * length * (1.0 if j < 2 else rate)
        beside = best[j] - best[4 + j] if j < 2 else best[j] - best[5 + j]
        a[j, j] += variance / (prior * prior)
        a[j, 4] -= variance * beside / (prior * prior)
    for i in range(4):  # positive definite: no pivots are needed
        for r in range(i + 1, 4):
            factor = a[r, i] / a[i, i]
            for j in range(i, 5):
                a[r, j] -= factor * a[i, j]
    for i in range(3, -1, -1):
        step[i] = a[i, 4]
        for j in range(i + 1, 4):
            step[i] -= a[i, j] * step[j]
        step[i] /= a[i, i]


@loop
def _normal_equations(p, at, measured, out, first, last, dt, normal):
    """Normal equations (2, 3, 4) of the residuals; returns their sum of squares about the mean, and their number.

    The residuals are a constant and the response to a change of the start, which decays as a free swing:
    ``e^(−ζωt)(δx·cos ωt + (δv + ζω·δx)/ω·sin ωt)``.
    """
    rate = math.sqrt(GRAVITY / p[at])
    fade = p[at + 1] * rate
    # One step of the decaying rotation (e^(−ζωt)·cos ωt, e^(−ζωt)·sin ωt).
    turn_c, turn_s = math.exp(-fade * dt) * math.cos(rate * dt), math.exp(-fade * dt) * math.sin(rate * dt)
    cost, total = 0.0, 0
    for c in range(2):
        cosine, sine, squares, count = 1.0, 0.0, 0.0, 0
        a = normal[c]
        for row in range(3):
            for column in range(4):
                a[row, column] = 0.0
        for k in range(first, last):
            left = measured[k, c] - out[k, c]
            if not np.isnan(left):
                by_speed = sine / rate
                by_place = cosine + fade * by_speed
                a[0, 0] += by_place * by_place
                a[0, 1] += by_place * by_speed
                a[1, 1] += by_speed * by_speed
                a[0, 2] += by_place
                a[1, 2] += by_speed
                a[0, 3] += by_place * left
                a[1, 3] += by_speed * left
                a[2, 3] += left
                squares += left * left
                count += 1
            cosine, sine = cosine * turn_c - sine * turn_s, sine * turn_c + cosine * turn_s
        a[2, 2] = count
        if count:
            squares -= a[2, 3] * a[2, 3] / count
        cost += squares
        total += count
    return cost, total


@loop
def _solve_direction(a, variance, place, speed, length, rate):
    """Correction of place and speed of one direction, by its normal equations (3, 4) and the prior."""
    wide, fast = DEFLECTION_SD * length, DEFLECTION_SD * length * rate
    a00, a01, a02, b0 = a[0, 0] + variance / (wide * wide), a[0, 1], a[0, 2], a[0, 3] - variance * place / (wide * wide)
    a11, a12, b1 = a[1, 1] + variance / (fast * fast), a[1, 2], a[1, 3] - variance * speed / (fast * fast)
    a22, b2 = a[2, 2] + variance / (OFFSET_SD * OFFSET_SD), a[2, 3]
    if not a22 > 0.0:
        return 0.0, 0.0
    # Eliminate the constant.
    a00 -= a02 * a02 / a22
    a01 -= a02 * a12 / a22
    a11 -= a12 * a12 / a22
    b0 -= a02 * b2 / a22
    b1 -= a12 * b2 / a22
    bottom = a00 * a11 - a01 * a01
    if not bottom > 1e-9 * a00 * a11:
        return 0.0, 0.0
    return (b0 * a11 - b1 * a01) / bottom, (a00 * b1 - a01 * b0) / bottom
