"""OptiTrack Motive CSV exports: rigid bodies (and named markers) → streams on the capture clock.

A first line of ``key,value`` pairs, five head rows (type, name, id, channel, axis; some versions add a parent), then one row
a frame; a body that was not seen has empty cells. Rigid body columns: ``x y z`` [m], unit quaternion ``qx qy qz qw`` (active,
body to capture frame), ``error`` [m] where exported. Marker columns: ``x y z`` [m].
Source: exports of versions 1.21, 1.22 and 1.23; OptiTrack documentation, "Data Export: CSV".
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.errors import InputError, nearest
from sysid.logs.reader import ReadOptions
from sysid.logs.stream import Stream
from sysid.logs.table import check_not_empty, to_ns
from sysid.units import si_factor

VERSIONS = ("1.21", "1.22", "1.23")
_UNITS = {"meters": "m", "millimeters": "mm", "centimeters": "cm", "inches": "inch", "feet": "foot"}
_MARKERS = ("Marker", "Rigid Body Marker")

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Column:
    kind: str
    name: str
    channel: str
    axis: str


@dataclass(frozen=True)
class MotiveReader:
    """The file says neither its suffix nor much else: name it in the recipe with ``reader = "motive"``."""

    name: str = "motive"
    suffixes: tuple[str, ...] = ()
    clocks: tuple[str, ...] = ("capture",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        check_not_empty(path, "a Motive CSV export")
        header, columns, rows = _head(path)
        factor = _length_factor(path, header, options)
        rotation = options.rotation or header.get("Rotation Type")
        space = header.get("Coordinate Space", "Global")
        if space != "Global":
            raise InputError(path, f"coordinate space {space!r}", "'Global'", "Export again with world coordinates.")
        table, losses = _numbers(path, len(columns), rows)
        stamps = {"capture": to_ns(table[:, 1], 1.0, f"{path}: Time")}
        streams = []
        names = dict.fromkeys(column.name for column in columns if column.kind in ("Rigid Body", *_MARKERS))
        for wanted in sorted(options.streams or ()):
            if wanted not in names:
                raise InputError(path, f"no rigid body {wanted!r}", nearest(wanted, names), "Correct the recipe.")
        for name in names:
            own = [(index, column) for index, column in enumerate(columns) if column.name == name]
            if name.startswith("Unlabeled") or (options.streams is not None and name not in options.streams):
                continue
            values = _channels(path, table, own, factor, rotation)
            units = dict.fromkeys((key for key in values if not key.startswith("q")), "m")
            streams.append(Stream(name, path, stamps, values, units, losses))
        return tuple(streams)


def _head(path: Path) -> tuple[dict[str, str], list[_Column], int]:
    """Key-value pairs of the first line, the columns from the third on (index 0 = column 2), number of head lines."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = csv.reader(file)
            first = next(lines, [])
            if not first or first[0] != "Format Version":
                found = f"first cell {first[0] if first else ''!r}"
                raise InputError(path, found, "'Format Version'", "Export the take as CSV from Motive, with the header on.")
            header = dict(zip(first[0::2], first[1::2], strict=False))
            version = header["Format Version"]
            if version not in VERSIONS:
                raise InputError(
                    path, f"format version {version!r}", f"one of {', '.join(VERSIONS)}", "Export the take with one of these."
                )
            head: list[list[str]] = []
            for row in lines:
                if row and row[0] == "Frame":
                    return header, _columns(path, head, row), lines.line_num
                if any(row):
                    head.append(row)
                if len(head) > 8:
                    break
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(path, f"not readable as CSV ({error})", "a Motive CSV export") from None
    raise InputError(path, "no row that starts with 'Frame'", "the head of a Motive CSV export")


def _columns(path: Path, head: list[list[str]], axes: list[str]) -> list[_Column]:
    if len(head) < 4:
        raise InputError(path, f"{len(head)} head rows", "type, name, id and channel", "Export again with all headers on.")
    kinds, names, channels = head[0], head[1], head[-1]
    width = len(axes)
    rows = [row + [""] * (width - len(row)) for row in (kinds, names, channels)]
    kinds, names, channels = rows
    return [_Column(kinds[i].strip(), names[i].strip(), channels[i].strip(), axes[i].strip()) for i in range(2, width)]


