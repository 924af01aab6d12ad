"""The tool below the boom tip over whole recordings, and from where its swing starts; compiled."""

from __future__ import annotations

import math

import numpy as np

from sysid.effects import gripper_sway
from sysid.effects.compiled import inlined, kernel


@kernel
def swing(p, at, pivot, measured, window, dt, out):
    """Boom tip (n, 3) → tool (n, 3). After a gap in the tip the swing restarts from the first measured samples."""
    s = np.empty(gripper_sway.MEMORY)
    start = np.empty(4)
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
            last = k
            while last < min(k + window, len(pivot)) and not np.isnan(pivot[last, 0]):
                last += 1
            find_swing(p, at, pivot[k:last], measured[k:last], dt, start, out[k:last])
            _begin(s, start)
        gripper_sway.step(pivot[k, 0], pivot[k, 1], pivot[k, 2], p, at, s, 0, dt, out[k])


@kernel
def find_swing(p, at, pivot, measured, dt, start, out):
    """Place and speed (4,) into ``start`` from which the swing fits ``measured`` (n, 3); ``out`` (n, 3) is used."""
    s = np.empty(gripper_sway.MEMORY)
    start[0] = pivot[0, 0]
    start[1] = pivot[0, 1]
    start[2] = 0.0
    start[3] = 0.0
    for _ in range(3):
        _begin(s, start)
        for i in range(len(pivot)):
            gripper_sway.step(pivot[i, 0], pivot[i, 1], pivot[i, 2], p, at, s, 0, dt, out[i])
        _correct(p, at, measured, out, dt, start)


@inlined
def _begin(s, start):
    """State of the swing with the bob at ``start[:2]`` moving at ``start[2:]``; the pivot begins where it is first seen."""
    for i in range(len(s)):
        s[i] = np.nan
    for i in range(4):
        s[i] = start[i]


@inlined
def _correct(p, at, measured, out, dt, start):
    """Least-squares correction of place and speed of the bob from what is left over the first samples.

    A change of the start dies out as a free swing: ``e^(−ζωt)(δx·cos ωt + (δv + ζω·δx)/ω·sin ωt)``.
    """
    length = p[at]
    if length < 1e-3:
        return
    rate = math.sqrt(gripper_sway.GRAVITY / length)
    fade = p[at + 1] * rate
    for c in range(2):
        a11 = a12 = a22 = b1 = b2 = 0.0
        for k in range(len(out)):
            if np.isnan(measured[k, c]):
                continue
            t = k * dt
            decay = math.exp(-fade * t)
            by_speed = decay * math.sin(rate * t) / rate
            by_place = decay * math.cos(rate * t) + fade * by_speed
            left = measured[k, c] - out[k, c]
            a11 += by_place * by_place
            a12 += by_place * by_speed
            a22 += by_speed * by_speed
            b1 += by_place * left
            b2 += by_speed * left
        bottom = a11 * a22 - a12 * a12
        if bottom > 1e-9 * a11 * a22:
            start[c] += (b1 * a22 - b2 * a12) / bottom
            start[2 + c] += (a11 * b2 - a12 * b1) / bottom
