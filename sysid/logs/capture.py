"""Shared by exports of motion capture: rows of numbers below a head, length units, rotations as unit quaternions."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid import scratch
from sysid.errors import InputError
from sysid.logs.reader import ALL, ReadOptions, Stream
from sysid.logs.table import CUT_ROW, text_chunks, without_line_end
from sysid.names import listed
from sysid.units import si_factor

_UNITS = {"meters": "m", "millimeters": "mm", "centimeters": "cm", "inches": "inch", "feet": "foot"}

#: Markers in a sentence; the others are counted.
MOST = 4

Array = npt.NDArray[np.float64]


def text_lines(path: Path, what: str) -> Iterator[str]:
    """Lines of a text file without their ends.

    Raises:
        InputError: the file is not UTF-8.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            for line in file:
                yield line.rstrip("\r\n")
    except UnicodeDecodeError as error:
        raise InputError(path, f"not UTF-8 text ({error.reason})", what) from None


def separator_of(line: str) -> str:
    """The separator of a line: the first tab, semicolon or comma in it."""
    return next((mark for mark in line if mark in "\t;,"), ",")


def number_of(text: str) -> float:
    """A number of a head, with a decimal point or comma.

    Raises:
        ValueError: it is none.
    """
    return float(text.replace(",", "."))


def number_rows(
    path: Path,
    width: int,
    first: int,
    separator: str,
    count: int | None = None,
    whole: bool = True,
    ragged: bool = False,
    stop: tuple[int, float] | None = None,
    columns: Sequence[int] | None = None,
    options: ReadOptions = ALL,
) -> tuple[Array, tuple[str, ...]]:
    """Rows of numbers from physical line ``first`` (0 is the first line) on: (n, width), NaN in empty cells, and the losses.

    Args:
        count: number of physical lines; None to the end of the file.
        whole: the rows end with the file, so that a last one without a line end may be cut and is dropped.
        ragged: rows may be longer than the head; cells beyond it are reported as lost.
        stop: column of the result, and the increase after which the rest of the file is skipped.
        columns: columns of the file in the result, increasing; None for all.
        options: of the reader.

    Raises:
        InputError: a row that is longer than the head and not ``ragged``; more values than the budget; two decimal marks.
    """
    budget = options.budget_of(path, "a text export")
    cells = width + 1  # one more than in the head, empty in every row that fits
    if ragged:
        cells = max(cells, *(line.count(separator) + 1 for line in islice(text_lines(path, "text"), first, None)), 0)
    budget.check_columns(path, cells - 1, "cells in a row")
    wanted = list(range(width) if columns is None else columns)
    losses: list[str] = []
    expected = _line_count(path) if count is None else count
    budget.check_numbers(path, expected * len(wanted))
    numbers = scratch.empty(expected * len(wanted)).reshape(expected, len(wanted))  # rows that are not there take no memory
    mark = _decimal_mark(path, first, separator)
    rows = too_long = texts = 0
    stopped = False
    expected_rows = f"{cells - 1} cells a row"
    for piece in text_chunks(
        path, cells, options.progress, "rows that do not fit the head", expected_rows,
        sep=separator, decimal=mark, skiprows=first, nrows=count, skip_blank_lines=count is None,
    ):  # fmt: skip
        if not len(piece):
            break
        longer = np.flatnonzero(piece[list(range(width, cells))].notna().any(axis=1).to_numpy())
        if len(longer) and not ragged:
            where = f"{path}: row {rows + int(longer[0]) + 1} below the head"
            remedy = "Repair the row, or export the take again."
            raise InputError(where, f"more than {width} cells", f"{width} cells a row", remedy)
        too_long += len(longer)
        table = piece[wanted]
        if not all(pd.api.types.is_numeric_dtype(kind) for kind in table.dtypes):
            read = table.apply(lambda column: pd.to_numeric(_with_points(column, mark), errors="coerce"))
            texts += _texts(path, table, read.isna() & table.notna(), rows, mark)
            table = read
        numbers[rows : rows + len(table)] = table.to_numpy(dtype=np.float64)
        rows += len(table)
        stopped = stop is not None and numbers[rows - 1, stop[0]] - numbers[0, stop[0]] > stop[1]
        if stopped:
            break
    if too_long:
        losses.append(f"{path.name}: {too_long} rows are longer than the head; what has no name has been left out")
    if texts:
        losses.append(f"{path.name}: {texts} cells are no numbers and are taken as missing")
    numbers = numbers[:rows]
    if whole and len(numbers) and not stopped and without_line_end(path):
        numbers = numbers[:-1]
        losses.append(f"{path.name}: {CUT_ROW}")
    return numbers, tuple(losses)


#: A number with a decimal comma, or a decimal point.
_NUMBER = {mark: re.compile(rf"\s*[+-]?\d*{re.escape(mark)}\d+([eE][+-]?\d+)?\s*") for mark in (",", ".")}
#: A number with any marks in it.
_OTHER_MARK = re.compile(r"\s*[+-]?\d[\d.,' ]*([eE][+-]?\d+)?\s*")
#: Rows in which the decimal mark is looked for.
_MARK_ROWS = 200


def _decimal_mark(path: Path, first: int, separator: str) -> str:
    """The decimal mark of the rows from line ``first`` on: a comma where the exporting computer writes one."""
    if separator == ",":
        return "."
    for line in islice(text_lines(path, "text"), first, first + _MARK_ROWS):
        for cell in line.split(separator):
            for mark, pattern in _NUMBER.items():
                if pattern.fullmatch(cell):
                    return mark
    return "."


