"""The pictures at the top of the README: the crane of the demo, measured and simulated, before and after the repair.

    cd docs/images && python ../../pipelines/demo_picture.py WORKSPACE        (that of a finished `sysid demo`)

The crane is drawn in its own vertical plane, at the largest error of the tool in the held-out recording. Curves are the height
of the boom tip. tests/pipelines/test_first_look.py compares the pictures with those of the demo.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

import sysid
from sysid.display import quantity
from sysid.gap import GapResult
from sysid.machine import Machine
from sysid.pictures import DARK, HEIGHT, WIDTH, PictureCurve, svg

Array = npt.NDArray[np.float64]
#: Width of the drawing of one crane [px]; both stand left of the curves.
PANEL = 190
MEASURED, BEFORE, AFTER = "#30363c", "#d9822b", "#1a7f64"
#: Colour of the light picture → that of the dark one.
COLOURS = DARK | {BEFORE: "#f0883e", AFTER: "#3fb950"}
SIGNAL = "ee.z"


def pictures(dataset: sysid.Dataset, gap: GapResult) -> dict[str, str]:
    """File name → SVG, for light and dark pages."""
    light = picture(dataset, gap)
    dark = light
    for number, colour in enumerate(COLOURS):
        dark = dark.replace(colour, f"<{number}>")
    for number, colour in enumerate(COLOURS.values()):
        dark = dark.replace(f"<{number}>", colour)
    return {"demo-light.svg": light, "demo-dark.svg": dark}


def picture(dataset: sysid.Dataset, gap: GapResult) -> str:
    """Crane before, crane after, and curves, for a light page."""
    trace = gap.traces[0]
    tables = {"measured": trace.measured, "before": trace.before, "after": trace.after}
    row = _largest_error(trace.measured, trace.before)
    shapes = {key: crane(dataset.machine, table, trace.measured, row) for key, table in tables.items()}
    every = np.concatenate([point for shape in shapes.values() for point in shape])
    low, high = every.min(axis=0), every.max(axis=0)
    scale = min((PANEL - 30.0) / (high - low)[0], (HEIGHT - 85.0) / (high - low)[1])

    def place(points: Array, left: float) -> Array:
        return np.column_stack([left + 15.0 + (points[:, 0] - low[0]) * scale, HEIGHT - 30.0 - (points[:, 1] - low[1]) * scale])

    parts, width = [], 2 * PANEL + WIDTH
    for left, key, colour in ((0.0, "before", BEFORE), (float(PANEL), "after", AFTER)):
        parts += [_drawn([place(p, left) for p in shapes["measured"]], MEASURED, 7.0, 0.3)]
        parts += [_drawn([place(p, left) for p in shapes[key]], colour, 2.5, 1.0)]
        error = quantity(_distance(trace.measured, tables[key])[row], "m")
        parts += [_text(left + 15.0, 18.0, f"{key} the repair:"), _text(left + 15.0, 36.0, f"tool off by {error}")]
    errors = " → ".join(quantity(figures[SIGNAL], "m") for figures in (gap.gap.before, gap.gap.after))
    title = f"RMS error of the boom tip's height {errors}; noise {quantity(gap.gap.noise_floor[SIGNAL], 'm')}"
    time = trace.measured["time"].to_numpy() - trace.measured["time"].iloc[0]
    curves = [
        PictureCurve("simulated before", time, trace.before[SIGNAL].to_numpy(), BEFORE),
        PictureCurve("measured", time, trace.measured[SIGNAL].to_numpy(), MEASURED),
        PictureCurve("simulated after", time, trace.after[SIGNAL].to_numpy(), AFTER, dashed=True),
    ]
    curve = svg(title, f"time [s] · {title}", "height of the boom tip [m]", curves)
    look = 'font-family="sans-serif" font-size="11" role="img"'
    return "\n".join([
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {HEIGHT}" {look}>',
        f"<title>A recording that no fit has seen. {title}</title>",
        f'<rect width="{width}" height="{HEIGHT}" fill="#ffffff"/>',
        *parts,
        curve.replace("<svg ", f'<svg x="{2 * PANEL}" ', 1).rstrip(),
        "</svg>",
        "",
    ])  # fmt: skip


def crane(machine: Machine, table: pd.DataFrame, measured: pd.DataFrame, row: int) -> list[Array]:
    """Polylines (n, 2) of horizontal distance and height [m] in the measured plane: the arm, and the hanging tool.

    A joint that the table lacks is taken from ``measured``.
    """
    kinematics = machine.kinematics()
    assert kinematics is not None
    joints = [
        float((table if f"{name}.joint" in table else measured)[f"{name}.joint"].iloc[row]) for name in machine.axis_names
    ]
    poses = kinematics.link_poses(np.array([joints]))
    chain = np.array([pose[0, :3, 3] for pose in poses.values()])
    tip = np.array([float(table[f"ee.{letter}"].iloc[row]) for letter in "xyz"])
    tool = np.array([float(table[f"tool.{letter}"].iloc[row]) for letter in "xyz"])
    heading = np.array([float(measured[f"ee.{letter}"].iloc[row]) for letter in "xy"])
    heading /= np.linalg.norm(heading)

    def plane(points: Array) -> Array:
        return np.column_stack([points[:, :2] @ heading, points[:, 2]])

    foot = np.array([[0.0, 0.0, 0.0]])
    return [plane(np.concatenate([foot, chain, tip[None]])), plane(np.array([tip, tool]))]


def _drawn(lines: Sequence[Array], colour: str, width: float, opacity: float) -> str:
    texts = (" ".join(f"{x:.1f},{y:.1f}" for x, y in line) for line in lines)
    look = f'fill="none" stroke="{colour}" stroke-width="{width}" stroke-opacity="{opacity}" stroke-linecap="round"'
    return "\n".join(f'<polyline points="{text}" {look} stroke-linejoin="round"/>' for text in texts)


def _text(x: float, y: float, text: str) -> str:
    return f'<text x="{x:.0f}" y="{y:.0f}" font-size="14" fill="#30363c">{text}</text>'


def _distance(a: Mapping[str, pd.Series], b: Mapping[str, pd.Series]) -> Array:
    return np.sqrt(sum((a[f"tool.{letter}"].to_numpy() - b[f"tool.{letter}"].to_numpy()) ** 2 for letter in "xyz"))


def _largest_error(a: pd.DataFrame, b: pd.DataFrame) -> int:
    return int(np.nanargmax(_distance(a, b)))


if __name__ == "__main__":
    workspace = sysid.open(sys.argv[1])
    data = workspace.dataset("autolog")
    result = workspace.gap(data)
    assert result is not None
    for name, text in pictures(data, result).items():
        Path(name).write_text(text, "utf-8")
