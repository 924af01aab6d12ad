"""Figures of a page: small charts as inline SVG, without scripts, in the colours of the page's style sheet; and interactive
Plotly figures as data, which the page's script draws.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
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

#: Sizes of a small chart, and of one of half the page's width [px].
SMALL, WIDE = (300.0, 200.0), (450.0, 230.0)
LEFT, RIGHT, TOP, BOTTOM = 54.0, 10.0, 10.0, 42.0
#: Right margin of a heat map, which holds its key [px].
KEY = 64.0
#: Cells of a heat map with fewer rows are dotted.
FEW_ROWS = 3


@dataclass(frozen=True)
class ChartCurve:
    """A curve (n,), NaN for gaps; ``look`` is its class in the page's style sheet, ``spread`` a band around it."""

    y: Array
    look: str
    dots: bool = False
    spread: Array | None = None


@dataclass(frozen=True)
class Plane:
    """The area of a chart between its axes: values ``x`` and ``y`` (low, high), at ``left`` and ``top`` [px]."""

    x: tuple[float, float]
    y: tuple[float, float]
    left: float
    top: float
    width: float
    height: float

    @classmethod
    def of(cls, size: tuple[float, float], x: tuple[float, float], y: tuple[float, float], right: float = RIGHT) -> Plane:
        """That of a chart of a size [px], with the usual margins."""
        return cls(x, y, LEFT, TOP, size[0] - LEFT - right, size[1] - TOP - BOTTOM)

    def px(self, value: float) -> float:
        return self.left + self.width * (value - self.x[0]) / (self.x[1] - self.x[0])

    def py(self, value: float) -> float:
        return self.top + self.height * (self.y[1] - value) / (self.y[1] - self.y[0])

    def box(
        self,
        look: str,
        x: tuple[float, float],
        y: tuple[float, float],
        title: str = "",
        style: str = "",
        gap: tuple[float, float] = (0.0, 0.0),
    ) -> str:
        """A rectangle between values; ``style``: further attributes, ``gap``: to its neighbours across and above [px]."""
        (left, right), (low, high) = map(self.px, x), map(self.py, y)
        corner = f'x="{left + gap[0]:.1f}" y="{high + gap[1]:.1f}"'
        size = f'width="{right - left - 2.0 * gap[0]:.1f}" height="{low - high - 2.0 * gap[1]:.1f}"'
        text = f"<title>{escape(title)}</title>" if title else ""
        return f'<rect class="{look}" {corner} {size}{style and " "}{style}>{text}</rect>'

    def x_axis(self, texts: Sequence[tuple[float, str]], lines: bool = False) -> list[str]:
        """Texts below the area, with vertical lines through it."""
        foot, parts = self.top + self.height, list[str]()
        for value, text in texts:
            x = f"{self.px(value):.1f}"
            if lines:
                parts.append(f'<line class="grid" x1="{x}" x2="{x}" y1="{self.top:.0f}" y2="{foot:.0f}"/>')
            parts.append(f'<text class="tick" x="{x}" y="{foot + 16:.0f}" text-anchor="middle">{escape(text)}</text>')
        return parts

    def y_axis(self, count: int = 4, lines: bool = False) -> list[str]:
        """Round values beside the area, with horizontal lines through it."""
        parts = []
        for value, text in tick_texts(*self.y, count):
            y, near = self.py(value), abs(value) < 1e-12 * max(map(abs, self.y)) or value == 0.0
            if lines:
                ends = f'x1="{self.left:.0f}" x2="{self.left + self.width:.0f}" y1="{y:.1f}" y2="{y:.1f}"'
                parts.append(f'<line class="{"zero" if near else "grid"}" {ends}/>')
            parts.append(f'<text class="tick" x="{self.left - 6:.0f}" y="{y + 4:.1f}" text-anchor="end">{text}</text>')
        return parts

    def labels(self, across: str, up: str, height: float) -> list[str]:
        """Titles of both axes, in a picture of this height."""
        centre, middle = self.left + self.width / 2, self.top + self.height / 2
        return [
            f'<text class="label" x="{centre:.0f}" y="{height - 7:.0f}" text-anchor="middle">{escape(across)}</text>',
            f'<text class="label" transform="translate(13 {middle:.0f}) rotate(-90)" text-anchor="middle">{escape(up)}</text>',
        ]


