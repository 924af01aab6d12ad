"""The tables of ``reports/networks/README.md``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from committed import markdown
from learned.actuators import AXES, DIRECTIONS, SEEDS, SIZES
from learned.forward import BEST, NO_NETWORKS, PAPER
from learned.pictures import ACTUATOR, FORWARD, TITLES
from learned.poses import RANGES
from sysid.networks import PAPER_MAX

Row = Mapping[str, Any]

INPUTS = {"joints": "true", "captured": "motion capture's", "own": "the machine's sensors'"}


def tables(result: Mapping[str, Any]) -> str:
    return "\n\n".join(
        [
            "500 training poses, errors of x / y / z on 1000 test poses [mm]; mean of five seeds (worst seed).",
            _variants(result["variants"]),
            "The same models, evaluated at measured joint values: largest / 95 % error, the worst of x, y, z [mm].",
            _by_inputs(result["variants"]),
            "![Learning curves of the forward models](forward.svg)",
            f"Actuator networks of the shipped logs, {SIZES[-1]} rows, mean of {len(SEEDS)} seeds: in held-out motion against"
            " the measurement, and over the whole stroke against the crane's true linkage [mrad, mm].",
            _actuators(result["actuators"]),
            "![Learning curves of the actuator networks](actuators.svg)",
            "Forward models of the shipped logs, seed 0, against the measurement [mm]; held out: the last 50 of 500"
            " poses, and recording `manual-06`.",
            _shipped(result["shipped"]),
        ]
    )


def _variants(rows: Sequence[Row]) -> str:
    head = [text for reach in RANGES for text in (f"{TITLES[reach]}: max", "mean")]
    own, lines = [row for row in rows if row["asked"] == "joints"], []
    for model in dict.fromkeys(row["model"] for row in own):
        found = {row["range"]: row for row in own if row["model"] == model}
        cells = [
            cell
            for row in (found[reach] for reach in RANGES)
            for cell in (f"{_three(row['max'])} ({_three(row['max_worst'])})", _three(row["mean"]))
        ]
        lines.append((model if model in NO_NETWORKS else f"256-128: {model}", *cells))
    lines.append(("*the paper, its own crane and poses*", *[_three(PAPER_MAX.values()), "–"] * len(RANGES)))
    return markdown(("", *head), lines, "l" * (len(head) + 1))


def _by_inputs(rows: Sequence[Row]) -> str:
    names = [f"{TITLES[reach]}: {joints} joints" for reach in RANGES for joints in INPUTS.values()]
    lines = []
    for model in (PAPER.label, BEST.label, *NO_NETWORKS):
        cells = []
        for reach in RANGES:
            for inputs in INPUTS:
                (row,) = (r for r in rows if (r["range"], r["model"], r["asked"]) == (reach, model, inputs))
                cells.append(f"{_mm(max(row['max']))} / {_mm(max(row['p95']))}")
        lines.append((FORWARD.get(model, model), *cells))
    return markdown(("", *names), lines)


def _actuators(rows: Sequence[Row]) -> str:
    head = ["RMSE, motion", "max, motion", "sensor noise", "RMSE, stroke", "max, stroke"]
    keys = ("motion_rmse", "motion_max", "sensors", "stroke_rmse", "stroke_max")
    lines = [
        (f"{axis} {direction.replace('_', ' ')}", ACTUATOR.get(row["model"], row["model"]), *(_mm(row[key]) for key in keys))
        for axis in AXES
        for direction in DIRECTIONS
        for row in rows
        if (row["axis"], row["direction"], row["rows"]) == (axis, direction, SIZES[-1])
    ]
    return markdown(("", "", *head), lines, "ll")


def _shipped(rows: Sequence[Row]) -> str:
    lines = []
    for recipe in dict.fromkeys(row["recipe"] for row in rows):
        cells = []
        for kind in ("poses", "motion"):
            own = [row for row in rows if (row["recipe"], row["rows"]) == (recipe, kind)]
            cells += [_three(row[key] for row in own) for key in ("max", "rmse")]
        lines.append((f"`{recipe}`" if "=" in recipe and "both" not in recipe else recipe, *cells))
    return markdown(("recipe", "max, poses", "RMSE, poses", "max, motion", "RMSE, motion"), lines, "lllll")


def _three(values: Any) -> str:
    return " / ".join(map(_mm, values))


def _mm(value: float) -> str:
    """m → mm, or rad → mrad, with two significant digits."""
    shown = 1e3 * value
    return f"{shown:.{0 if shown >= 99.5 else 1 if shown >= 1.0 else 2 if shown >= 0.1 else 3}f}"