def _length_factor(path: Path, header: dict[str, str], options: ReadOptions) -> float:
    stated = header.get("Length Units", "").strip()
    if not stated and options.length_unit is None:
        raise InputError(
            path,
            "the header states no length unit",
            "'Length Units'",
            'State it in the recipe: `length_unit = "m"` (or "mm", "cm").',
        )
    unit = _UNITS.get(stated.lower(), stated) if stated else str(options.length_unit)
    if stated and options.length_unit is not None and si_factor(unit, path) != si_factor(options.length_unit, path):
        raise InputError(
            path, f"the header states {stated}", f"[{options.length_unit}] as the recipe says", "Correct the recipe."
        )
    factor, si = si_factor(unit, path)
    if si != "m":
        raise InputError(path, f"a length unit of [{si}]", "a unit of length such as m or mm")
    return factor


def _numbers(path: Path, width: int, rows: int) -> tuple[Array, tuple[str, ...]]:
    """All cells as numbers (n, width + 2); a last row without a line end may be cut and is left out."""
    try:
        table = pd.read_csv(
            path, header=None, skiprows=rows, names=list(range(width + 2)), index_col=False, encoding="utf-8-sig"
        )
    except (pd.errors.ParserError, pd.errors.ParserWarning, pd.errors.EmptyDataError) as error:
        raise InputError(path, f"rows that do not fit the head ({error})", f"{width + 2} cells a row") from None
    numbers = table.apply(pd.to_numeric, errors="coerce").to_numpy(dtype=np.float64)
    losses: tuple[str, ...] = ()
    with path.open("rb") as file:
        file.seek(-1, 2)
        if file.read(1) != b"\n" and len(numbers):
            numbers = numbers[:-1]
            losses = (f"{path.name}: the last row has no line end and may be cut: left out",)
    if not len(numbers):
        raise InputError(path, "a header but no frames", "at least one frame", "Export the take again.")
    return numbers, losses


def _channels(
    path: Path, table: Array, columns: list[tuple[int, _Column]], factor: float, rotation: str | None
) -> dict[str, Array]:
    position: dict[str, Array] = {}
    angles: dict[str, Array] = {}
    values: dict[str, Array] = {}
    for index, column in columns:
        cells = table[:, index + 2]
        if column.channel == "Position" and column.axis in ("X", "Y", "Z"):
            position.setdefault(column.axis.lower(), cells * factor)
        elif column.channel == "Rotation" and column.axis in ("X", "Y", "Z", "W"):
            angles.setdefault(column.axis, cells)
        elif column.channel in ("Mean Marker Error", "Error Per Marker"):
            values["error"] = cells * factor
    quaternion = _quaternion(path, columns[0][1].name, angles, rotation)
    return {**position, **quaternion, **values}


def _quaternion(path: Path, body: str, angles: dict[str, Array], rotation: str | None) -> dict[str, Array]:
    if not angles:
        return {}
    if "W" in angles:
        stacked = np.column_stack([angles[axis] for axis in "XYZW"])
    else:
        order = (rotation or "").upper().replace("EULER", "").strip()
        if sorted(order) != ["X", "Y", "Z"]:
            raise InputError(
                f"{path}: {body}",
                f"Euler angles, rotation type {rotation!r}" if rotation else "Euler angles without a stated order",
                "an order such as XYZ",
                'State it in the recipe: `rotation = "XYZ"`, or export quaternions.',
            )
        stacked = _from_euler(np.column_stack([angles[axis] for axis in order]), order)
    with np.errstate(invalid="ignore"):
        norm = np.linalg.norm(stacked, axis=1)
        stacked = np.where((np.abs(norm - 1.0) < 0.05)[:, None], stacked / norm[:, None], np.nan)
    return {f"q{axis}": stacked[:, i] for i, axis in enumerate("xyzw")}


def _from_euler(degrees: Array, order: str) -> Array:
    """Rotations about the body's own axes in ``order``, (n, 3) [deg] → quaternions x y z w (n, 4)."""
    result = np.tile([0.0, 0.0, 0.0, 1.0], (len(degrees), 1))
    for column, axis in enumerate(order):
        half = np.deg2rad(degrees[:, column]) / 2.0
        turn = np.zeros((len(degrees), 4))
        turn[:, "XYZ".index(axis)] = np.sin(half)
        turn[:, 3] = np.cos(half)
        result = multiply(result, turn)
    return result


def multiply(a: Array, b: Array) -> Array:
    """Quaternion product (x, y, z, w), (n, 4) each: first ``b``, then ``a``."""
    vector = a[:, 3:] * b[:, :3] + b[:, 3:] * a[:, :3] + np.cross(a[:, :3], b[:, :3])
    scalar = a[:, 3] * b[:, 3] - np.sum(a[:, :3] * b[:, :3], axis=1)
    return np.column_stack([vector, scalar])