def chart(
    x: Array,
    lines: Sequence[ChartCurve],
    labels: tuple[str, str],
    noise: float = 0.0,
    names: Sequence[str] = (),
    include_zero: bool = True,
    size: tuple[float, float] = SMALL,
) -> Markup:
    """Curves over ``x`` (n,).

    Args:
        labels: of the two axes.
        noise: half height of the grey band around zero.
        names: of places on the x axis instead of numbers, one for each value.
        include_zero: the vertical axis reaches zero.
        size: width and height [px].
    """
    low, high = _range(lines, noise, include_zero)
    margin = 0.5 if names else 0.0
    first, last = float(np.min(x)) - margin, float(np.max(x)) + margin
    last = last if last > first else first + 1.0
    plane = Plane.of(size, (first, last), (low, high))
    parts = [plane.box("noise", plane.x, (max(-noise, low), min(noise, high)))] if noise > 0.0 else []
    parts += plane.y_axis(lines=True)
    parts += plane.x_axis(list(zip(x.tolist(), names, strict=True)) if names else tick_texts(first, last, 5), lines=not names)
    parts += [_curve(x, line, plane) for line in lines]
    parts += plane.labels(*labels, size[1])
    return svg_element("chart", *size, f"{labels[1]} over {labels[0]}", parts)


def heat_map(
    values: Array,
    counts: npt.NDArray[np.int64],
    edges: tuple[Array, Array],
    labels: tuple[str, str],
    unit: str,
) -> Markup:
    """Heat map of values (a, b) over two variables; cells without rows are blank.

    Args:
        counts: rows in each cell, (a, b).
        edges: of the cells, (a + 1,) across and (b + 1,) upwards.
        labels: of the two variables; ``unit``: of the values.
    """
    across, up = ((float(part[0]), float(part[-1])) for part in edges)
    plane, most = Plane.of(WIDE, across, up, KEY), max(float(np.nanmax(values, initial=0.0)), 1e-300)
    parts = plane.x_axis(tick_texts(*across, 5), lines=True)
    for a, b in np.ndindex(values.shape):
        if counts[a, b]:
            text = f"{display.number(float(values[a, b]), 3)} {unit}, {counts[a, b]} rows"
            ends = [(float(part[k]), float(part[k + 1])) for part, k in zip(edges, (a, b), strict=True)]
            look = "cell few" if counts[a, b] < FEW_ROWS else "cell"
            parts.append(plane.box(look, ends[0], ends[1], text, _shade(float(values[a, b]) / most)))
    parts += plane.y_axis()
    left, foot = plane.left + plane.width + 10.0, plane.top + plane.height
    for step in range(8):  # colour key from zero to the largest value
        h = plane.height / 8.0
        place = f'x="{left:.0f}" y="{foot - (step + 1) * h:.1f}" width="10" height="{h:.1f}"'
        parts.append(f'<rect class="cell" {_shade((step + 0.5) / 8.0)} {place}/>')
    middle = plane.top + plane.height / 2
    for y, text in ((foot, display.number(0.0, 2)), (plane.top + 9.0, display.number(most, 2)), (middle, unit)):
        parts.append(f'<text class="tick" x="{left + 14.0:.0f}" y="{y:.1f}">{escape(text)}</text>')
    parts += plane.labels(*labels, WIDE[1])
    return svg_element("chart", *WIDE, f"error over {labels[0]} and {labels[1]}", parts)


