"""Curves on logarithmic axes, as an SVG for light and dark pages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

#: Distinct for colour-blind readers.
COLOURS = ("#31688e", "#35b779", "#e08214", "#b2182b", "#7b5aa6", "#8a8a8a", "#c2a000")
WIDTH, HEIGHT, LEFT, TOP, BOTTOM, RIGHT = 430.0, 256.0, 62.0, 34.0, 28.0, 16.0
#: Of the legend: height of a line, width of a letter.
LINE, LETTER = 20.0, 6.6


@dataclass(frozen=True)
class Curve:
    """Points of one line; one without a label is not in the legend. ``band``: lowest and highest around each point."""

    label: str
    colour: str
    x: Sequence[float]
    y: Sequence[float]
    dashed: bool = False
    band: Sequence[tuple[float, float]] = ()


@dataclass(frozen=True)
class Panel:
    """Curves over ``ticks``, the values of x that are named; ``levels`` are dotted lines across with their labels."""

    title: str
    curves: Sequence[Curve]
    ticks: Mapping[float, str]
    levels: Mapping[str, float] | None = None


def picture(panels: Sequence[Panel], columns: int = 2) -> str:
    """Panels row by row, and below them what the colours mean."""
    parts = [_panel(panel, WIDTH * (k % columns), HEIGHT * (k // columns)) for k, panel in enumerate(panels)]
    rows = -(-len(panels) // columns)
    named = {curve.label: curve for panel in panels for curve in panel.curves if curve.label}
    width, x, y = WIDTH * min(columns, len(panels)), LEFT, HEIGHT * rows + LINE
    for label, curve in named.items():
        room = 44.0 + LETTER * len(label)
        if x + room > width and x > LEFT:
            x, y = LEFT, y + LINE
        look = ' class="dashed"' if curve.dashed else ""
        parts.append(f'<polyline points="{x:.0f},{y - 4:.0f} {x + 22:.0f},{y - 4:.0f}" stroke="{curve.colour}"{look}/>')
        parts.append(f'<text x="{x + 28:.0f}" y="{y:.0f}">{label}</text>')
        x += room
    style = (
        "text{font:12px sans-serif;fill:#666}line{stroke:#999;stroke-opacity:.35}"
        "line.level{stroke-dasharray:2 4;stroke-opacity:1}"
        "polyline{fill:none;stroke-width:2}.dashed{stroke-dasharray:4 4;stroke-width:1.4}polygon{fill-opacity:.18}"
    )
    size = f'viewBox="0 0 {width:.0f} {y + 12:.0f}" width="{width:.0f}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size}><style>{style}</style>\n' + "\n".join(parts) + "\n</svg>\n"


def _panel(panel: Panel, left: float, top: float) -> str:
    values = [value for curve in panel.curves for value in (*curve.y, *(end for pair in curve.band for end in pair))]
    values += (panel.levels or {}).values()
    low, high = math.floor(math.log10(min(values)) + 1e-9), math.ceil(math.log10(max(values)) - 1e-9)
    high = max(high, low + 1)
    first, last = (math.log10(end(panel.ticks)) for end in (min, max))
    last = max(last, first + 1e-3)  # of a single point
    begin, end = left + LEFT, left + WIDTH - RIGHT
    ceiling, floor = top + TOP, top + HEIGHT - BOTTOM

    def px(x: float) -> float:
        return begin + (end - begin) * (math.log10(x) - first) / (last - first)

    def py(y: float) -> float:
        return floor - (floor - ceiling) * (math.log10(y) - low) / (high - low)

    parts = [f'<text x="{begin:.0f}" y="{top + 20:.0f}">{panel.title}</text>']
    for power in range(low, high + 1):
        y = py(10.0**power)
        parts.append(f'<line x1="{begin:.1f}" x2="{end:.1f}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{begin - 6:.1f}" y="{y + 4:.1f}" text-anchor="end">{10.0**power:g}</text>')
    for label, value in (panel.levels or {}).items():
        y = py(value)
        parts.append(f'<line class="level" x1="{begin:.1f}" x2="{end:.1f}" y1="{y:.1f}" y2="{y:.1f}"/>')
        below = y + 13 if y + 16 < floor else y - 5  # not over the names of the ticks
        parts.append(f'<text x="{end:.1f}" y="{below:.1f}" text-anchor="end">{label}</text>')
    for value, name in panel.ticks.items():
        parts.append(f'<text x="{px(value):.1f}" y="{floor + 18:.1f}" text-anchor="middle">{name}</text>')
    for curve in panel.curves:
        if curve.band:
            low_edge, high_edge = zip(*curve.band, strict=True)
            edge = [*zip(curve.x, low_edge, strict=True), *zip(reversed(curve.x), reversed(high_edge), strict=True)]
            corners = " ".join(f"{px(x):.1f},{py(y):.1f}" for x, y in edge)
            parts.append(f'<polygon points="{corners}" fill="{curve.colour}"/>')
        if len(curve.x) == 1:  # a line through one point is not drawn
            parts.append(f'<circle cx="{px(curve.x[0]):.1f}" cy="{py(curve.y[0]):.1f}" r="3" fill="{curve.colour}"/>')
        points = " ".join(f"{px(x):.1f},{py(y):.1f}" for x, y in zip(curve.x, curve.y, strict=True))
        look = ' class="dashed"' if curve.dashed else ""
        parts.append(f'<polyline points="{points}" stroke="{curve.colour}"{look}/>')
    return "\n".join(parts)
