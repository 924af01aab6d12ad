"""The generated part of reports/bench_agreement/README.md."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from agreement.outcome import Agreement
from committed import markdown


def in_words(row: Agreement) -> str:
    """``boom: valve.delay 0.12``: what the machine was given."""
    parts = []
    for key, value in row.feature.items():
        if key == "sensors":
            parts += [f"sensor {name} {number(setting)}" for name, setting in value[0].items() if name != "signal"]
        else:
            parts.append(f"{key.removeprefix('axes.').removeprefix('0.')} {number(value)}")
    return ", ".join(parts) + (" ¹" if row.base else "")


def number(value: Any) -> str:
    if value is None:
        return "left out"
    return " ".join(f"{v:.4g}" for v in np.atleast_1d(np.asarray(value, dtype=np.float64)))


def size(value: float, unit: str) -> str:
    """With a unit that suits: 0.93 mm, 12 µrad."""
    for factor, prefix in ((1.0, ""), (1e3, "m"), (1e6, "µ")):
        if value * factor >= 0.1:
            return f"{value * factor:.2g} {prefix}{unit}" if value * factor < 100.0 else f"{value * factor:.0f} {prefix}{unit}"
    return f"< 0.1 µ{unit}"


def table(rows: Sequence[Agreement]) -> str:
    """The generated part of the page."""
    head = [
        "effect", "machine and feature", "signal", "without effect", "with effect", "remaining", "baseline", "fitted",
        "true setting",
    ]  # fmt: skip
    return markdown(head, map(cells, rows), "lllrrrrll")


def cells(row: Agreement) -> tuple[str, ...]:
    side = f", {row.side}" if row.side else ""
    first = row.signals[0].split(".")[0]
    return (
        f"`{row.effect}` on {row.target}{side}",
        f"{row.machine}: {in_words(row)}",
        first if first in ("ee", "tool") else ", ".join(row.signals),
        size(row.without, row.unit),
        size(row.with_effect, row.unit),
        f"{100.0 * row.share:.1f} %" if row.share >= 1e-3 else "< 0.1 %",
        size(row.alone, row.unit),
        ", ".join(f"{name} {number(value)}" for name, value in row.parameters.items()),
        ", ".join(number(value) for value in row.own.values()) or "–",
    )
