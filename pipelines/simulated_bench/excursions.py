"""Setpoints of a position controller: random moves and rests, some small, some as steps."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def draw_path(limits: tuple[float, float], ticks: int, cycle: float, rng: np.random.Generator) -> Array:
    """Targets inside ``limits`` for every one of ``ticks`` cycles of ``cycle`` [s], (ticks,)."""
    low, high = limits[0] + 0.1 * (limits[1] - limits[0]), limits[1] - 0.1 * (limits[1] - limits[0])
    out = np.empty(ticks)
    position = 0.5 * (low + high)
    k = min(round(1.0 / cycle), ticks)
    out[:k] = position
    while k < ticks:
        small = rng.random() < 0.4
        target = float(np.clip(position + rng.normal(0.0, 0.04), low, high)) if small else float(rng.uniform(low, high))
        length = 1 if rng.random() < 0.25 else round(rng.uniform(0.4, 2.0) / cycle)
        rest = round(rng.uniform(0.2, 1.0) / cycle)
        shape = 0.5 - 0.5 * np.cos(np.pi * np.minimum(np.arange(1, length + rest + 1) / length, 1.0))
        part = (position + (target - position) * shape)[: ticks - k]
        out[k : k + len(part)] = part
        position = target
        k += len(part)
    return out