def _with_points(column: pd.Series[Any], mark: str) -> pd.Series[Any]:
    """A column with texts, in which the parser leaves decimal commas: with points, and without what has a point."""
    if mark == "." or pd.api.types.is_numeric_dtype(column.dtype):
        return column
    return column.where(~column.astype(str).str.contains(".", regex=False)).str.replace(",", ".", regex=False)


def _texts(path: Path, table: pd.DataFrame, texts: pd.DataFrame, rows: int, mark: str) -> int:
    """Number of cells of ``table`` in the mask ``texts``, which are no numbers; ``rows``: number of rows before them.

    Raises:
        InputError: one of them is a number with another decimal mark, or with marks between its thousands.
    """
    mask = texts.to_numpy()
    found = table.to_numpy(dtype=object)[mask].astype(str)
    for text in np.unique(found):
        if _OTHER_MARK.fullmatch(text):
            row = int(np.argwhere(mask)[found == text][0, 0])
            where = f"{path}: row {rows + row + 1} below the head"
            expected = f"numbers with a decimal {'comma' if mark == ',' else 'point'} as above, without marks between thousands"
            raise InputError(where, repr(str(text)), expected, "Export it again with one decimal mark.")
    return len(found)


def _line_count(path: Path) -> int:
    """Number of lines of a text file; a line end within quotes counts, too."""
    with path.open("rb") as file:
        pieces = iter(lambda: file.read(2**20), b"")
        return 1 + sum(piece.count(b"\n") + piece.count(b"\r") - piece.count(b"\r\n") for piece in pieces)


def length_factor(path: Path, stated: str, options: ReadOptions, default: str | None = None) -> float:
    """Metres in the unit of length of the file, else of the recipe, else ``default``.

    Raises:
        InputError: no unit is stated, the recipe contradicts the file, or it is no unit of length.
    """
    if not stated and options.length_unit is None and default is None:
        remedy = 'State it in the recipe: `length_unit = "m"` (or "mm", "cm").'
        raise InputError(path, "the file states no length unit", "a unit such as m or mm", remedy)
    unit = _UNITS.get(stated.lower(), stated) if stated else str(options.length_unit or default)
    if stated and options.length_unit is not None and si_factor(unit, path) != si_factor(options.length_unit, path):
        expected = f"[{options.length_unit}] as in the recipe"
        raise InputError(path, f"the file states [{stated}]", expected, "Correct the recipe.")
    factor, si = si_factor(unit, path)
    if si != "m":
        raise InputError(path, f"a length unit of [{si}]", "a unit of length such as m or mm")
    return factor


def without_lost(path: Path, streams: Sequence[Stream]) -> tuple[Stream, ...]:
    """``streams`` of markers and bodies without the frames in which they lie exactly in the origin, and the loss.

    Programs write zeros for what the cameras have lost; a measured position has digits, so that three exact zeros are none,
    not even where they fill every frame. Streams without a position [m] (angles and forces of a model) stay as they are.
    """
    kept: list[Stream] = []
    lost: dict[str, int] = {}
    for stream in streams:
        zero = np.zeros(len(stream), dtype=bool)
        if all(stream.units.get(axis) == "m" for axis in "xyz"):
            zero = np.all([stream.columns[axis] == 0.0 for axis in "xyz"], axis=0)
        if not zero.any():
            kept.append(stream)
            continue
        lost[stream.name] = int(np.count_nonzero(zero))
        columns = {key: np.where(zero, np.nan, values) for key, values in stream.columns.items()}
        kept.append(replace(stream, columns=columns))
    if not lost:
        return tuple(kept)
    names = [f"{name} {count}" for name, count in sorted(lost.items(), key=lambda item: -item[1])]
    text = f"{path.name}: {sum(lost.values())} points exactly in the origin are treated as not visible: {listed(names, MOST)}"
    return tuple(replace(stream, losses=(*stream.losses, text)) for stream in kept)


def unique_names(names: list[str]) -> list[str]:
    """``names`` with a number behind repeated ones."""
    seen: dict[str, int] = {}
    result = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        result.append(name if seen[name] == 1 else f"{name}#{seen[name]}")
    return result


def euler_order(rotation: str | None) -> str | None:
    """``XYZ`` … ``ZYX`` from the text of a header or recipe (``Euler XYZ``); None where it names no order."""
    match = re.search(r"\b([XYZ]{3})\b", (rotation or "").upper())
    return match[1] if match is not None and sorted(match[1]) == ["X", "Y", "Z"] else None


def from_matrices(matrices: Array) -> Array:
    """Rotation matrices (n, 3, 3) → quaternions x y z w (n, 4); NaN where a matrix is no rotation (tolerance 0.02)."""
    result = np.full((len(matrices), 4), np.nan)
    with np.errstate(invalid="ignore"):
        residual = np.abs(np.einsum("nij,nkj->nik", matrices, matrices) - np.eye(3)).max(axis=(1, 2))
        good = (residual < 0.02) & (np.linalg.det(np.nan_to_num(matrices)) > 0.0)
    if good.any():
        from scipy.spatial.transform import Rotation

        result[good] = Rotation.from_matrix(matrices[good]).as_quat()
    return result


def quaternion_columns(quaternions: Array) -> dict[str, Array]:
    """``qx`` … ``qw`` of quaternions x y z w (n, 4), normalised; NaN where they are no rotation."""
    with np.errstate(invalid="ignore"):
        norm = np.linalg.norm(quaternions, axis=1)
        unit = np.where((np.abs(norm - 1.0) < 0.05)[:, None], quaternions / norm[:, None], np.nan)
    return {f"q{axis}": unit[:, i] for i, axis in enumerate("xyzw")}
