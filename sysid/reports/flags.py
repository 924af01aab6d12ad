"""Flags of ingest as text: one line per event with its signals, the most severe kinds first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sysid.reports import words

#: Kinds with wrong values before kinds with missing values.
_ORDER = ("marker_swap", "jump", "outlier", "stuck", "saturation", "stamps", "dropout", "jitter")


@dataclass(frozen=True)
class FlagLine:
    """One event in one or more signals."""

    recording: str
    kind: str
    signals: str
    from_s: float
    to_s: float
    text: str


def flag_lines(flags: Sequence[Mapping[str, Any]]) -> list[FlagLine]:
    """``quality["flags"]`` of a dataset version as lines; an event of several signals is one line."""
    events: dict[tuple[str, str, float, float, str], list[str]] = {}
    for flag in flags:
        key = (str(flag["recording"]), str(flag["kind"]), float(flag["from_s"]), float(flag["to_s"]), str(flag["text"]))
        events.setdefault(key, []).append(words.signal_name(str(flag["signal"])))
    ordered = sorted(events.items(), key=lambda item: (_rank(item[0][1]), item[0][0], item[0][2]))
    return [
        FlagLine(recording, kind.replace("_", " "), _listed(names), begin, end, text)
        for (recording, kind, begin, end, text), names in ordered
    ]


def kinds_of(lines: Sequence[FlagLine]) -> str:
    """``4 × marker swap, 23 × dropout``."""
    return ", ".join(f"{count} × {kind}" for kind, count in Counter(line.kind for line in lines).items())


def _rank(kind: str) -> int:
    return _ORDER.index(kind) if kind in _ORDER else 0


def _listed(names: Sequence[str]) -> str:
    """All names, or the first two and the number of others."""
    unique = list(dict.fromkeys(names))
    return ", ".join(unique) if len(unique) <= 3 else f"{', '.join(unique[:2])} and {len(unique) - 2} more"
