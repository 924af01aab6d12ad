"""Line plots as SVG, identical on every computer: coordinates are rounded to a tenth of a pixel."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 640, 240, 64, 12, 26, 36
#: Background, grid, frame, numbers and words of a plot: colour on a light page → colour on a dark one.
DARK = {"#ffffff": "#0d1117", "#eceef0": "#21262d", "#c8ccd0": "#30363d", "#555b61": "#9198a1", "#30363c": "#e6edf3"}


@dataclass(frozen=True)
class PictureCurve:
    """One curve: ``x`` and ``y`` (n,), interrupted at NaN."""

    label: str
    x: Array
    y: Array
    colour: str
    dashed: bool = False


def svg(title: str, x_label: str, y_label: str, lines: Sequence[PictureCurve], equal: bool = False) -> str:
    """The plot as SVG text; ``equal`` gives both axes the same scale."""
    x = np.concatenate([line.x for line in lines])
    y = np.concatenate([line.y for line in lines])
    (x0, x1), (y0, y1) = (float(np.nanmin(x)), float(np.nanmax(x))), _span(y)
    wide, high = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM
    if equal:
        scale = max((x1 - x0) / wide, (y1 - y0) / high)
        x0, x1 = _around(0.5 * (x0 + x1), scale * wide)
        y0, y1 = _around(0.5 * (y0 + y1), scale * high)

    def place(xs: Array, ys: Array) -> str:
        stride = max(1, len(xs) // 350)  # the resolution of the plot
        xs, ys = xs[::stride], ys[::stride]
        px = LEFT + (xs - x0) / (x1 - x0) * wide
        py = TOP + (y1 - ys) / (y1 - y0) * high
        return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(px, py, strict=True) if a == a and b == b)

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" '
        'font-family="sans-serif" font-size="11" role="img">',
        f"<title>{escape(title)}</title>",
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>',
    ]
    for value, text in _named(x0, x1, 6):
        at = LEFT + (value - x0) / (x1 - x0) * wide
        parts.append(f'<path d="M{at:.1f} {TOP}v{high}" stroke="#eceef0"/>')
        parts.append(f'<text x="{at:.1f}" y="{HEIGHT - 20}" text-anchor="middle" fill="#555b61">{text}</text>')
    for value, text in _named(y0, y1, 4):
        at = TOP + (y1 - value) / (y1 - y0) * high
        parts.append(f'<path d="M{LEFT} {at:.1f}h{wide}" stroke="#eceef0"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{at + 4:.1f}" text-anchor="end" fill="#555b61">{text}</text>')
    parts.append(f'<rect x="{LEFT}" y="{TOP}" width="{wide}" height="{high}" fill="none" stroke="#c8ccd0"/>')
    parts.append(
        f'<text x="{LEFT + wide / 2:.1f}" y="{HEIGHT - 6}" text-anchor="middle" fill="#30363c">{escape(x_label)}</text>'
    )
    parts.append(f'<text x="{LEFT}" y="16" fill="#30363c">{escape(y_label)}</text>')
    for k, line in enumerate(reversed(lines)):
        at = WIDTH - RIGHT - 150 * (k + 1) + 20
        dash = ' stroke-dasharray="5 4"' if line.dashed else ""
        parts.append(f'<line x1="{at}" y1="12" x2="{at + 18}" y2="12" stroke="{line.colour}" stroke-width="2"{dash}/>')
        parts.append(f'<text x="{at + 23}" y="16" fill="#30363c">{escape(line.label)}</text>')
    for line in lines:
        dash = ' stroke-dasharray="5 4"' if line.dashed else ""
        style = f'fill="none" stroke="{line.colour}" stroke-width="1.6"{dash}'
        parts.append(f'<polyline points="{place(line.x, line.y)}" {style}/>')
    return "\n".join([*parts, "</svg>", ""])


def themed(picture: str, dark: Mapping[str, str] = DARK) -> str:
    """A plot for a file of its own, with the colours ``dark`` where its reader prefers dark pages."""
    rules = "".join(f'[fill="{one}"]{{fill:{two}}}[stroke="{one}"]{{stroke:{two}}}' for one, two in dark.items())
    return picture.replace("</title>", f"</title>\n<style>@media (prefers-color-scheme:dark){{{rules}}}</style>", 1)


def ticks(low: float, high: float, count: int = 4) -> list[float]:
    """Round values inside a range, about ``count`` of them."""
    raw = (high - low) / max(count, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = min((power * k for k in (1.0, 2.0, 5.0, 10.0)), key=lambda size: abs(math.log(size / raw)))
    begin = math.ceil(low / step - 1e-9)
    found: list[float] = []
    while (begin + len(found)) * step <= high + 1e-9 * step:
        found.append((begin + len(found)) * step)
    return found


def _named(low: float, high: float, count: int) -> list[tuple[float, str]]:
    """Round values inside a range, and their labels."""
    found = ticks(low, high, count)
    decimals = max(0, -math.floor(math.log10(found[1] - found[0]) + 1e-9)) if len(found) > 1 else 2
    return [(value, f"{value:.{decimals}f}".replace("-", "−") if abs(value) > 1e-12 else "0") for value in found]


def _span(values: Array) -> tuple[float, float]:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    room = 0.06 * (high - low) or 1.0
    return low - room, high + room


def _around(centre: float, width: float) -> tuple[float, float]:
    return centre - 0.5 * width, centre + 0.5 * width
