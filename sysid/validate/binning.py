"""Bins of a variable, and the share of an error's variance that they explain; used by maps of errors and of the gap."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]
#: ``range``: equal bins; ``signed``: symmetric bins, one of which contains zero; ``sign``: a direction, −1, 0 or +1.
Cut = Literal["range", "signed", "sign"]

#: Number of bins of a signed variable (odd: one of them contains zero), and of others.
SIGNED_BINS, BINS = 31, 20
#: Speeds are differences over this time [s]: long against sensor noise, short against a stroke.
SPEED_WINDOW = 0.2
#: Below this share of the largest speed an axis counts as at rest.
STANDING = 0.02


def edges_of(values: Array, cut: Cut = "range", bins: int | None = None) -> Array | None:
    """Edges of the bins, (bins + 1,); None where ``values`` (n,) do not vary.

    Values beyond the 0.5 and 99.5 % percentiles belong to the bins at the ends.
    """
    if cut == "sign":
        return np.array([-1.5, -0.5, 0.5, 1.5])
    low, high = np.quantile(values, (0.005, 0.995))
    if cut == "signed":
        low, high = -max(abs(low), abs(high)), max(abs(low), abs(high))
    if not high - low > 1e-9 * max(abs(low), abs(high), 1e-12):
        return None
    return np.linspace(low, high, (bins or (SIGNED_BINS if cut == "signed" else BINS)) + 1)


def places_in(edges: Array, values: Array) -> Index:
    """Index of the bin of every value, (n,)."""
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)


def explained(error: Array, place: Index, count: Index) -> float:
    """Share of the variance of the error that the means of the bins explain (correlation ratio η², 0 … 1)."""
    sums = np.bincount(place, weights=error, minlength=len(count))
    total = float(np.sum((error - error.mean()) ** 2))
    between = float(np.sum(sums**2 / np.maximum(count, 1)) - error.sum() ** 2 / len(error))
    return min(max(between / total, 0.0), 1.0) if total > 0.0 else 0.0


def speed_of(values: Array, rate_hz: float, window: float = SPEED_WINDOW) -> Array:
    """Central differences (n, …) over ``window`` [s], NaN at the ends and beside gaps."""
    half = max(1, round(0.5 * window * rate_hz))
    out = np.full(values.shape, np.nan)
    if len(values) > 2 * half:
        out[half:-half] = (values[2 * half :] - values[: -2 * half]) * (rate_hz / (2 * half))
    return out


def direction_of(speed: Array) -> Array:
    """−1, 0 (at rest) or +1; NaN where the speed is NaN."""
    least = STANDING * float(np.nanmax(np.abs(speed), initial=0.0))
    return np.where(np.isnan(speed), np.nan, np.where(np.abs(speed) > least, np.sign(speed), 0.0))


def per_second(unit: str) -> str:
    return f"{unit}/s" if unit != "1" else "1/s"
