"""Rows of the result: times of neighbours taken in turn on one machine, as ratios above 1 where ours is better."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any


def seconds(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def in_turns(works: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, list[float]]:
    """Times [s] of each, one after the other in every repeat, after one run of each that does not count."""
    for work in works.values():
        work()
    taken: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(repeats):
        for name, work in works.items():
            taken[name].append(seconds(work))
    return taken


def row(
    work: str,
    peer: str,
    ours: Sequence[float],
    theirs: Sequence[float],
    unit: str = "s",
    note: str = "",
    more_is_better: bool = False,
) -> dict[str, Any]:
    """One row; ``ours`` and ``theirs`` are pairs in ``unit``, taken one beside the other."""
    pairs = list(zip(ours, theirs, strict=True))
    ratios = [mine / other if more_is_better else other / mine for mine, other in pairs]
    found = {
        "work": work,
        "peer": peer,
        "ratio": {"min": min(ratios), "median": statistics.median(ratios), "max": max(ratios)},
        "ours": statistics.median(ours),
        "theirs": statistics.median(theirs),
        "unit": unit,
    }
    return {**found, "note": note} if note else found


def against_limit(
    work: str, ours: Sequence[float], limit: float, unit: str, note: str = "", more_is_better: bool = False
) -> dict[str, Any]:
    """One row beside what was set as the goal."""
    return row(work, f"limit of {limit:g} {unit}", ours, [limit] * len(ours), unit, note, more_is_better)
