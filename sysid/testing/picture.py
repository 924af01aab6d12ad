"""Small line pictures as SVG, the same on every machine: coordinates are rounded to a tenth of a pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 640, 240, 64, 12, 26, 36


@dataclass(frozen=True)
class Line:
    """One curve: ``x`` and ``y`` (n,), NaN breaks it."""

    label: str
    x: Array
    y: Array
    colour: str
    dashed: bool = False


def svg(title: str, x_label: str, y_label: str, lines: Sequence[Line], equal: bool = False) -> str:
    """The picture as text; ``equal`` gives both axes the same scale."""
    x = np.concatenate([line.x for line in lines])
    y = np.concatenate([line.y for line in lines])
    (x0, x1), (y0, y1) = (float(np.nanmin(x)), float(np.nanmax(x))), _span(y)
    wide, high = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM
    if equal:
        scale = max((x1 - x0) / wide, (y1 - y0) / high)
        x0, x1 = _around(0.5 * (x0 + x1), scale * wide)
        y0, y1 = _around(0.5 * (y0 + y1), scale * high)

    def place(xs: Array, ys: Array) -> str:
        stride = max(1, len(xs) // 350)  # finer than a picture can show
        xs, ys = xs[::stride], ys[::stride]
        px = LEFT + (xs - x0) / (x1 - x0) * wide
        py = TOP + (y1 - ys) / (y1 - y0) * high
        return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(px, py, strict=True) if a == a and b == b)

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" '
        'font-family="sans-serif" font-size="11" role="img">',
        f"<title>{escape(title)}</title>",
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>',
        f'<rect x="{LEFT}" y="{TOP}" width="{wide}" height="{high}" fill="none" stroke="#c8ccd0"/>',
    ]
    for k, value in enumerate((x0, 0.5 * (x0 + x1), x1)):
        anchor = ("start", "middle", "end")[k]
        parts.append(
            f'<text x="{LEFT + k * wide / 2:.1f}" y="{HEIGHT - 20}" text-anchor="{anchor}" fill="#555b61">{value:.3g}</text>'
        )
    for k, value in enumerate((y1, 0.5 * (y0 + y1), y0)):
        parts.append(
            f'<text x="{LEFT - 6}" y="{TOP + k * high / 2 + 4:.1f}" text-anchor="end" fill="#555b61">{value + 0.0:.3g}</text>'
        )
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


def _span(values: Array) -> tuple[float, float]:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    room = 0.06 * (high - low) or 1.0
    return low - room, high + room


def _around(centre: float, width: float) -> tuple[float, float]:
    return centre - 0.5 * width, centre + 0.5 * width
