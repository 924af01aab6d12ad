"""Figures with readable units, for console and cards; no heavy imports, so that a list is printed at once."""

from __future__ import annotations

import math

#: SI unit → factor and readable unit.
_READABLE = {"m": (1e3, " mm"), "rad": (1e3, " mrad"), "1": (1.0, "")}


def readable(value: float, unit: str, digits: int = 3) -> str:
    """A figure with a readable unit: ``readable(0.0034, "m") == "3.40 mm"``, angles in mrad."""
    factor, label = _READABLE.get(unit, (1.0, f" {unit}"))
    scaled = factor * value
    if scaled == 0.0 or not math.isfinite(scaled):
        return f"{scaled:g}{label}"
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(scaled))))
    return f"{scaled:.{min(decimals, 9)}f}{label}"
