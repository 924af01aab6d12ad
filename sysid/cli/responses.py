"""Console table of what recordings show of each axis without a model."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sysid.cli.output import Printer
    from sysid.datasets import Dataset
    from sysid.datasets.quality.responses import AxisResponse, Direction


def show_responses(out: Printer, dataset: Dataset) -> list[dict[str, Any]]:
    """Print the responses of all axes; returns them as values for JSON."""
    from sysid.datasets.quality.responses import responses_of

    responses = responses_of(dataset)
    rows = [row for response in responses for row in _rows(response)]
    if rows:
        header = ("without a model", "delay", "command", "motion begins at", "speed at full")
        out.table(header, rows, right=(1, 3, 4))
    return [asdict(response) for response in responses]


def _rows(response: AxisResponse) -> list[tuple[str, ...]]:
    from sysid.display import NOTHING, interval
    from sysid.reports.sections.responses import begin_text

    delay = interval(*response.delay95, "s") if math.isfinite(response.delay) else NOTHING
    if response.positive is None or response.negative is None:
        return [(response.axis, delay, "", "", "")]
    unit = f"{response.unit}/s"
    return [
        (response.axis, delay, "positive", begin_text(response.positive), _speed(response.positive, unit)),
        ("", "", "negative", begin_text(response.negative), _speed(response.negative, unit)),
    ]


def _speed(direction: Direction, unit: str) -> str:
    from sysid.display import NOTHING, quantity

    return quantity(direction.full, unit) if math.isfinite(direction.full) else NOTHING
