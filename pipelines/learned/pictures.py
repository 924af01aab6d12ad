"""Learning curves of the networks and of simpler models."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from learned.actuators import AXES, DIRECTIONS
from learned.forward import BEST, PAPER, SIZES
from learned.poses import RANGES
from log_picture import COLOURS, Curve, Panel, picture

Row = Mapping[str, Any]

TITLES = {"full": "full joint ranges", "part": "slew ±45°, middle 70 % of the others"}
FORWARD = {
    PAPER.label: "256-128 of the paper",
    BEST.label: "256-128 of products, smooth",
    "chain": "chain",
    "structured": "structured",
    "polynomial, degree 3": "polynomial, degree 3",
    "gradient boosting": "gradient boosting",
    "nearest neighbour": "nearest neighbour",
}
ACTUATOR = {
    "network, relu": "network of the paper",
    "network, smooth": "network, smooth",
    "linkage geometry": "linkage geometry",
    "polynomial, degree 5": "polynomial, degree 5",
    "gradient boosting": "gradient boosting",
    "nearest neighbour": "nearest neighbour",
}


def pictures(result: Mapping[str, Any]) -> dict[str, str]:
    """File name → SVG."""
    forward = []
    for key, what in (("max", "largest error of x, y, z [mm]"), ("rmse", "RMSE [mm]")):
        for reach in RANGES:
            rows = [row for row in result["forward"] if row["range"] == reach]
            curves = _curves(rows, FORWARD, "poses", lambda row, key=key: 1e3 * max(row[key]))  # type: ignore[misc]
            forward.append(Panel(f"{what}, {TITLES[reach]}", curves, {size: str(size) for size in SIZES}))
    actuators = []
    for axis in AXES:
        for direction in DIRECTIONS:
            unit = "mrad" if direction == "to_joint" else "mm"
            rows = [row for row in result["actuators"] if (row["axis"], row["direction"]) == (axis, direction)]
            curves = _curves(rows, ACTUATOR, "rows", lambda row: 1e3 * row["stroke_rmse"])
            title = f"{axis}, {direction.replace('_', ' ')}: RMSE over the true stroke [{unit}]"
            ticks = {row["rows"]: str(row["rows"]) for row in rows}
            actuators.append(Panel(title, curves, ticks, {"noise of one measurement": 1e3 * rows[0]["sensors"]}))
    return {"forward.svg": picture(forward), "actuators.svg": picture(actuators)}


def _curves(rows: Sequence[Row], models: Mapping[str, str], over: str, value: Callable[[Row], float]) -> list[Curve]:
    found = []
    for colour, (model, label) in zip(COLOURS, models.items(), strict=False):
        own = [row for row in rows if row["model"] == model]
        found.append(Curve(label, colour, [row[over] for row in own], [value(row) for row in own]))
    return found
