"""Figures of a page: small charts as inline SVG, without scripts, in the colours of the page's style sheet; and interactive
Plotly figures as data, which the page's script draws.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from sysid import display
from sysid.files import plain
from sysid.pictures import ticks

Array = npt.NDArray[np.float64]
Scale = Callable[[float], float]

#: Sizes of a small chart, and of one of half the page's width [px].
SMALL, WIDE = (300.0, 200.0), (450.0, 230.0)
LEFT, RIGHT, TOP, BOTTOM = 54.0, 10.0, 10.0, 42.0
#: Cells of a heat map with fewer rows are dotted.
FEW_ROWS = 3


@dataclass(frozen=True)
class ChartCurve:
    """A curve (n,), NaN for gaps; ``look`` is its class in the page's style sheet, ``spread`` a band around it."""

    y: Array
    look: str
    dots: bool = False
    spread: Array | None = None


def chart(
    x: Array,
    lines: Sequence[ChartCurve],
    labels: tuple[str, str],
    noise: float = 0.0,
    names: Sequence[str] = (),
    include_zero: bool = True,
    size: tuple[float, float] = SMALL,
) -> str:
    """Curves over ``x`` (n,).

    Args:
        labels: of the two axes.
        noise: half height of the grey band around zero.
        names: of places on the x axis instead of numbers, one for each value.
        include_zero: the vertical axis reaches zero.
        size: width and height [px].
    """
    width, height = size
    low, high = _range(lines, noise, include_zero)
    first, last = float(np.min(x)), float(np.max(x))
    if names:
        first, last = first - 0.5, last + 0.5
    last = last if last > first else first + 1.0

    def px(value: float) -> float:
        return LEFT + (width - LEFT - RIGHT) * (value - first) / (last - first)

    def py(value: float) -> float:
        return height - BOTTOM - (height - TOP - BOTTOM) * (value - low) / (high - low)

    parts = []
    if noise > 0.0:
        top, bottom = py(min(noise, high)), py(max(-noise, low))
        parts.append(
            f'<rect class="noise" x="{LEFT:.0f}" y="{top:.1f}" width="{width - LEFT - RIGHT:.0f}" height="{bottom - top:.1f}"/>'
        )
    parts += grid_lines(low, high, py, width)
    parts += _x_axis(first, last, px, names, x, height)
    for line in lines:
        parts.append(_curve(x, line, px, py))
    parts += axis_labels(labels, (LEFT + width - RIGHT) / 2, (TOP + height - BOTTOM) / 2, height)
    return svg_element("chart", width, height, f"{labels[1]} over {labels[0]}", parts)


