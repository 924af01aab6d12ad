"""OptiTrack Motive CSV exports: rigid bodies, bones and markers → streams on the capture clock.

A first line of ``key,value`` pairs, head rows (type, name, id, parent, channel, axis; not every version has them all, some
are labelled in their second cell), then one row a frame; a body that is not visible has empty cells. Body columns:
``x y z`` [m], unit quaternion ``qx qy qz qw`` (active, body to capture frame), ``error`` [m] where exported. Marker columns:
``x y z`` [m], ``quality`` where exported.

Version 1.1 (Motive before 1.6, Tracking Tools) is another format: every line is a record of the kind in its first cell.
``rigidbody,name,id,…`` names a body; ``frame,index,seconds,bodies,(id x y z qx qy qz qw yaw pitch roll)…,markers,(x y z id
name)…`` is one frame. What is not visible is not listed, or has a value with ``#`` (``-1.#IND``).

Source: exports of versions 1.2 to 1.25; OptiTrack documentation, "Data Export: CSV", and of version 1.1 the "comment" lines.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from sysid.errors import InputError
from sysid.logs.capture import Array, euler_order, length_factor, number_rows, quaternion_columns, without_lost
from sysid.logs.limits import Budget, missing_frames
from sysid.logs.reader import LogReader, ReadOptions, Stream
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


#: Versions of the table format (1.1 has records). A later one is read like the last of these, with a note.
VERSIONS = ("1.2", "1.20", "1.21", "1.22", "1.23", "1.24", "1.25")
_LATER = re.compile(r"1\.(2[6-9]|[3-9]\d)")
_BODIES = ("Rigid Body", "Bone")
_MARKERS = ("Marker", "Rigid Body Marker", "Bone Marker")
EXPORTED = "Total Exported Frames"
_KEYS = ("Format Version", "Rotation Type", "Length Units", "Coordinate Space", EXPORTED)
_ROWS = ("Type", "Name", "ID", "Parent")


@dataclass(frozen=True)
class _Column:
    index: int
    kind: str
    name: str
    channel: str
    axis: str


@dataclass(frozen=True)
class _Head:
    """Settings of the first line; columns with data; index of the time; cells in a row; lines of the head; notes."""

    stated: Mapping[str, str]
    columns: tuple[_Column, ...]
    time: int
    width: int
    lines: int
    unread: tuple[str, ...]


class MotiveReader(LogReader):
    """Streams have the name of the rigid body, bone or marker in Motive."""

    name = "motive"
    clocks = ("capture",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        budget = options.budget_of(path, "a Motive CSV export")
        if _first_cell(path).lower() in RECORD_TYPES:
            return read_records(path, options, budget)
        head = _head(path)
        factor = length_factor(path, head.stated.get("Length Units", ""), options)
        space = head.stated.get("Coordinate Space", "Global")
        if space not in ("Global", ""):
            raise InputError(path, f"coordinate space {space!r}", "'Global'", "Export again with world coordinates.")
        names = list(dict.fromkeys(column.name for column in head.columns))
        budget.check_topics(path, len(names), "rigid bodies and markers")
        options.check_streams(path, names, "rigid body or marker")
        chosen = [column for column in head.columns if options.wants(column.name)]
        used = sorted({head.time, *(column.index for column in chosen)})
        time = used.index(head.time)
        stop = (time, options.seconds) if options.seconds is not None else None
        table, losses = number_rows(path, head.width, head.lines, ",", stop=stop, columns=used, options=options)
        losses = (*losses, *head.unread)
        if options.seconds is None:
            losses += missing_frames(path, head.stated.get(EXPORTED, ""), len(table))
        if not len(table):
            raise InputError(path, "a header but no frames", "at least one frame", "Export the take again.")
        stamps = {"capture": to_ns(table[:, time], 1.0, f"{path}: Time")}
        streams = []
        for name in names:
            own = [replace(column, index=used.index(column.index)) for column in chosen if column.name == name]
            if not own:
                continue
            values = _values(path, table, own, factor, options.rotation or head.stated.get("Rotation Type"))
            units = {key: "m" for key in values if key in ("x", "y", "z", "error")}
            streams.append(Stream(name, path, stamps, values, units, losses, kind=own[0].kind))
        return without_lost(path, streams)

    def unstated(self, path: Path) -> dict[str, str]:
        """``length_unit`` and ``rotation``."""
        if _first_cell(path).lower() in RECORD_TYPES:
            return {"length_unit": "m"}
        head = _head(path)
        result = {} if head.stated.get("Length Units") else {"length_unit": "m"}
        angles = {column.axis for column in head.columns if column.channel == "Rotation"}
        if angles and "W" not in angles and euler_order(head.stated.get("Rotation Type")) is None:
            result["rotation"] = "XYZ"
        return result


def _first_cell(path: Path) -> str:
    with path.open("rb") as file:
        return re.split(r"[,\r\n]", file.read(64).decode("utf-8-sig", errors="replace"))[0].strip().strip('"')


def _head(path: Path) -> _Head:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = csv.reader(file)
            first = [cell.strip() for cell in next(lines, [])]
            if not first or first[0] != "Format Version":
                found = f"first cell {first[0] if first else ''!r}"
                raise InputError(path, found, "'Format Version'", "Export the take as CSV from Motive, with the header on.")
            # By name, not in pairs, because notes and take names may contain commas.
            header = {key: first[first.index(key) + 1] for key in _KEYS if key in first[:-1]}
            version = header.get("Format Version", "")
            unread = []
            if _LATER.fullmatch(version):
                unread.append(f"{path.name}: format version {version} is newer than {VERSIONS[-1]} and has been read like it")
            elif version not in VERSIONS:
                expected = f"1.1 or one of {', '.join(VERSIONS)}"
                raise InputError(path, f"format version {version!r}", expected, "Export the take with one of these.")
            head: list[list[str]] = []
            for row in lines:
                cells = [cell.strip() for cell in row]
                if cells and cells[0] == "Frame":
                    columns, time, others = _columns(path, head, cells)
                    if others:
                        unread.append(f"{path.name}: columns of type {', '.join(others)} are not read")
                    width = max(len(cells), 1 + max(column.index for column in columns))
                    return _Head(header, tuple(columns), time, width, lines.line_num, tuple(unread))
                if any(cells):
                    head.append(cells)
                if len(head) > 8:
                    break
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(path, f"not readable as CSV ({error})", "a Motive CSV export") from None
    raise InputError(path, "no row that starts with 'Frame'", "the head of a Motive CSV export")


def _columns(path: Path, head: list[list[str]], axes: list[str]) -> tuple[list[_Column], int, list[str]]:
    if len(head) < 3:
        raise InputError(path, f"{len(head)} head rows", "type, name and channel", "Export again with all headers on.")
    labelled = {row[1]: row for row in head if len(row) > 1 and row[1] in _ROWS}
    kinds, names, channels = labelled.get("Type", head[0]), labelled.get("Name", head[1]), head[-1]
    time = next((i for i, axis in enumerate(axes) if axis.lower().startswith("time") and "code" not in axis.lower()), None)
    if time is None:
        raise InputError(path, "no column 'Time'", "frame and time in front", "Export again with all headers on.")

    def at(row: list[str], index: int) -> str:
        return row[index] if index < len(row) else ""

    # Solved and reconstructed markers, or two assets, may have the same name but differ in type or id.
    numbers = labelled.get("ID", head[2] if len(head) > 3 else [])
    objects: dict[tuple[str, str, str], str] = {}
    columns = []
    for index in range(time + 1, len(axes)):
        kind, name = at(kinds, index), at(names, index)
        if kind not in (*_BODIES, *_MARKERS) or not name:
            continue
        key = (kind, name, at(numbers, index))
        if key not in objects:
            twins = [other for other in objects if other[1] == name]
            label = name if not twins else f"{name} ({kind})" if all(other[0] != kind for other in twins) else ""
            objects[key] = label or f"{name}#{len(twins) + 1}"
        columns.append(_Column(index, kind, objects[key], at(channels, index), axes[index]))
    others = sorted({kind for kind in kinds[time + 1 :] if kind} - {*_BODIES, *_MARKERS})
    if not columns:
        found = ", ".join(others) or "no columns"
        raise InputError(path, f"only {found}", f"one of: {', '.join((*_BODIES, *_MARKERS))}", "Export these, too.")
    return columns, time, others


def _values(path: Path, table: Array, columns: list[_Column], factor: float, rotation: str | None) -> dict[str, Array]:
    position: dict[str, Array] = {}
    angles: dict[str, Array] = {}
    values: dict[str, Array] = {}
    for column in columns:
        cells = table[:, column.index]
        if column.channel == "Position" and column.axis in ("X", "Y", "Z"):
            position.setdefault(column.axis.lower(), cells * factor)
        elif column.channel == "Rotation" and column.axis in ("X", "Y", "Z", "W"):
            angles.setdefault(column.axis, cells)
        elif column.channel in ("Mean Marker Error", "Error Per Marker"):
            values["error"] = cells * factor
        elif column.channel == "Marker Quality":
            values["quality"] = cells
    where = f"{path}: {columns[0].name}"
    _check_axes(where, "position", position, "xyz")
    return {**position, **_rotation(where, angles, rotation), **values}


def _check_axes(where: str, what: str, found: Mapping[str, Array], axes: str) -> None:
    """Raise where some but not all axes of ``what`` are exported."""
    if found and not set(axes) <= found.keys():
        raise InputError(where, f"{what} {', '.join(found)}", ", ".join(axes), "Export the take again.")


def _rotation(where: str, angles: Mapping[str, Array], rotation: str | None) -> dict[str, Array]:
    if not angles:
        return {}
    _check_axes(where, "rotation", angles, "XYZ")
    if "W" in angles:
        return quaternion_columns(np.column_stack([angles[axis] for axis in "XYZW"]))
    order = euler_order(rotation)
    if order is None:
        found = f"Euler angles, rotation type {rotation!r}" if rotation else "Euler angles without a stated order"
        remedy = 'State it in the recipe: `rotation = "XYZ"`, or export quaternions.'
        raise InputError(where, found, "an order such as XYZ", remedy)
    from scipy.spatial.transform import Rotation

    rotations = Rotation.from_euler(order, np.column_stack([angles[axis] for axis in order]), degrees=True)
    return quaternion_columns(rotations.as_quat())
