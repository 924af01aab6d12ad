"""The picture of the study of clocks: what the offset and the skew are off by, over the length of the log."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

#: One colour a motion, from slow to fast.
COLOURS = ("#31688e", "#35b779", "#e08214", "#b2182b")
WIDTH, HEIGHT, LEFT, TOP, ROOM = 430.0, 300.0, 62.0, 34.0, 44.0


def picture(
    rows: Sequence[Mapping[str, Any]], durations: Sequence[float], motions: Sequence[float], names: Mapping[float, str]
) -> str:
    """SVG: error of the time at the end of the log, and of the skew, on logarithmic axes; one line a motion, plain recordings
    in full and those with mishaps dashed."""
    panels = [("error at the end of the log [ms]", "end_ms"), ("error of the skew [ppm]", "skew_ppm")]
    parts = [_panel(rows, durations, motions, names, title, key, k * WIDTH) for k, (title, key) in enumerate(panels)]
    style = (
        "text{font:12px sans-serif;fill:#666}line{stroke:#999;stroke-opacity:.35}polyline{fill:none;stroke-width:2}"
        ".mishap{stroke-dasharray:4 4;stroke-width:1.4}"
    )
    size = f'viewBox="0 0 {2 * WIDTH:.0f} {HEIGHT:.0f}" width="{2 * WIDTH:.0f}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size}><style>{style}</style>\n' + "\n".join(parts) + "\n</svg>\n"


def _panel(
    rows: Sequence[Mapping[str, Any]],
    durations: Sequence[float],
    motions: Sequence[float],
    names: Mapping[float, str],
    title: str,
    key: str,
    shift: float,
) -> str:
    values = [row[key] for row in rows if row[key]]
    low, high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
    first, last = math.log10(durations[0]), math.log10(durations[-1])

    def px(seconds: float) -> float:
        return shift + LEFT + (WIDTH - LEFT - 16.0) * (math.log10(seconds) - first) / (last - first)

    def py(value: float) -> float:
        return HEIGHT - ROOM - (HEIGHT - ROOM - TOP) * (math.log10(value) - low) / (high - low)

    parts = [f'<text x="{shift + LEFT:.0f}" y="20">{title}</text>']
    for power in range(low, high + 1):
        y = py(10.0**power)
        parts.append(f'<line x1="{shift + LEFT:.1f}" x2="{shift + WIDTH - 16:.1f}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{shift + LEFT - 6:.1f}" y="{y + 4:.1f}" text-anchor="end">{10.0**power:g}</text>')
    for seconds in durations:
        parts.append(f'<text x="{px(seconds):.1f}" y="{HEIGHT - ROOM + 18:.1f}" text-anchor="middle">{names[seconds]}</text>')
    for colour, hertz in zip(COLOURS, motions, strict=False):
        for kind in dict.fromkeys(row["kind"] for row in rows):
            own = [r for r in rows if r["hertz"] == hertz and r["kind"] == kind and r[key]]
            points = " ".join(f"{px(r['seconds']):.1f},{py(r[key]):.1f}" for r in own)
            look = "" if kind == "plain" else ' class="mishap"'
            parts.append(f'<polyline points="{points}" stroke="{colour}"{look}/>')
    for k, (colour, hertz) in enumerate(zip(COLOURS, motions, strict=False)):
        parts.append(
            f'<text x="{shift + LEFT + 90 * k:.0f}" y="{HEIGHT - 8:.0f}"><tspan fill="{colour}">●</tspan> {hertz:g} Hz</text>'
        )
    return "\n".join(parts)
