"""Qualisys TSV exports: markers (3D) and rigid bodies (6D) → streams on the capture clock.

Head lines ``NAME<tab>values``, perhaps a line of column names, then one row a frame; frame and time columns are optional.
Markers: ``x y z``. Bodies: position, three angles, residual, and the rotation matrix column by column (``Rot[0] … Rot[8]``),
which alone is used: the angles follow settings that the file does not state. Millimetres. What is not visible is empty or zero.
Source: Qualisys Track Manager documentation, "Motion data (.tsv)" and "6DOF data (.tsv)".
"""

from __future__ import annotations

import re
from itertools import islice
from pathlib import Path

import numpy as np

from sysid.errors import InputError
from sysid.logs.capture import (
    Array,
    from_matrices,
    length_factor,
    number_of,
    number_rows,
    quaternion_columns,
    text_lines,
    unique_names,
    without_lost,
)
from sysid.logs.reader import LogReader, ReadOptions, Stream
from sysid.logs.table import to_ns

_WHAT = "a Qualisys TSV export"
_NAMES = {"3D": "MARKER_NAMES", "6D": "BODY_NAMES"}
_CELLS = {"3D": 3, "6D": 16}


class QualisysReader(LogReader):
    """Streams have the name of the marker or body in Qualisys Track Manager."""

    name = "qualisys"
    clocks = ("capture",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        budget = options.budget_of(path, _WHAT)
        head, columns, first = _head(path)
        kind = next(iter(head.get("DATA_INCLUDED", [])), "")
        if kind not in _NAMES:
            raise InputError(path, f"DATA_INCLUDED {kind!r}", "'3D' or '6D'", "Export again with the header on.")
        names = unique_names([name for name in head.get(_NAMES[kind], []) if name])
        budget.check_topics(path, len(names), "markers and bodies")
        options.check_streams(path, names, "marker or body")
        cells = _CELLS[kind]
        before = _before(path, columns, cells * len(names), first)
        if not names or before not in (0, 1, 2):
            expected = f"{cells} for each of {len(names)} names, frame and time"
            found = f"{before + cells * len(names)} columns"
            raise InputError(f"{path}: line {first + 1}", found, expected, "Export it again.")
        width = before + cells * len(names)
        table, losses = number_rows(path, width, first, "\t", options=options)
        if not len(table):
            raise InputError(path, "a header but no frames", "at least one frame", "Export it again.")
        stamps = {"capture": to_ns(_seconds(path, table, before, head), 1.0, f"{path}: time")}
        factor = length_factor(path, "", options, "mm")
        streams = []
        for number, name in enumerate(names):
            if options.wants(name):
                own = table[:, before + number * cells : before + (number + 1) * cells]
                values = {axis: own[:, i] * factor for i, axis in enumerate("xyz")} if kind == "3D" else _body(own, factor)
                units = {key: "m" for key in values if key in ("x", "y", "z", "error")}
                what = "Marker" if kind == "3D" else "Rigid Body"
                streams.append(Stream(name, path, stamps, values, units, losses, kind=what))
        return without_lost(path, streams)


def _head(path: Path) -> tuple[dict[str, list[str]], list[str], int]:
    """Name → values of the head, the line of column names (may be empty), and the number of lines before the first row."""
    head: dict[str, list[str]] = {}
    columns: list[str] = []
    for number, line in enumerate(text_lines(path, _WHAT)):
        cells = [cell.strip() for cell in line.split("\t")]
        if number == 0 and cells[0] not in ("NO_OF_FRAMES", "FILE_VERSION"):
            raise InputError(
                path, f"first cell {cells[0][:40]!r}", "'NO_OF_FRAMES' or 'FILE_VERSION'", "Export with the header."
            )
        if number > 10_000:
            break
        if not any(cells) and (len(cells) < 3 or head.keys().isdisjoint(_NAMES.values())):
            continue  # behind the names it is a row in which nothing is visible
        if all(map(_is_number, filter(None, cells))):
            return head, columns, number
        if re.fullmatch(r"[A-Z0-9]+(_[A-Z0-9]+)+|FREQUENCY|DESCRIPTION|EVENT", cells[0]):
            if cells[0] != "EVENT":
                head.setdefault(cells[0], cells[1:])
        else:
            columns = cells
    raise InputError(path, "a header but no frames", "at least one frame", "Export it again.")


def _is_number(cell: str) -> bool:
    try:
        number_of(cell)
    except ValueError:
        return False
    return True


#: Rows in which the last column is looked for.
_ROWS = 100


def _before(path: Path, columns: list[str], cells: int, first: int) -> int:
    """Number of columns (frame, time) in front of the ``cells`` of the names.

    The line of column names has them. Without it the rows are counted, which may end with an empty cell after a last tab, or in
    which the last marker may not be visible.
    """
    if columns:
        return next((place for place, name in enumerate(columns) if name not in ("Frame", "Time")), len(columns))
    rows = [line.rstrip(" ").split("\t") for line in islice(text_lines(path, _WHAT), first, first + _ROWS)]
    width = max(map(len, rows))
    ends = all(not row[-1] for row in rows if len(row) == width) and width > cells
    return width - ends - cells


def _seconds(path: Path, table: Array, before: int, head: dict[str, list[str]]) -> Array:
    if before == 2:
        return table[:, 1]
    rate = next(iter(head.get("FREQUENCY", [])), "")
    try:
        period = 1.0 / number_of(rate)
    except (ValueError, ZeroDivisionError):
        expected = "a rate in Hz, or a time column"
        raise InputError(f"{path}: FREQUENCY", repr(rate), expected, "Export again with the time column.") from None
    frames = table[:, 0] - 1.0 if before == 1 else np.arange(len(table), dtype=np.float64)
    return np.asarray(frames * period)


def _body(cells: Array, factor: float) -> dict[str, Array]:
    # Column by column: Rot[1] is the second row of the first column.
    quaternions = from_matrices(np.swapaxes(cells[:, 7:16].reshape(-1, 3, 3), 1, 2))
    position = {axis: cells[:, i] * factor for i, axis in enumerate("xyz")}
    return {**position, **quaternion_columns(quaternions), "error": cells[:, 6] * factor}
