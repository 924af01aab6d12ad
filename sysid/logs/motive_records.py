"""OptiTrack CSV of version 1.1 (Motive before 1.6, Tracking Tools): every line is a record of the kind in its first cell.

``rigidbody,name,id,…`` names a body; ``frame,index,seconds,bodies,(id x y z qx qy qz qw yaw pitch roll)…,markers,(x y z id
name)…`` is one frame. What is not visible is not listed, or has a value with ``#`` (``-1.#IND``).
Source: OptiTrack documentation of that time, "comment" lines of the exports.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sysid.errors import InputError
from sysid.logs.capture import Array, length_factor, quaternion_columns, without_lost
from sysid.logs.cut_off import missing_frames
from sysid.logs.limits import Budget
from sysid.logs.reader import ReadOptions
from sysid.logs.stream import Stream
from sysid.logs.table import to_ns

#: First cell of an export of this version.
RECORD_TYPES = ("comment", "info", "righthanded", "lefthanded")
_BODY_CELLS, _MARKER_CELLS = 11, 5


@dataclass
class _Take:
    stated: str = ""
    names: dict[str, str] = field(default_factory=dict)
    seconds: list[float] = field(default_factory=list)
    #: Body or marker → [(frame, numbers)].
    bodies: dict[str, list[tuple[int, list[float]]]] = field(default_factory=dict)
    markers: dict[str, list[tuple[int, list[float]]]] = field(default_factory=dict)


def read_records(path: Path, options: ReadOptions, budget: Budget) -> tuple[Stream, ...]:
    """All streams of an export of version 1.1.

    Raises:
        InputError: another version, left-handed coordinates, a line that is cut, no length unit in the recipe.
    """
    factor = length_factor(path, "", options)
    take = _Take()
    losses: list[str] = []
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            for number, row in enumerate(csv.reader(file), start=1):
                try:
                    _record(path, row, take)
                    budget.check_topics(path, len(take.bodies) + len(take.markers), "rigid bodies and markers")
                except (ValueError, IndexError):
                    losses.append(f"{path.name}: line {number} is cut or damaged and has been left out")
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(path, f"not readable as CSV ({error})", "a Motive CSV export") from None
    if not take.seconds:
        raise InputError(path, "no frames", "at least one frame", "Export the take again.")
    options.check_streams(path, [*take.bodies, *take.markers], "rigid body or marker")
    losses += missing_frames(path, take.stated, len(take.seconds))
    names = [name for name in (*take.bodies, *take.markers) if options.wants(name)]
    budget.check_numbers(path, 7 * len(names) * len(take.seconds))
    stamps = {"capture": to_ns(np.array(take.seconds), 1.0, f"{path}: Time")}
    makers: list[tuple[str, dict[str, list[tuple[int, list[float]]]], Callable[[Array], dict[str, Array]]]] = [
        ("Rigid Body", take.bodies, lambda table: {**_position(table, factor), **quaternion_columns(table[:, 3:7])}),
        ("Marker", take.markers, lambda table: _position(table, factor)),
    ]
    streams = []
    for kind, objects, columns in makers:
        for name, seen in objects.items():
            if options.wants(name):
                table = np.full((len(take.seconds), 7), np.nan)
                for frame, numbers in seen:
                    table[frame, : len(numbers)] = numbers
                units = dict.fromkeys("xyz", "m")
                streams.append(Stream(name, path, stamps, columns(table), units, tuple(losses[-20:]), kind=kind))
    return without_lost(path, streams)


def _position(table: Array, factor: float) -> dict[str, Array]:
    return {axis: table[:, i] * factor for i, axis in enumerate("xyz")}


def _record(path: Path, row: list[str], take: _Take) -> None:
    kind = row[0].strip().lower() if row else ""
    if kind == "lefthanded":
        raise InputError(path, "left-handed coordinates", "right-handed ones", "Export the take again.")
    if kind == "info" and row[1].strip().lower() == "version" and row[2].strip() != "1.1":
        raise InputError(path, f"format version {row[2]!r}", "1.1 for a file of records", "Export the take again.")
    if kind == "info" and row[1].strip().lower() == "framecount":
        take.stated = row[2]
    if kind == "rigidbody" and len(row) > 3 and not row[1].strip().isdecimal():
        take.names[row[2].strip()] = row[1].strip()
    elif kind == "frame":
        _frame(row, take)


def _frame(row: list[str], take: _Take) -> None:
    frame, at = len(take.seconds), 4
    seconds, bodies = float(row[2]), int(row[3])
    seen: list[tuple[dict[str, list[tuple[int, list[float]]]], str, list[float]]] = []
    for _ in range(bodies):
        cells = row[at : at + _BODY_CELLS]
        name = take.names.get(cells[0].strip(), f"body {cells[0].strip()}")
        seen.append((take.bodies, name, [_number(cell) for cell in cells[1:8]]))
        at += _BODY_CELLS
    markers = int(row[at])
    for start in range(at + 1, at + 1 + markers * _MARKER_CELLS, _MARKER_CELLS):
        cells = row[start : start + _MARKER_CELLS]
        name = cells[4].strip() or f"marker {cells[3].strip()}"
        seen.append((take.markers, name, [_number(cell) for cell in cells[:3]]))
    take.seconds.append(seconds)
    for objects, name, numbers in seen:
        objects.setdefault(name, []).append((frame, numbers))


def _number(cell: str) -> float:
    return float("nan") if "#" in cell or not cell.strip() else float(cell)