def heat_map(
    values: Array,
    counts: npt.NDArray[np.int64],
    edges: tuple[Array, Array],
    labels: tuple[str, str],
    unit: str,
) -> str:
    """Heat map of values (a, b) over two variables; cells without rows are blank.

    Args:
        counts: rows in each cell, (a, b).
        edges: of the cells, (a + 1,) across and (b + 1,) upwards.
        labels: of the two variables; ``unit``: of the values.
    """
    width, height = WIDE
    right = 64.0
    (first, last), (low, high) = (tuple(float(part[k]) for k in (0, -1)) for part in edges)
    most = max(float(np.nanmax(values, initial=0.0)), 1e-300)

    def px(value: float) -> float:
        return LEFT + (width - LEFT - right) * (value - first) / (last - first)

    def py(value: float) -> float:
        return height - BOTTOM - (height - TOP - BOTTOM) * (value - low) / (high - low)

    parts = _x_axis(first, last, px, (), np.zeros(0), height)
    for a, b in np.ndindex(values.shape):
        if not counts[a, b]:
            continue
        x, y = px(float(edges[0][a])), py(float(edges[1][b + 1]))
        w, h = px(float(edges[0][a + 1])) - x, py(float(edges[1][b])) - y
        few = " few" if counts[a, b] < FEW_ROWS else ""
        text = f"{display.number(float(values[a, b]), 3)} {unit}, {counts[a, b]} rows"
        share = 0.06 + 0.94 * float(values[a, b]) / most
        parts.append(
            f'<rect class="cell{few}" x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="{h:.1f}" fill-opacity="{share:.2f}">'
            f"<title>{escape(text)}</title></rect>"
        )
    for value, text in tick_texts(low, high):
        parts.append(f'<text class="tick" x="{LEFT - 6:.0f}" y="{py(value) + 4:.1f}" text-anchor="end">{text}</text>')
    foot, top = height - BOTTOM, TOP
    for step in range(8):  # colour key from zero to the largest value
        share, h = 0.06 + 0.94 * (step + 0.5) / 8.0, (foot - top) / 8.0
        at = f'x="{width - right + 10:.0f}" y="{foot - (step + 1) * h:.1f}" width="10" height="{h:.1f}"'
        parts.append(f'<rect class="cell" {at} fill-opacity="{share:.2f}"/>')
    for y, value in ((foot, 0.0), (top + 9.0, most)):
        text = display.number(value, 2)
        parts.append(f'<text class="tick" x="{width - right + 24:.0f}" y="{y:.1f}">{text}</text>')
    middle = (top + foot) / 2
    parts.append(f'<text class="tick" x="{width - right + 24:.0f}" y="{middle:.0f}">{escape(unit)}</text>')
    parts += axis_labels(labels, (LEFT + width - right) / 2, middle, height)
    return svg_element("chart", width, height, f"error over {labels[0]} and {labels[1]}", parts)


def svg_element(look: str, width: float, height: float, what: str, parts: Sequence[str]) -> str:
    """The SVG element of a picture; ``look`` is its class, ``what`` its text alternative."""
    box = f'viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="{escape(what)}"'
    return f'<svg class="{look}" {box}>{"".join(parts)}</svg>'


def axis_labels(labels: tuple[str, str], centre: float, middle: float, height: float) -> list[str]:
    """Titles of the horizontal and the vertical axis."""
    turned = f'transform="translate(13 {middle:.0f}) rotate(-90)"'
    return [
        f'<text class="label" x="{centre:.0f}" y="{height - 7:.0f}" text-anchor="middle">{escape(labels[0])}</text>',
        f'<text class="label" {turned} text-anchor="middle">{escape(labels[1])}</text>',
    ]


def tick_texts(low: float, high: float, count: int = 4) -> list[tuple[float, str]]:
    """Round values inside a range, and their texts."""
    values = ticks(low, high, count)
    decimals = display.decimals_for([values[1] - values[0]] if len(values) > 1 else values, 1)
    return [(value, display.fixed(value, decimals)) for value in values]


def _range(lines: Sequence[ChartCurve], noise: float, include_zero: bool) -> tuple[float, float]:
    values = [line.y for line in lines]
    values += [line.y + sign * line.spread for line in lines if line.spread is not None for sign in (-1.0, 1.0)]
    joined = np.concatenate([np.asarray(part, dtype=np.float64).ravel() for part in values] or [np.zeros(1)])
    joined = joined[np.isfinite(joined)]
    low, high = (float(joined.min()), float(joined.max())) if len(joined) else (0.0, 1.0)
    if include_zero:
        low, high = min(low, 0.0), max(high, 0.0)
    if noise > 0.0 and include_zero:  # a band that is wider than everything else is cut
        room = max(high - low, 1e-12)
        low, high = min(low, -min(noise, room)), max(high, min(noise, room))
    if high <= low:
        high, low = high + 0.5 * max(abs(high), 1e-12), low - 0.5 * max(abs(low), 1e-12)
    margin = 0.05 * (high - low)
    return low - margin, high + margin


def grid_lines(low: float, high: float, py: Scale, width: float) -> list[str]:
    """Horizontal lines at round values, with their numbers."""
    parts = []
    for value, text in tick_texts(low, high):
        y = py(value)
        look = "zero" if abs(value) < 1e-12 * max(abs(high), abs(low)) or value == 0.0 else "grid"
        parts.append(f'<line class="{look}" x1="{LEFT:.0f}" x2="{width - RIGHT:.0f}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text class="tick" x="{LEFT - 6:.0f}" y="{y + 4:.1f}" text-anchor="end">{text}</text>')
    return parts


