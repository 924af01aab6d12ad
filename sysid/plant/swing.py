"""The tool below the boom tip over whole recordings, and from where its swing starts; compiled."""

from __future__ import annotations

import math

import numpy as np

from sysid.effects import gripper_sway
from sysid.effects.compiled import inlined, kernel, loop

#: The start of a swing is estimated from so many of its periods, or from this long [s] where that is longer.
PERIODS, LEAST = 2.0, 3.0
#: Runs of that stretch at most, the first ones of a single period; a correction [standard deviations of the noise] that needs
#: no other one.
ROUNDS, COARSE, EXACT = 7, 2, 0.3
#: Prior: the tool hangs still; standard deviations of its deflection [lengths], and of a constant error of tip and tool [m].
DEFLECTION, BESIDE = 0.3, 0.005
#: No deflection starts larger than this [lengths].
LARGEST = 0.9


@kernel
def swing(p, at, pivot, measured, dt, out):
    """Boom tip (n, 3) → tool (n, 3). After a gap in the tip the swing restarts from the first measured samples."""
    s, now, tried = np.empty(gripper_sway.MEMORY), np.empty(gripper_sway.MEMORY), np.empty(gripper_sway.MEMORY)
    normal = np.empty((2, 3, 4))
    columns, wide = np.empty((4, _longest(p, at, dt, len(pivot)), 2)), np.empty((7, 5))
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
            _find(p, at, pivot, measured, k, _end(p, at, pivot, k, dt), dt, s, now, tried, normal, columns, wide, out)
            _copy(s, now)
        gripper_sway.step(pivot[k, 0], pivot[k, 1], pivot[k, 2], p, at, s, 0, dt, out[k])


@kernel
def start(p, at, pivot, measured, dt, found):
    """State before the first sample into ``found`` (MEMORY,) from which the swing below ``pivot`` (n, 3) fits ``measured``."""
    s, tried = np.empty(gripper_sway.MEMORY), np.empty(gripper_sway.MEMORY)
    normal, out = np.empty((2, 3, 4)), np.empty((len(pivot), 3))
    columns, wide = np.empty((4, _longest(p, at, dt, len(pivot)), 2)), np.empty((7, 5))
    _find(p, at, pivot, measured, 0, _end(p, at, pivot, 0, dt), dt, s, found, tried, normal, columns, wide, out)


@loop
def _longest(p, at, dt, rows):
    """So many of ``rows`` samples the start is estimated from at most."""
    period = 2.0 * math.pi * math.sqrt(max(p[at], 0.0) / gripper_sway.GRAVITY)
    return min(rows, max(5, math.ceil(max(LEAST, PERIODS * period) / dt)))


@loop
def _end(p, at, pivot, first, dt):
    """Last+1 sample that the start is estimated from."""
    last, end = first, first + _longest(p, at, dt, len(pivot) - first)
    while last < end and not np.isnan(pivot[last, 0]):
        last += 1
    return last


@inlined
def _copy(into, values):
    for j in range(len(into)):
        into[j] = values[j]


@loop
def _hang(pivot, first, last, dt, state):
    """The tool hangs still below a pivot that moves as in its first samples, and has not reached the first of them yet."""
    ahead = min(first + 2, last - 1)
    for c in range(3):
        speed = (pivot[ahead, c] - pivot[first, c]) / ((ahead - first) * dt) if ahead > first else 0.0
        state[4 + c] = pivot[first, c] - speed * dt
        state[7 + c] = speed
    for c in range(2):
        state[c] = state[4 + c]
        state[2 + c] = state[7 + c]


@loop
def _find(p, at, pivot, measured, first, last, dt, s, now, tried, normal, columns, wide, out):
    """Gauss-Newton steps towards the most probable start, into ``now``; where those of a linear pendulum fail, exact ones."""
    length = p[at]
    _hang(pivot, first, last, dt, now)
    if length < 1e-3:
        return
    rate = math.sqrt(gripper_sway.GRAVITY / length)
    least = np.inf
    _copy(tried, now)
    for turn in range(ROUNDS):
        # Near enough by a period of it, then by all of it.
        end = last if turn >= COARSE else min(last, first + math.ceil(2.0 * math.pi / rate / dt))
        if turn == COARSE:
            least = np.inf
        _copy(s, tried)
        for k in range(first, end):
            gripper_sway.step(pivot[k, 0], pivot[k, 1], pivot[k, 2], p, at, s, 0, dt, out[k])
        cost, count = _normal(p, at, measured, out, first, end, dt, normal)
        if count == 0 and turn < COARSE:
            continue
        if count == 0:
            return
        if turn >= COARSE and not cost < least:
            _find_wide(p, at, pivot, measured, first, last, dt, least / count, s, now, tried, normal, columns, wide, out)
            return
        least, moved = cost, 0.0
        _copy(now, tried)
        for c in range(2):
            away, speed = now[c] - now[4 + c], now[2 + c] - now[7 + c]
            by_place, by_speed = _solved(normal[c], cost / count, away, speed, length, rate)
            tried[c] = now[4 + c] + min(max(away + by_place, -LARGEST * length), LARGEST * length)
            tried[2 + c] = now[2 + c] + by_speed
            moved = max(moved, abs(by_place), abs(by_speed) / rate)
        if turn >= COARSE and moved < EXACT * math.sqrt(cost / count):
            _copy(now, tried)
            return


