"""Rows of the result: times measured alternately on one computer, as ratios above 1 where `sysid` is better."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any


def seconds(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def in_process(script: Path, *arguments: str, **settings: Any) -> dict[str, Any]:
    """The last line that ``script`` prints in a new process, as JSON; ``settings`` of :func:`subprocess.run`.

    Raises:
        SystemExit: it failed.
    """
    done = subprocess.run([sys.executable, str(script), *arguments], capture_output=True, text=True, **settings)  # noqa: PLW1510
    if done.returncode != 0:
        raise SystemExit(f"{script.name} {arguments[0]} failed:\n{done.stderr.strip()}")
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


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
    """One row; ``ours`` and ``theirs`` are pairs in ``unit``, measured one after the other."""
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
    """One row against a goal."""
    return row(work, f"limit of {limit:g} {unit}", ours, [limit] * len(ours), unit, note, more_is_better)
