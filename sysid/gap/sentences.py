"""Sentences about a gap result, the same in console, report, pages and Rerun recording."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from sysid.display import interval, quantity

if TYPE_CHECKING:
    from sysid.gap.response_difference import ResponseDifference
    from sysid.gap.result import CommandOrder, Missing


def left_out_sentence(left_out: Sequence[str]) -> str:
    """What the machine's description contains and the simulation does not; empty where that is nothing."""
    if not left_out:
        return ""
    return (
        f"The description of the machine also contains: {'; '.join(left_out)}. An effect that is found there may stand for it."
    )


def missing_sentences(missing: Sequence[Missing]) -> list[str]:
    """What could not be computed after the effects were decided."""
    return [
        f"Missing from this result: {item.part}. {item.reason[:1].upper()}{item.reason[1:].rstrip('.')}." for item in missing
    ]


def order_sentence(order: CommandOrder | None) -> str:
    """The estimated order of command and sample, and what it leaves open; empty where it is stated or without influence."""
    if order is None or order.source == "stated":
        return ""
    first = {
        "read_before_written": "the sample of a row is read before its command acts",
        "written_before_read": "the command of a row has acted for a whole period when its sample is read",
    }[order.convention]
    row = quantity(order.open_s, "s")
    return (
        f"Order of command and sample, as the motion shows it: {first}. A dead time up to one row ({row}) gets no name, and a "
        "named one may be one row longer. If you know the order, state it in machine.toml: "
        f'convention = "{order.convention}".'
    )


def response_sentences(differences: Sequence[ResponseDifference], repaired: bool) -> list[str]:
    """What the recordings show without a model and the simulation does not, one sentence an axis."""
    whose = "the repaired simulation" if repaired else "the simulation"
    by_axis: dict[str, list[str]] = {}
    for item in differences:
        by_axis.setdefault(item.axis, []).append(_response_text(item))
    return [f"Without a model {axis} differs from {whose}: {'; '.join(texts)}." for axis, texts in by_axis.items()]


def _response_text(item: ResponseDifference) -> str:
    recorded, simulated = (_range_text(item, values) for values in (item.recorded, item.simulated))
    if item.quantity == "delay":
        return f"it follows its command after {recorded}, simulated {simulated}"
    if item.quantity == "begins":
        return f"{item.side} commands move it {recorded}, simulated {simulated}"
    return f"its speed at full {item.side} command is {recorded}, simulated {simulated}"


def _range_text(item: ResponseDifference, values: tuple[float, float]) -> str:
    if item.quantity == "begins":
        if math.isnan(values[1]):
            return f"not at all up to {values[0]:.2g}"
        return f"from less than {values[1]:.2g}" if values[0] == 0.0 else f"from {values[0]:.2g} to {values[1]:.2g}"
    return quantity(values[0], item.unit) if values[0] == values[1] else interval(*values, item.unit)