#: Colours of a path in space, and its views: x, y, z → right, down.
SHADES = 8
_ISOMETRIC = np.array([[0.866, 0.5], [-0.866, 0.5], [0.0, -1.0]])


def space_path(points: Array, values: Array, most: float, unit: str) -> Markup:
    """A path in space, from obliquely above, coloured by a value along it.

    Args:
        points: (n, 3) [m]; rows with NaN are gaps.
        values: (n,), from zero to ``most``, which is the end of the colour scale, in ``unit``.
    """
    flat, there = points @ _ISOMETRIC, np.isfinite(points).all(axis=1) & np.isfinite(values)
    if not there.any():
        return Markup("")
    low, high = flat[there].min(axis=0), flat[there].max(axis=0)
    width, height = WIDE[0] - KEY - 2 * TOP, WIDE[1] - BOTTOM - TOP
    scale = min(width / max(high[0] - low[0], 1e-9), height / max(high[1] - low[1], 1e-9))
    page = np.array([TOP + 0.5 * width, TOP + 0.5 * height]) + scale * (flat - 0.5 * (low + high))
    levels = np.minimum((SHADES * values[there] / max(most, 1e-300)).astype(int), SHADES - 1)
    rows = np.flatnonzero(there)
    parts = []
    for run in np.split(np.arange(len(rows)), np.flatnonzero((np.diff(levels) != 0) | (np.diff(rows) != 1)) + 1):
        ends = [
            *rows[run],
            *([rows[run[-1]] + 1] if run[-1] + 1 < len(rows) and rows[run[-1] + 1] == rows[run[-1]] + 1 else []),
        ]
        line = " L".join(f"{x:.1f},{y:.1f}" for x, y in page[ends])
        parts.append(f'<path d="M{line}" style="{_warmth(levels[run[0]])}"/>')
    x, y = page[rows[int(np.argmax(values[there]))]]
    parts.append(f'<circle class="worst" cx="{x:.1f}" cy="{y:.1f}" r="5"/>')
    bar = ticks(0.0, 0.4 * width / scale, 1)[-1]
    foot = WIDE[1] - 14.0
    parts.append(f'<path class="measured" d="M{TOP},{foot} h{scale * bar:.1f}"/>')
    parts.append(f'<text class="tick" x="{TOP}" y="{foot - 6}">{display.quantity(bar, "m", 2)}</text>')
    left, step = WIDE[0] - KEY + 14.0, height / SHADES
    for level in range(SHADES):
        at = TOP + height - (level + 0.5) * step
        parts.append(f'<path d="M{left},{at:.1f} h12" style="{_warmth(level)};stroke-width:{step:.1f}"/>')
    for at, text in ((TOP + height, "0"), (TOP + 10.0, display.number(most, 2)), (TOP + 0.5 * height, unit)):
        parts.append(f'<text class="tick" x="{left + 17}" y="{at:.1f}">{escape(text)}</text>')
    return svg_element("chart", *WIDE, f"path in space, largest error {display.number(most, 3)} {unit}", parts)


def _warmth(level: int) -> str:
    return f"stroke:color-mix(in oklab, var(--hot) {100 * level // (SHADES - 1)}%, var(--after))"


def _shade(share: float) -> str:
    return f'fill-opacity="{0.06 + 0.94 * share:.2f}"'


def svg_element(look: str, width: float, height: float, what: str, parts: Sequence[str]) -> Markup:
    """The SVG element of a picture; ``look`` is its class, ``what`` its text alternative."""
    box = f'viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="{escape(what)}"'
    return Markup(f'<svg class="{look}" {box}>{"".join(parts)}</svg>')


def captioned(picture: Markup, caption: str) -> Markup:
    """A picture with its caption, which may be markup."""
    return Markup("<figure>{}<figcaption>{}</figcaption></figure>").format(picture, caption)


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


def _curve(x: Array, line: ChartCurve, plane: Plane) -> str:
    px, py = plane.px, plane.py
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
