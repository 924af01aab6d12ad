"""Moving mass or inertia of a force axis, from force and place without a derivative of the measured place.

``force = mass · a + viscous · v + Coulomb · sign(v) + load`` times a bump ``p`` that is zero with its derivatives at both ends
of a window, integrated by parts: ``∫ p·force = mass · ∫ p̈·place − viscous · ∫ ṗ·place + Coulomb · ∫ p·sign(v) + load · ∫ p``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: Half a window, and step from one to the next [s]; half the width of the difference that gives the direction of motion [s].
HALF_S, STEP_S, BESIDE_S = 0.3, 0.1, 0.05
#: Speed below which the friction has no sure direction, as a share of the 95th percentile.
SLOW = 0.05
#: Least number of windows, and least share of the force beside friction and load that the acceleration explains.
FEWEST, SHOWN = 40, 0.5


def moved_mass(parts: Sequence[tuple[Array, Array]], rate_hz: float) -> float:
    """Mass or inertia [SI] from force and place [SI] on even grids of ``rate_hz``, (n,) each; NaN where they do not show it."""
    half, step, beside = (max(round(each * rate_hz), 1) for each in (HALF_S, STEP_S, BESIDE_S))
    time = np.arange(-half, half + 1) / rate_hz
    share = (time / HALF_S) ** 2
    bump = np.clip(1.0 - share, 0.0, None) ** 4
    first = np.clip(1.0 - share, 0.0, None) ** 3 * (-8.0 * time / HALF_S**2)
    second = np.gradient(first, time)
    moved = [_speed(x, beside, rate_hz) for _, x in parts]
    usual = float(np.quantile(np.abs(np.concatenate([np.empty(0), *moved])), 0.95)) if any(map(len, moved)) else 0.0
    rows = [np.empty((0, 6))]
    for (force, place), rate in zip(parts, moved, strict=True):
        if len(force) < 2 * half + 1:
            continue
        weights = ((force, bump), (place - place.mean(), second), (place - place.mean(), -first),
                   (np.tanh(rate / max(SLOW * usual, 1e-300)), bump), (np.sin(place), bump), (np.cos(place), bump))  # fmt: skip
        rows.append(np.column_stack([np.correlate(values, weight, "valid")[::step] for values, weight in weights]) / rate_hz)
    table = np.concatenate(rows)
    table = table[np.isfinite(table).all(axis=1)]
    if len(table) < FEWEST:
        return math.nan
    others = np.column_stack([np.ones(len(table)), table[:, 2:]])
    basis = np.linalg.qr(others / np.maximum(np.linalg.norm(others, axis=0), 1e-300))[0]
    force, acceleration = (column - basis @ (basis.T @ column) for column in table[:, :2].T)
    aa, ff, af = float(acceleration @ acceleration), float(force @ force), float(acceleration @ force)
    if not (aa > 0.0 and ff > 0.0 and af > 0.0) or af / math.sqrt(aa * ff) < SHOWN:
        return math.nan
    return af / aa


def _speed(place: Array, beside: int, rate_hz: float) -> Array:
    """Differences over ``2·beside`` rows [SI/s], (n,)."""
    found = np.zeros(len(place))
    if len(place) > 2 * beside:
        found[beside:-beside] = (place[2 * beside :] - place[: -2 * beside]) * rate_hz / (2.0 * beside)
    return found
