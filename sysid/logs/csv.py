"""CSV: one header row, one time column, numbers; an empty cell is a missing value. Comma, semicolon or tab.

Cells that hold a list, ``"[0.1, 0.2]"`` under ``positions``, become columns of their own: ``positions[0]``, ``positions[1]``.
"""

from __future__ import annotations

import csv as csv_module
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.errors import InputError
from sysid.logs.growing import Growing
from sysid.logs.limits import MAX_CELLS, check_whole
from sysid.logs.reader import ReadOptions
from sysid.logs.stream import Stream
from sysid.logs.table import CUT_ROW, Columns, table_stream, without_line_end
from sysid.units import split_header

#: Cells that are parsed at a time.
_CELLS = 2**20


@dataclass(frozen=True)
class CsvReader:
    """Headers are canonical names (``boom.cylinder [mm]``) or whatever the recipe maps."""

    name: str = "csv"
    suffixes: tuple[str, ...] = (".csv", ".tsv", ".txt")
    clocks: tuple[str, ...] = ("time",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        columns, losses = self.columns(path)
        return (table_stream(path, columns, options, losses),)

    def columns(self, path: Path) -> tuple[Columns, tuple[str, ...]]:
        """Header → numbers, in the order of the file, and what was lost."""
        check_whole(path, "a CSV file with one header row")
        headers, separator, skipped = _header(path)
        cells = [_Cells() for _ in headers]
        rows = 0
        losses = [f"{path.name}: {CUT_ROW}"] if without_line_end(path) else []
        for table in _pieces(path, headers, separator, skipped):
            longer = np.flatnonzero(table[len(headers)].notna().to_numpy())
            if len(longer):
                where, expected = f"{path}: row {rows + int(longer[0]) + 1} below the header", "as many cells as the header has"
                raise InputError(where, f"more than {len(headers)} cells", expected, "Repair the row.")
            for index, column in enumerate(cells):
                column.take(table[index])
            rows += len(table)
        columns: list[tuple[str, npt.NDArray[np.float64]]] = []
        if not rows:
            losses = []
        for header, column in zip(headers, cells, strict=True):
            if column.are_lists:
                elements, lost = _elements(path, header, column.strings(rows))
                columns += elements
                losses += lost
                continue
            numbers = column.numbers.whole(rows)
            if column.text and np.isnan(numbers).all():
                continue  # a column of labels
            if column.text:
                losses.append(f"{path.name}: column {header!r}: {column.text} cells are not numbers")
            columns.append((header, numbers))
        return columns, tuple(losses)


@dataclass
class _Cells:
    """One column as it is read. ``text``: cells that are no numbers, ``listed`` of them in pieces of nothing but lists."""

    numbers: Growing = field(default_factory=lambda: Growing(np.nan))
    text: int = 0
    listed: int = 0
    lists: list[pd.Series] = field(default_factory=list)
    filled: int = 0

    def take(self, cells: pd.Series) -> None:
        """The next rows; their index is their place in the file."""
        filled = cells.notna().to_numpy()
        numbers = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=np.float64)
        self.numbers.extend(numbers)
        text = int(np.count_nonzero(np.isnan(numbers) & filled))
        self.text += text
        self.filled += int(np.count_nonzero(filled))
        if text and _are_lists(cells):
            self.lists.append(cells)
            self.listed += text

    @property
    def are_lists(self) -> bool:
        """Whether every cell that is not empty is a list in brackets."""
        return 0 < self.listed == self.filled

    def strings(self, rows: int) -> pd.Series:
        """All cells of a column of lists."""
        column: pd.Series = pd.concat(self.lists).reindex(range(rows))
        return column


def _pieces(path: Path, headers: list[str], separator: str, skipped: int) -> Iterator[pd.DataFrame]:
    """The rows, some thousands at a time, numbered from 0 on; without a last one that is cut."""
    before: pd.DataFrame | None = None
    try:
        # One column more than the header has: it is empty in every row that fits.
        with pd.read_csv(
            path, sep=separator, skiprows=skipped, header=None, names=list(range(len(headers) + 1)), index_col=False,
            skipinitialspace=True, na_values=["", "NaN", "nan", "None"], encoding="utf-8-sig", low_memory=False,
            chunksize=max(1, _CELLS // (len(headers) + 1)),
        ) as pieces:  # fmt: skip
            while (piece := _next(pieces)) is not None:
                if before is not None:
                    yield before
                before = piece
    except (pd.errors.ParserError, UnicodeDecodeError) as error:
        raise InputError(
            path, f"not readable as CSV ({' '.join(str(error).split())})", "rows with as many cells as the header has"
        ) from None
    if before is not None:
        yield before.iloc[:-1] if without_line_end(path) else before


def _next(pieces: Iterator[pd.DataFrame]) -> pd.DataFrame | None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pd.errors.ParserWarning)  # longer rows are looked for by the caller
        return next(pieces, None)


def _are_lists(column: pd.Series) -> bool:
    """Whether every cell that is not empty is a list in brackets."""
    if pd.api.types.is_numeric_dtype(column):
        return False
    cells = column.dropna().astype(str).str.strip()
    return len(cells) > 0 and bool((cells.str.startswith("[") & cells.str.endswith("]")).all())


def _elements(path: Path, header: str, column: pd.Series) -> tuple[Columns, list[str]]:
    """One column for each element of the lists; a shorter list leaves its last ones missing."""
    cells = column.astype("str").where(column.notna(), "[]").str.strip().str[1:-1]
    width = int(cells.str.count(",").max()) + 1
    if width * len(cells) > MAX_CELLS:
        raise InputError(
            f"{path}: {header}", f"lists of {width} elements", f"at most {MAX_CELLS} numbers", "Export it in parts."
        )
    name, unit = split_header(header)
    parts = cells.str.split(",", expand=True)
    columns, losses = [], []
    for element in range(width):
        text = parts[element].str.strip().replace("", None)
        numbers = pd.to_numeric(text, errors="coerce").to_numpy(dtype=np.float64)
        bad = int(np.count_nonzero(np.isnan(numbers) & text.notna().to_numpy() & (text.str.lower() != "nan").to_numpy()))
        if bad:
            losses.append(f"{path.name}: column {name}[{element}]: {bad} elements are not numbers")
        columns.append((f"{name}[{element}]" if unit is None else f"{name}[{element}] [{unit}]", numbers))
    return columns, losses


def _header(path: Path) -> tuple[list[str], str, int]:
    """The header cells, the separator, and how many physical lines come before the first row of data."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            for number, line in enumerate(file, start=1):
                if line.strip() and not line.lstrip().startswith("#"):
                    separator = max((",", ";", "\t"), key=line.count)
                    cells = next(csv_module.reader([line], delimiter=separator, skipinitialspace=True))
                    return [cell.strip() or f"column {i + 1}" for i, cell in enumerate(cells)], separator, number
    except UnicodeDecodeError as error:
        raise InputError(path, f"not UTF-8 text ({error.reason})", "a CSV file in UTF-8") from None
    raise InputError(path, "no header row", "a CSV file with one header row", "Export the log again.")
