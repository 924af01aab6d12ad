"""The verdict of the gap workflow as a sentence, the same in console, report, pages and Rerun recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sysid.gap.result import Missing

HEADLINES = {
    "no_gap": "The simulation agrees with the machine to within sensor noise.",
    "unnamed": "The simulation has an error that none of the known effects explains.",
    "ambiguous": "These recordings cannot distinguish the remaining candidate effects.",
    "insufficient_excitation": "The excitation is not sufficient to identify what the simulation lacks, if anything.",
}
_COUNTS = ("No", "One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight", "Nine")


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


def headline(verdict: str, effects: int) -> str:
    """The sentence.

    Args:
        effects: number of named effects.
    """
    if verdict != "named":
        return HEADLINES.get(verdict, verdict)
    count = _COUNTS[effects] if effects < len(_COUNTS) else str(effects)
    return f"{count} effect{' is' if effects == 1 else 's are'} missing from the simulation."
