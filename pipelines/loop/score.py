"""The rounds of one machine as a result, compared with its sealed truth."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from loop.flight import Flight
from loop.rounds import Round
from sysid.gap import GapResult

Name = tuple[str, str]


def read_truth(path: Path) -> list[dict[str, Any]]:
    """The hidden effects of :func:`loop.sealed.write_truth`."""
    hidden: list[dict[str, Any]] = json.loads(path.read_text("utf-8"))["hidden"]
    return hidden


def machine_result(name: str, hidden: Sequence[Mapping[str, Any]], rounds: Sequence[Round]) -> dict[str, Any]:
    """The entry of one machine.

    ``missed``: hidden effects that no round named; ``adjusted``: those of them that a repair contains without a name.
    """
    names = [(str(each["name"]), str(each["target"])) for each in hidden]
    named = {name for each in rounds for name in _named(each.gap, names)}
    adjusted = {(item.name, item.target) for each in rounds if each.gap for item in each.gap.written if item.kind == "adjusted"}
    missed = [each for each in names if each not in named]
    return {
        "name": name,
        "hidden": [dict(each) for each in hidden],
        "missed": missed,
        "adjusted": [each for each in missed if each in adjusted],
        "wrong": sorted(named - set(names)),
        "rounds": [_round(each) for each in rounds],
    }


def _named(gap: GapResult | None, hidden: Sequence[Name]) -> list[Name]:
    """Named effects; one that is an exact alias of a hidden effect under the name of that."""
    found = []
    for effect in gap.effects if gap is not None else ():
        own = [(effect.name, effect.target), *effect.aliases]
        found.append(next((name for name in own if name in hidden), own[0]))
    return found


def _round(each: Round) -> dict[str, Any]:
    gap = each.gap
    row: dict[str, Any] = {
        "plant": each.plant,
        **figures_of(each.flights),
        "simulation": figures_of(each.simulated),
        "seconds": dict(each.seconds),
        "cpu_seconds": each.cpu_seconds,
        "experiments": list(each.experiments),
    }
    if gap is None:
        return {**row, "named": [], "promoted": False}
    return {
        **row,
        "dataset": gap.dataset,
        "named": [{"name": e.name, "target": e.target, "parameters": dict(e.given)} for e in gap.effects],
        "ambiguous": [[list(name) for name in tie] for tie in gap.ambiguous],
        "verdict": gap.verdict,
        "promoted": gap.promotion is not None and gap.promotion.promoted,
        "gap": {"before": dict(gap.gap.before), "after": dict(gap.gap.after), "noise_floor": dict(gap.gap.noise_floor)},
    }


def figures_of(flights: Mapping[str, Flight]) -> dict[str, Any]:
    """Path → figures."""
    return {path: flight.figures() for path, flight in flights.items()}
