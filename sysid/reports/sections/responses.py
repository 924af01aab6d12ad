"""What the recordings show of each axis without any model: delay, where motion begins, speed over the command by direction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from sysid import display
from sysid.datasets.quality.responses import BLOCK_S, AxisResponse, Direction, responses_of
from sysid.figures import Table
from sysid.reports.charts import ChartCurve, captioned, chart
from sysid.reports.inputs import ReportInputs


def context(inputs: ReportInputs) -> dict[str, Any] | None:
    found = responses_of(inputs.dataset)
    shown = [response for response in found if math.isfinite(response.delay)]
    pictures = [picture for response in shown if (picture := _picture(response))]
    unknown = [response.axis for response in found if not math.isfinite(response.delay)]
    return {"figures": response_table(shown, "Axis"), "pictures": pictures, "unknown": unknown} if shown else None


def response_table(responses: Sequence[AxisResponse], title: str) -> Table:
    """Axis and delay of its motion; where there are valves, for each direction its name, where motion begins, the full speed.

    Args:
        title: of the column of the axes.
    """
    rows: list[tuple[str, ...]] = []
    for response in responses:
        delay, parts = (
            display.interval(*ends, "s") if math.isfinite(ends[0]) else display.NOTHING
            for ends in (response.delay95, response.delays90)
        )
        sides = (("positive", response.positive), ("negative", response.negative))
        texts = [_side(name, side, response.unit) for name, side in sides if side is not None] or [("", "", "")]
        rows += [(response.axis, delay, parts, *texts[0]), *(("", "", "", *text) for text in texts[1:])]
    header = (title, "delay", f"in parts of {BLOCK_S:.0f} s", "command", "motion begins at", "speed at full")
    if all(response.positive is None for response in responses):
        return Table(header[:3], [row[:3] for row in rows], (1, 2))
    return Table(header, rows, (1, 2, 4, 5))


def _side(name: str, side: Direction, unit: str) -> tuple[str, str, str]:
    full = display.quantity(side.full, f"{unit}/s") if math.isfinite(side.full) else display.NOTHING
    return name, _begins(side), full


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
    drawn = chart(command, [curve], ("command", display.with_unit("speed", f"{response.unit}/s")))
    return captioned(drawn, f"{response.axis}: speed over the command")
