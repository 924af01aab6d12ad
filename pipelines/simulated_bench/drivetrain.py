"""Between a drive and the structure it moves: backlash, and an elastic joint on which the structure sags and oscillates."""

from __future__ import annotations

import math

from simulated_bench.compiled import compiled


@compiled
def follow_with_backlash(structure: float, drive: float, width: float) -> float:
    """Structure position after the drive has moved to ``drive``; ``width`` is the full backlash [m or rad]."""
    half = 0.5 * width
    if drive - structure > half:
        return drive - half
    if drive - structure < -half:
        return drive + half
    return structure


@compiled
def flex_step(
    deflection: float,
    rate: float,
    drive_jump: float,
    moment: float,
    inertia: float,
    stiffness: float,
    damping: float,
    step: float,
) -> tuple[float, float]:
    """Deflection [rad] and its rate after ``step``: ``I·(δ̈ + q̈_drive) + c·δ̇ + K·δ = −moment``, solved exactly.

    Args:
        drive_jump: change of the drive's speed over the step [rad/s].
        moment: gravity moment that pulls towards negative angles [N·m].
        damping: damping ratio, below one.
    """
    rate -= drive_jump
    rest = -moment / stiffness
    omega = math.sqrt(stiffness / inertia)
    fade = damping * omega
    swing = omega * math.sqrt(max(1.0 - damping * damping, 1e-12))
    x = deflection - rest
    decay = math.exp(-fade * step)
    c, s = math.cos(swing * step), math.sin(swing * step)
    after = decay * (x * c + (rate + fade * x) / swing * s)
    return rest + after, decay * (rate * c - (fade * rate + omega * omega * x) / swing * s)
