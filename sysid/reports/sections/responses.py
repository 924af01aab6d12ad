"""What the recordings show of each axis without any model: delay, where motion begins, speed over the command by direction."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from markupsafe import Markup

from sysid import display
from sysid.datasets.quality.responses import AxisResponse, Direction, responses_of
from sysid.reports.charts import ChartCurve, chart
from sysid.reports.inputs import ReportInputs


def context(inputs: ReportInputs) -> dict[str, Any] | None:
    found = responses_of(inputs.dataset)
    shown = [_axis(response) for response in found if math.isfinite(response.delay)]
    return {"axes": shown, "unknown": [each.axis for each in found if not math.isfinite(each.delay)]} if shown else None


def _axis(response: AxisResponse) -> dict[str, Any]:
    sides = [("positive", response.positive), ("negative", response.negative)]
    return {
        "name": response.axis,
        "delay": display.interval(*response.delay95, "s"),
        "sides": [side_texts(name, side, response.unit) for name, side in sides if side is not None],
        "picture": _picture(response),
    }


def side_texts(name: str, side: Direction, unit: str) -> dict[str, str]:
    """One direction of the command: its ``name``, where motion ``begins``, the speed at ``full``."""
    full = display.quantity(side.full, f"{unit}/s") if math.isfinite(side.full) else display.NOTHING
    return {"name": name, "begins": _begins(side), "full": full}


def _begins(side: Direction) -> str:
    """Between which commands motion begins."""
    still, moving = side.begins
    if math.isnan(still):
        return display.NOTHING
    if math.isnan(moving):
        return f"none up to {display.number(still, 2)}"
    if still == 0.0:
        return f"below {display.number(moving, 2)}"
    return f"{display.number(still, 2)} … {display.number(moving, 2)}"


def _picture(response: AxisResponse) -> Markup:
    """Speed over the command; empty without bins."""
    bins = [
        (sign * item.command, sign * item.speed)
        for sign, side in ((-1.0, response.negative), (1.0, response.positive))
        if side is not None
        for item in side.bins
    ]
    if len(bins) < 2:
        return Markup("")
    command, speed = np.array(sorted(bins)).T
    curve = ChartCurve(display.shown_unit(f"{response.unit}/s")[0] * speed, "measured", dots=True)
    return Markup(chart(command, [curve], ("command", display.with_unit("speed", f"{response.unit}/s"))))
