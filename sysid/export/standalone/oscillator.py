"""Exact steps of a damped oscillator."""

from __future__ import annotations

import math


def oscillation(omega: float, damping_ratio: float, dt: float) -> tuple[float, float, float, float]:
    """Free motion of ẍ + 2ζω·ẋ + ω²·x = 0 over ``dt`` [s], any ζ ≥ 0: (a, b, c, d) of x' = a·x + b·v, v' = c·x + d·v."""
    fade, square = damping_ratio * omega, omega**2 * (1.0 - damping_ratio**2)
    decay = math.exp(-fade * dt)
    if square * dt**2 > 1e-12:
        root = math.sqrt(square)
        sine, cosine = decay * math.sin(root * dt) / root, decay * math.cos(root * dt)
    elif square * dt**2 < -1e-12:
        root = math.sqrt(-square)
        slow, fast = math.exp((root - fade) * dt), math.exp(-(root + fade) * dt)
        sine, cosine = 0.5 * (slow - fast) / root, 0.5 * (slow + fast)
    else:
        sine, cosine = dt * decay, decay
    return cosine + fade * sine, sine, -(omega**2) * sine, cosine - fade * sine
