"""The held-out errors that are stored with a network version."""

from __future__ import annotations

from dataclasses import dataclass

from sysid.display import quantity
from sysid.registry.version import ModelVersion


@dataclass(frozen=True)
class OutputFigures:
    """Errors of one output on held-out rows, as text with units; ``–`` for a figure that is not stored.

    Args:
        signal: ``boom.joint``.
        rows: ``motion`` or ``poses``.
    """

    signal: str
    rows: str
    rmse: str = "–"
    p95: str = "–"
    max: str = "–"


def held_out_figures(version: ModelVersion) -> tuple[OutputFigures, ...]:
    """RMSE, 95 % and maximum of every output, from the stored metrics."""
    found: dict[tuple[str, str], dict[str, str]] = {}
    for key, value in version.metrics.items():
        output, _, figure = key.rpartition(".")
        signal, _, rows = output.rpartition(".")
        if figure in ("rmse", "p95", "max") and signal:
            unit = "rad" if signal.endswith(".joint") else "m"
            found.setdefault((signal, "poses" if rows == "poses" else "motion"), {})[figure] = quantity(value, unit)
    return tuple(OutputFigures(signal, rows, **figures) for (signal, rows), figures in found.items())
