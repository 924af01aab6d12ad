"""Sentences about a gap result, the same in console, report, pages and Rerun recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from sysid.display import quantity

if TYPE_CHECKING:
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
