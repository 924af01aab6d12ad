"""The ratios of earlier commits, and which of them have fallen."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

#: Largest fall of a ratio against the last measurement on the same kind of computer.
FALL = 0.15

Row = Mapping[str, Any]


def ratios_of(rows: Sequence[Row]) -> dict[str, float]:
    """``work|peer`` → median ratio; rows of the same work and peer are told apart by what they were measured with."""
    found: dict[str, float] = {}
    for row in rows:
        bag = row.get("bag")
        where = ", ".join(str(bag[key]) for key in ("content", "messages", "read")) if bag else row.get("note", "")
        key = f"{row['work']}|{row['peer']}"
        found[f"{key}|{where}" if key in found or bag else key] = round(row["ratio"]["median"], 4)
    return found


def fallen(rows: Sequence[Row], machine: str, history: Sequence[Mapping[str, Any]]) -> list[str]:
    """Ratios to other tools that are lower by more than :data:`FALL` than when last measured on the same kind of computer.

    Ratios to a limit are none: they contain the speed of the computer.
    """
    earlier: dict[str, tuple[float, str]] = {}
    for entry in history:
        if entry["machine"] == machine:
            earlier |= {key: (ratio, entry["commit"]) for key, ratio in entry["ratios"].items()}
    return [
        f"{key}: {ratio:.3g}, was {earlier[key][0]:.3g} at {earlier[key][1]}"
        for key, ratio in ratios_of(rows).items()
        if "|limit of " not in key and key in earlier and ratio < (1.0 - FALL) * earlier[key][0]
    ]


def read_history(path: Path) -> list[dict[str, Any]]:
    """Commit, date, computer and ratios of each measurement, the oldest first."""
    found: list[dict[str, Any]] = json.loads(path.read_text("utf-8"))["measured"] if path.exists() else []
    return found


def write_history(path: Path, history: Sequence[Mapping[str, Any]], head: Row, rows: Sequence[Row]) -> None:
    """The history with the ratios of ``rows``, under the ``head`` of the last measurement as in every committed result."""
    entry = {key: head[key] for key in ("commit", "date", "machine")} | {"ratios": ratios_of(rows)}
    path.write_text(json.dumps({**head, "measured": [*history, entry]}, indent=1) + "\n", "utf-8")