def _x_axis(first: float, last: float, px: Scale, names: Sequence[str], x: Array, height: float) -> list[str]:
    y = height - BOTTOM + 16
    if names:
        return [
            f'<text class="tick" x="{px(float(at)):.1f}" y="{y:.0f}" text-anchor="middle">{escape(text)}</text>'
            for at, text in zip(x, names, strict=True)
        ]
    return [
        f'<line class="grid" x1="{px(value):.1f}" x2="{px(value):.1f}" y1="{TOP:.0f}" y2="{height - BOTTOM:.0f}"/>'
        f'<text class="tick" x="{px(value):.1f}" y="{y:.0f}" text-anchor="middle">{text}</text>'
        for value, text in tick_texts(first, last, 5)
    ]


def _curve(x: Array, line: ChartCurve, px: Scale, py: Scale) -> str:
    there = np.isfinite(line.y)
    parts = []
    if line.spread is not None and there.sum() > 1:
        up = [f"{px(float(a)):.1f},{py(float(b)):.1f}" for a, b in zip(x[there], (line.y + line.spread)[there], strict=True)]
        down = [f"{px(float(a)):.1f},{py(float(b)):.1f}" for a, b in zip(x[there], (line.y - line.spread)[there], strict=True)]
        parts.append(f'<path class="spread {line.look}" d="M{" L".join([*up, *down[::-1]])} z"/>')
    pieces = []
    for run in np.ma.clump_unmasked(np.ma.masked_invalid(line.y)):  # type: ignore[no-untyped-call]
        points = [f"{px(float(a)):.1f},{py(float(b)):.1f}" for a, b in zip(x[run], line.y[run], strict=True)]
        pieces.append("M" + " L".join(points))
    if pieces:
        parts.append(f'<path class="{line.look}" d="{" ".join(pieces)}"/>')
    if line.dots:
        parts += [
            f'<circle class="{line.look}" cx="{px(float(a)):.1f}" cy="{py(float(b)):.1f}" r="2.8"/>'
            for a, b in zip(x[there], line.y[there], strict=True)
        ]
    return "".join(parts)


#: Largest number of points of a curve: the resolution of a screen.
MAX_POINTS = 3000


def thin(values: Sequence[Array], limit: int = MAX_POINTS) -> list[Array]:
    """Every k-th row of arrays of equal length, so that at most ``limit`` rows remain."""
    step = max(1, -(-len(values[0]) // limit)) if values else 1
    return [np.asarray(column[::step], dtype=np.float64) for column in values]


def packed(values: Array) -> dict[str, str]:
    """The array as Plotly's typed-array JSON: 32-bit floats in base64, NaN for gaps."""
    return {"dtype": "f4", "bdata": base64.b64encode(np.asarray(values, dtype="<f4").tobytes()).decode("ascii")}


def embed(identifier: str, value: Mapping[str, Any]) -> Markup:
    """A JSON element that the page's script reads; ``<`` is escaped so that no value can close the element."""
    text = json.dumps(plain(value), ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
    return Markup('<script type="application/json" id="{}">{}</script>').format(identifier, Markup(text))


def figure(identifier: str, traces: Sequence[Mapping[str, Any]], layout: Mapping[str, Any], height: int = 340) -> Markup:
    """An interactive Plotly figure.

    Args:
        identifier: unique on the page.
        traces: Plotly traces; a colour given as ``$name`` is the page's CSS variable ``--name``.
        layout: Plotly layout without colours and fonts, which the page sets.
        height: [px].
    """
    island = embed(f"{identifier}-data", {"data": list(traces), "layout": dict(layout)})
    holder = Markup('<div class="figure" data-figure="{}" style="height:{}px"></div>').format(f"{identifier}-data", height)
    return Markup("").join([island, holder])
