"""Numbers that stand for "no value" and are still among the values: nothing else about the axis can be checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sysid.datasets.plausibility.finding import MOST, Cause, Evidence, Finding
from sysid.names import listed
from sysid.signals import split_signal

_REMEDY = (
    "Where it means that there is no value, write `missing = [{}]` into the entry of the signal in the recipe; without a "
    "recipe, `sysid ingest --inspect PATH --draft recipe.toml` writes one. Then ingest again"
)


def sentinel_findings(flags: Sequence[Mapping[str, Any]]) -> dict[str, Finding]:
    """Axis or point → finding, for each with a ``sentinel`` flag.

    Args:
        flags: ``quality["flags"]`` of a dataset.
    """
    found: dict[str, list[Mapping[str, Any]]] = {}
    for flag in flags:
        if flag["kind"] == "sentinel":
            found.setdefault(split_signal(flag["signal"])[0], []).append(flag)
    return {owner: _finding(own) for owner, own in found.items()}


def _finding(flags: Sequence[Mapping[str, Any]]) -> Finding:
    signals = tuple(dict.fromkeys(flag["signal"] for flag in flags))
    evidence = [Evidence(f"{flag['signal']}: {flag['text']}", "measured values") for flag in flags]
    numbers = dict.fromkeys(flag["text"].partition(" ")[0] for flag in flags)
    cause = Cause(listed([*numbers], MOST) + " in", signals, "no measurement", remedy=_REMEDY.format(", ".join(numbers)))
    recordings = tuple(dict.fromkeys(flag["recording"] for flag in flags))
    return Finding(tuple(f"{signal}:sentinel" for signal in signals), "severe", tuple(evidence[:MOST]), (cause,), recordings)
