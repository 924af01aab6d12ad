"""The tables of ``docs/networks.md``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from learned.actuators import AXES, DIRECTIONS, SEEDS, SIZES
from learned.forward import BEST, NO_NETWORKS, PAPER
from learned.pictures import ACTUATOR, FORWARD, TITLES
from learned.poses import RANGES
from sysid.networks import PAPER_MAX

Row = Mapping[str, Any]

ASKED = {"joints": "true", "captured": "motion capture's", "own": "the machine's sensors'"}


def tables(result: Mapping[str, Any]) -> str:
    return "\n\n".join(
        [
            "500 training poses, errors of x / y / z on 1000 test poses [mm]; mean of five seeds (worst seed).",
            _variants(result["variants"]),
            "The same models, evaluated at measured joint values: largest / 95 % error, the worst of x, y, z [mm].",
            _asked(result["variants"]),
            "![Learning curves of the forward models](../reports/networks/forward.svg)",
            f"Actuator networks of the shipped logs, {SIZES[-1]} rows, mean of {len(SEEDS)} seeds: in held-out motion against"
            " the measurement, and over the whole stroke against the crane's true linkage [mrad, mm].",
            _actuators(result["actuators"]),
            "![Learning curves of the actuator networks](../reports/networks/actuators.svg)",
            "Forward models of the shipped logs, seed 0, against the measurement [mm]; held out: the last 50 of 500"
            " poses, and recording `manual-06`.",
            _shipped(result["shipped"]),
        ]
    )


def _variants(rows: Sequence[Row]) -> str:
    lines = [f"| | {' | '.join(f'{TITLES[reach]}: max | mean' for reach in RANGES)} |", "| --- |" + " --- |" * 2 * len(RANGES)]
    own = [row for row in rows if row["asked"] == "joints"]
    for model in dict.fromkeys(row["model"] for row in own):
        cells = [
            f"{_three(row['max'])} ({_three(row['max_worst'])}) | {_three(row['mean'])}"
            for reach in RANGES
            for row in own
            if (row["range"], row["model"]) == (reach, model)
        ]
        lines.append(f"| {model if model in NO_NETWORKS else f'256-128: {model}'} | {' | '.join(cells)} |")
    paper = " | ".join([_three(PAPER_MAX.values()), "–"] * len(RANGES))
    lines.append(f"| *the paper, its own crane and poses* | {paper} |")
    return "\n".join(lines)


def _asked(rows: Sequence[Row]) -> str:
    names = [f"{TITLES[reach]}: {said} joints" for reach in RANGES for said in ASKED.values()]
    lines = [f"| | {' | '.join(names)} |", "| --- |" + " ---: |" * len(names)]
    for model in (PAPER.label, BEST.label, *NO_NETWORKS):
        cells = []
        for reach in RANGES:
            for asked in ASKED:
                (row,) = (r for r in rows if (r["range"], r["model"], r["asked"]) == (reach, model, asked))
                cells.append(f"{_mm(max(row['max']))} / {_mm(max(row['p95']))}")
        lines.append(f"| {FORWARD.get(model, model)} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _actuators(rows: Sequence[Row]) -> str:
    head = ["RMSE, motion", "max, motion", "sensor noise", "RMSE, stroke", "max, stroke"]
    lines = [f"| | | {' | '.join(head)} |", "| --- | --- |" + " ---: |" * len(head)]
    keys = ("motion_rmse", "motion_max", "sensors", "stroke_rmse", "stroke_max")
    for axis in AXES:
        for direction in DIRECTIONS:
            own = [r for r in rows if (r["axis"], r["direction"], r["rows"]) == (axis, direction, SIZES[-1])]
            for row in own:
                cells = " | ".join(_mm(row[key]) for key in keys)
                lines.append(f"| {axis} {direction.replace('_', ' ')} | {ACTUATOR.get(row['model'], row['model'])} | {cells} |")
    return "\n".join(lines)


def _shipped(rows: Sequence[Row]) -> str:
    lines = ["| recipe | max, poses | RMSE, poses | max, motion | RMSE, motion |", "| --- | --- | --- | --- | --- |"]
    for recipe in dict.fromkeys(row["recipe"] for row in rows):
        cells = []
        for kind in ("poses", "motion"):
            own = [row for row in rows if (row["recipe"], row["rows"]) == (recipe, kind)]
            cells += [_three(row[key] for row in own) for key in ("max", "rmse")]
        name = f"`{recipe}`" if "=" in recipe and "both" not in recipe else recipe
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _three(values: Any) -> str:
    return " / ".join(map(_mm, values))


def _mm(value: float) -> str:
    """m → mm, or rad → mrad, with two digits that count."""
    shown = 1e3 * value
    return (
        f"{shown:.0f}"
        if shown >= 99.5
        else f"{shown:.1f}"
        if shown >= 1.0
        else f"{shown:.2f}"
        if shown >= 0.1
        else f"{shown:.3f}"
    )