@loop
def _find_wide(p, at, pivot, measured, first, last, dt, variance, s, now, tried, normal, columns, wide, out):
    """The same for a swing so wide that its period depends on its width: derivatives are differences of runs."""
    rate = math.sqrt(gripper_sway.GRAVITY / p[at])
    step, least = wide[5], np.inf
    _copy(tried, now)
    for _ in range(ROUNDS):
        _copy(s, tried)
        for k in range(first, last):
            gripper_sway.step(pivot[k, 0], pivot[k, 1], pivot[k, 2], p, at, s, 0, dt, out[k])
        cost, count = _normal(p, at, measured, out, first, last, dt, normal)
        if cost < least:
            least, variance = cost, cost / count
            _copy(now, tried)
            _differences(p, at, pivot, first, last, dt, s, now, out, wide[6], columns)
            _wide_step(p[at], rate, measured, out, first, last, variance, now, columns, wide)
        else:
            for j in range(4):
                step[j] *= 0.5
        moved = 0.0
        for j in range(4):
            tried[j] = now[j] + step[j]
            moved = max(moved, abs(step[j]) / (1.0 if j < 2 else rate))
        if moved < EXACT * math.sqrt(variance):
            return


@loop
def _differences(p, at, pivot, first, last, dt, s, now, out, moved, columns):
    """Derivatives of the run ``out`` by the places and speeds of ``now``, into ``columns`` (4, n, 2)."""
    for j in range(4):
        small = 1e-4 * p[at] if j < 2 else 1e-4 * math.sqrt(gripper_sway.GRAVITY * p[at])
        _copy(s, now)
        s[j] += small
        for k in range(first, last):
            gripper_sway.step(pivot[k, 0], pivot[k, 1], pivot[k, 2], p, at, s, 0, dt, moved)
            for c in range(2):
                columns[j, k - first, c] = (moved[c] - out[k, c]) / small


@loop
def _wide_step(length, rate, measured, out, first, last, variance, now, columns, wide):
    """Gauss-Newton step by ``columns`` into row 5 of ``wide``: with the prior, a constant error eliminated by direction."""
    a, means, step = wide, wide[4], wide[5]
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
        prior = DEFLECTION * length * (1.0 if j < 2 else rate)
        beside = now[j] - now[4 + j] if j < 2 else now[j] - now[5 + j]
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
def _normal(p, at, measured, out, first, last, dt, normal):
    """Normal equations (2, 3, 4) of what is left; its squares, without a constant, and how many there are.

    What is left is a constant and what a change of the start does, which dies out as a free swing:
    ``e^(−ζωt)(δx·cos ωt + (δv + ζω·δx)/ω·sin ωt)``.
    """
    rate = math.sqrt(gripper_sway.GRAVITY / p[at])
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
def _solved(a, variance, place, speed, length, rate):
    """Correction of place and speed of one direction, by its normal equations (3, 4) and the prior."""
    wide, fast = DEFLECTION * length, DEFLECTION * length * rate
    a00, a01, a02, b0 = a[0, 0] + variance / (wide * wide), a[0, 1], a[0, 2], a[0, 3] - variance * place / (wide * wide)
    a11, a12, b1 = a[1, 1] + variance / (fast * fast), a[1, 2], a[1, 3] - variance * speed / (fast * fast)
    a22, b2 = a[2, 2] + variance / (BESIDE * BESIDE), a[2, 3]
    if not a22 > 0.0:
        return 0.0, 0.0
    # Without the constant: what it takes from the others.
    a00 -= a02 * a02 / a22
    a01 -= a02 * a12 / a22
    a11 -= a12 * a12 / a22
    b0 -= a02 * b2 / a22
    b1 -= a12 * b2 / a22
    bottom = a00 * a11 - a01 * a01
    if not bottom > 1e-9 * a00 * a11:
        return 0.0, 0.0
    return (b0 * a11 - b1 * a01) / bottom, (a00 * b1 - a01 * b0) / bottom
