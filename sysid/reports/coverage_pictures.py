"""Pictures of coverage as inline SVG: time at each command, and joint positions of pairs of axes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape

from sysid import display
from sysid.datasets.quality.coverage import GRID, PairMap, Rest, Span
from sysid.datasets.quality.use import CELLS, SMALL, VISITED_S, AxisUse
from sysid.reports.charts import BOTTOM, LEFT, RIGHT, TOP, axis_labels, grid_lines, svg_element, tick_texts
from sysid.reports.charts import SMALL as SIZE

#: Side of the square of a map, and its margins [px].
MAP, MAP_LEFT, MAP_TOP = 200.0, 58.0, 8.0


def command_picture(use: AxisUse, unit: str, small: bool, size: tuple[float, float] = SIZE) -> str:
    """Seconds at each command, idle time left out; the band of small commands is marked.

    Args:
        unit: SI unit of the command.
        small: mark the band of small commands (not for position commands).
        size: width and height [px].
    """
    width, height = size
    factor, label = display.shown_unit(unit)
    top = max(1.08 * max(use.seconds, default=0.0), 1.0)

    def px(share: float) -> float:
        return LEFT + (width - LEFT - RIGHT) * (share + 1.0) / 2.0

    def py(seconds: float) -> float:
        return height - BOTTOM - (height - TOP - BOTTOM) * seconds / top

    parts = []
    if small:
        for low, high in (SMALL, (-SMALL[1], -SMALL[0])):
            parts.append(
                f'<rect class="noise" x="{px(low):.1f}" y="{TOP:.0f}" width="{px(high) - px(low):.1f}" '
                f'height="{height - TOP - BOTTOM:.0f}"/>'
            )
    parts += grid_lines(0.0, top, py, width)
    step = 2.0 / CELLS
    for number, seconds in enumerate(use.seconds):
        left = px(-1.0 + number * step)
        look = "bar" if seconds >= VISITED_S else "bar thin"
        text = f"{display.number(seconds)} s at {_range(number, use.full * factor)} {label}".strip()
        parts.append(
            f'<rect class="{look}" x="{left + 0.8:.1f}" y="{py(seconds):.1f}" width="{px(-1.0 + step) - px(-1.0) - 1.6:.1f}" '
            f'height="{py(0.0) - py(seconds):.1f}"><title>{escape(text)}</title></rect>'
        )
    for share in (-1.0, -0.5, 0.0, 0.5, 1.0):
        value = display.number(share * use.full * factor, 2)
        parts.append(
            f'<text class="tick" x="{px(share):.1f}" y="{height - BOTTOM + 16:.0f}" text-anchor="middle">{value}</text>'
        )
    below = f"command [{label}]" if label else "command"
    parts += axis_labels((below, "time [s]"), px(0.0), (TOP + height - BOTTOM) / 2, height)
    return svg_element("chart", width, height, "time at each command", parts)


def _range(number: int, full: float) -> str:
    ends = (-1.0 + 2.0 * (number + k) / CELLS for k in (0, 1))
    return " to ".join(display.number(full * end, 2) for end in ends)


def map_picture(found: PairMap, rests: Sequence[Rest], units: Mapping[str, str]) -> str:
    """Time in each cell of two ranges (logarithmic shade), static poses, and postures at rest."""
    width, height = MAP_LEFT + MAP + 12.0, MAP_TOP + MAP + 40.0
    cell = MAP / GRID
    most = max((s for row in found.seconds for s in row), default=0.0)
    parts = [f'<rect class="frame" x="{MAP_LEFT:.0f}" y="{MAP_TOP:.0f}" width="{MAP:.0f}" height="{MAP:.0f}"/>']
    for row in range(GRID):
        for column in range(GRID):
            seconds, poses = found.seconds[row][column], found.poses[row][column]
            x, y = MAP_LEFT + row * cell, MAP_TOP + MAP - (column + 1) * cell
            text = f"{display.number(seconds)} s" + (f", {poses} poses" if poses else "")
            if seconds >= VISITED_S:
                heat = 25.0 + 70.0 * math.log(seconds / VISITED_S) / max(math.log(most / VISITED_S), 1e-9)
                parts.append(
                    f'<rect class="cell" style="--heat:{min(heat, 95.0):.0f}%" x="{x + 0.5:.1f}" y="{y + 0.5:.1f}" '
                    f'width="{cell - 1:.1f}" height="{cell - 1:.1f}"><title>{text}</title></rect>'
                )
            if poses:
                middle = f'cx="{x + cell / 2:.1f}" cy="{y + cell / 2:.1f}"'
                parts.append(
                    f'<circle class="pose" {middle} r="{1.4 + 0.7 * min(poses, 9) ** 0.5:.1f}"><title>{text}</title></circle>'
                )
    a, b = found.first, found.second
    for rest in rests:
        if a.axis in rest.posture and b.axis in rest.posture:
            x = MAP_LEFT + MAP * _share(rest.posture[a.axis], a)
            y = MAP_TOP + MAP * (1.0 - _share(rest.posture[b.axis], b))
            title = f"at rest for {display.number(rest.seconds)} s in {rest.recording}"
            parts.append(f'<circle class="rest" cx="{x:.1f}" cy="{y:.1f}" r="3.6"><title>{escape(title)}</title></circle>')
    titles = (
        _scale(parts, a, units.get(a.signal), upright=False),
        _scale(parts, b, units.get(b.signal), upright=True),
    )
    parts += axis_labels(titles, MAP_LEFT + MAP / 2, MAP_TOP + MAP / 2, height)
    return svg_element("chart coverage", width, height, f"simultaneous positions of {a.axis} and {b.axis}", parts)


def _share(value: float, span: Span) -> float:
    return min(max((value - span.low) / (span.high - span.low), 0.0), 1.0)


def _scale(parts: list[str], span: Span, unit: str | None, upright: bool) -> str:
    """Add the ticks of one side of a map to ``parts``; returns its title."""
    factor, label = display.shown_unit(unit)
    low, high = factor * span.low, factor * span.high
    for value, text in tick_texts(low, high, 3):
        share = (value - low) / (high - low)
        if upright:
            y = MAP_TOP + MAP * (1.0 - share)
            parts.append(f'<text class="tick" x="{MAP_LEFT - 6:.0f}" y="{y + 4:.1f}" text-anchor="end">{text}</text>')
        else:
            x = MAP_LEFT + MAP * share
            parts.append(f'<text class="tick" x="{x:.1f}" y="{MAP_TOP + MAP + 16:.0f}" text-anchor="middle">{text}</text>')
    return f"{span.axis} [{label}]" if label else span.axis
