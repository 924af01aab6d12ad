"""Small curves of every signal in every recording of a dataset version, with flagged sections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from sysid.datasets.recording import Recording
from sysid.datasets.versions.manifest import Manifest
from sysid.display import quantity
from sysid.figures import Table
from sysid.reports.charts import svg_element
from sysid.reports.dataset_texts import role_text

Array = npt.NDArray[np.float64]
#: Size of a curve [px], its points, and the most recordings that are drawn.
WIDTH, HEIGHT, POINTS, MOST_RECORDINGS = 96.0, 26.0, 96, 12


def sparklines(recordings: Sequence[Recording], manifest: Manifest) -> Table:
    """A row for each signal, a column for each recording with its role."""
    shown, flags = recordings[:MOST_RECORDINGS], manifest["quality"].get("flags", [])
    rows: list[tuple[object, ...]] = []
    for signal, unit in manifest["units"].items():
        own = [recording for recording in shown if signal != "time" and signal in recording.signals]
        values = np.concatenate([recording.values(signal) for recording in own] or [np.zeros(0)])
        values = values[np.isfinite(values)]
        if not len(values):
            continue
        ends = float(values.min()), float(values.max())
        cells = [_curve(recording, signal, ends, flags) if recording in own else Markup("") for recording in shown]
        scale = Markup("{}<br><small>{} to {}</small>").format(signal, *(quantity(end, unit, 2) for end in ends))
        rows.append((scale, *cells))
    roles = [
        Markup("{}<br><small>{}</small>").format(item.name, role_text(item.kind, manifest["splits"].get(item.name)))
        for item in shown
    ]
    return Table(("signal", *roles), rows)


def _curve(recording: Recording, signal: str, ends: tuple[float, float], flags: Sequence[Mapping[str, Any]]) -> Markup:
    """A signal over time; of static poses dots."""
    values = recording.values(signal)
    low, room = ends[0], max(ends[1] - ends[0], 1e-300)
    rows = np.unique(np.linspace(0, len(values) - 1, POINTS).astype(int))
    x, y = rows * WIDTH / max(len(values) - 1, 1), 2.0 + (HEIGHT - 4.0) * (1.0 - (values[rows] - low) / room)
    parts = []
    for flag in flags:
        if (flag["recording"], flag["signal"]) == (recording.name, signal) and recording.kind == "motion":
            a, b = (WIDTH * flag[key] * recording.rate_hz / max(len(values) - 1, 1) for key in ("from_s", "to_s"))
            title = f"{flag['kind'].replace('_', ' ')}: {flag['text']}"
            size = f'x="{a:.1f}" width="{max(b - a, 1.5):.1f}" height="{HEIGHT:.0f}"'
            parts.append(str(Markup('<rect class="flagged" {}><title>{}</title></rect>').format(Markup(size), title)))
    if recording.kind == "motion":
        for run in np.ma.clump_unmasked(np.ma.masked_invalid(y)):  # type: ignore[no-untyped-call]
            parts.append(
                f'<path class="measured" d="M{" L".join(f"{a:.1f},{b:.1f}" for a, b in zip(x[run], y[run], strict=True))}"/>'
            )
    else:
        known = np.isfinite(y)
        parts += [
            f'<circle class="measured" cx="{a:.1f}" cy="{b:.1f}" r="1"/>' for a, b in zip(x[known], y[known], strict=True)
        ]
    return svg_element("chart spark", WIDTH, HEIGHT, f"{signal} of {recording.name}", parts)
