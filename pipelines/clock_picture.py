"""The picture of the study of clocks: what the offset and the skew are off by, over the length of the log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from log_picture import COLOURS, Curve, Panel
from log_picture import picture as drawn


def picture(
    rows: Sequence[Mapping[str, Any]], durations: Sequence[float], motions: Sequence[float], names: Mapping[float, str]
) -> str:
    """SVG: error of the time at the end of the log, and of the skew, on logarithmic axes; one line a motion, plain recordings
    in full and those with mishaps dashed."""
    panels = []
    for title, key in (("error at the end of the log [ms]", "end_ms"), ("error of the skew [ppm]", "skew_ppm")):
        curves = []
        for colour, hertz in zip(COLOURS, motions, strict=False):
            for kind in dict.fromkeys(row["kind"] for row in rows):
                own = [row for row in rows if row["hertz"] == hertz and row["kind"] == kind and row[key]]
                label = f"{hertz:g} Hz" if kind == "plain" else ""
                x, y = ([row[name] for row in own] for name in ("seconds", key))
                curves.append(Curve(label, colour, x, y, dashed=kind != "plain"))
        panels.append(Panel(title, curves, {seconds: names[seconds] for seconds in durations}))
    return drawn(panels)
