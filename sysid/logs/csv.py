"""CSV: one header row, one time column, numbers; an empty cell is a missing value. Comma, semicolon or tab.

Cells that hold a list, ``"[0.1, 0.2]"`` under ``positions``, become columns of their own: ``positions[0]``, ``positions[1]``.
"""

from __future__ import annotations

import csv as csv_module
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid import scratch
from sysid.errors import InputError
from sysid.logs.growing import GrowingArray
from sysid.logs.limits import MAX_LINE, Budget
from sysid.logs.reader import ALL, ReadOptions
from sysid.logs.stream import Stream
from sysid.logs.table import CUT_ROW, Columns, is_wanted, table_stream, text_chunks, without_line_end
from sysid.units import split_header

#: Lists that are parsed at a time.
_LISTS = 2**14
_WHAT = "a CSV file with one header row"
#: The number of rows is estimated from this many samples of the file of this size [bytes], and rounded up by a margin.
_PLACES, _SAMPLE, _MARGIN = 8, 2**17, 1.02


@dataclass(frozen=True)
class CsvReader:
    """Headers are canonical names (``boom.cylinder [mm]``), or the recipe maps them."""

    name: str = "csv"
    suffixes: tuple[str, ...] = (".csv", ".tsv", ".txt")
    clocks: tuple[str, ...] = ("time",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        columns, losses = self.columns(path, options)
        known = () if options.columns is None else _header(path, options.budget_of(path, _WHAT, None))[0]
        return (table_stream(path, columns, options, losses, known=known),)

    def columns(self, path: Path, options: ReadOptions = ALL) -> tuple[Columns, tuple[str, ...]]:
        """Header → values of the wanted columns, in the order of the file, and the losses."""
        budget = options.budget_of(path, _WHAT, None)
        headers, separator, skipped = _header(path, budget)
        wanted = [i for i, header in enumerate(headers) if _is_read(header, options)]
        likely = min(_expected_rows(path), budget.rows)
        cells = {i: _Cells(f"{path}: {headers[i]}", budget, GrowingArray(np.nan, expected=likely)) for i in wanted}
        rows = 0
        losses = [f"{path.name}: {CUT_ROW}"] if without_line_end(path) else []
        for table in _pieces(path, len(headers), separator, skipped, options.progress):
            longer = np.flatnonzero(table[len(headers)].notna().to_numpy())
            if len(longer):
                where, expected = f"{path}: row {rows + int(longer[0]) + 1} below the header", "as many cells as the header has"
                raise InputError(where, f"more than {len(headers)} cells", expected, "Repair the row.")
            for index, column in cells.items():
                column.take(table[index])
            rows += len(table)
            scratch.leave()
        columns: list[tuple[str, npt.NDArray[np.float64]]] = []
        if not rows:
            losses = []
        for index, column in cells.items():
            header = headers[index]
            if column.are_lists:
                name, unit = split_header(header)
                suffix = "" if unit is None else f" [{unit}]"
                columns += [(f"{name}[{i}]{suffix}", element.whole(rows)) for i, element in enumerate(column.elements)]
                for element, count in sorted(column.damaged.items()):
                    losses.append(f"{path.name}: column {name}[{element}]: {count} elements are not numbers")
                continue
            numbers = column.numbers.whole(rows)
            if column.text and np.isnan(numbers).all():
                continue  # a column of labels
            if column.text:
                losses.append(f"{path.name}: column {header!r}: {column.text} cells are not numbers")
            columns.append((header, numbers))
        return columns, tuple(losses)


def _is_read(header: str, options: ReadOptions) -> bool:
    """Whether a column or an element of its lists (``positions[2]``) is wanted."""
    if is_wanted(header, options):
        return True
    name = split_header(header)[0]
    return any(wanted.startswith(f"{name}[") for wanted in options.columns or ())


@dataclass
class _Cells:
    """One column while it is read. ``text``: cells that are no numbers, ``listed`` of them in chunks of only lists."""

    where: str
    budget: Budget
    numbers: GrowingArray
    text: int = 0
    listed: int = 0
    filled: int = 0
    rows: int = 0
    #: Of lists: the values of each element, and element → how many of them are no numbers.
    elements: list[GrowingArray] = field(default_factory=list)
    damaged: dict[int, int] = field(default_factory=dict)

    def take(self, cells: pd.Series) -> None:
        """The next rows."""
        filled = cells.notna().to_numpy()
        numbers = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=np.float64)
        self.numbers.extend(numbers)
        text = int(np.count_nonzero(np.isnan(numbers) & filled))
        self.text += text
        self.filled += int(np.count_nonzero(filled))
        if text and _are_lists(cells):
            self.listed += text
            for begin in range(0, len(cells), _LISTS):
                self._take_lists(cells.iloc[begin : begin + _LISTS], self.rows + begin)
        elif text:
            self.elements, self.damaged = [], {}  # a column with text is no column of lists
        self.rows += len(cells)

    @property
    def are_lists(self) -> bool:
        """Whether every cell that is not empty is a list in brackets."""
        return 0 < self.listed == self.filled

    def _take_lists(self, column: pd.Series, first: int) -> None:
        """The elements of lists; a shorter list leaves its last ones missing."""
        cells = column.astype("str").where(column.notna(), "[]").str.strip().str[1:-1]
        width = int(cells.str.count(",").max()) + 1
        self.budget.check_columns(self.where, width, "elements of a list")
        self.budget.check_numbers(self.where, width * (first + len(cells)))
        parts = cells.str.split(",", expand=True)
        self.elements += [GrowingArray(np.nan) for _ in range(width - len(self.elements))]
        for element in range(width):
            text = parts[element].str.strip().replace("", None)
            numbers = pd.to_numeric(text, errors="coerce").to_numpy(dtype=np.float64)
            bad = int(np.count_nonzero(np.isnan(numbers) & text.notna().to_numpy() & (text.str.lower() != "nan").to_numpy()))
            if bad:
                self.damaged[element] = self.damaged.get(element, 0) + bad
            self.elements[element].put(slice(first, first + len(numbers)), numbers)


def _expected_rows(path: Path) -> int:
    """Estimated number of rows, from the line ends in samples of the file."""
    size = path.stat().st_size
    lines = read = 0
    with path.open("rb") as file:
        for place in np.linspace(0, max(0, size - _SAMPLE), _PLACES).astype(int).tolist():
            file.seek(place)
            sample = file.read(_SAMPLE)
            lines, read = lines + sample.count(b"\n"), read + len(sample)
    return int(_MARGIN * size * lines / max(1, read)) + 1


def _pieces(path: Path, width: int, separator: str, skipped: int, progress: Callable[[float], None]) -> Iterator[pd.DataFrame]:
    """The rows in chunks, numbered from 0, without a last one that may be cut."""
    before: pd.DataFrame | None = None
    for chunk in text_chunks(
        path, width + 1, progress, "not readable as CSV", "rows with as many cells as the header has",
        sep=separator, skiprows=skipped, skipinitialspace=True, na_values=["", "NaN", "nan", "None"],
    ):  # fmt: skip
        if before is not None:
            yield before
        before = chunk
    if before is not None:
        yield before.iloc[:-1] if without_line_end(path) else before


def _are_lists(column: pd.Series) -> bool:
    """Whether every cell that is not empty is a list in brackets."""
    if pd.api.types.is_numeric_dtype(column):
        return False
    cells = column.dropna().astype(str).str.strip()
    return len(cells) > 0 and bool((cells.str.startswith("[") & cells.str.endswith("]")).all())


def _header(path: Path, budget: Budget) -> tuple[list[str], str, int]:
    """The header cells, the separator, and how many physical lines come before the first row of data."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            for number, line in enumerate(iter(lambda: file.readline(MAX_LINE), ""), start=1):
                if len(line) == MAX_LINE:
                    raise InputError(path, f"a line of more than {MAX_LINE} letters", "one header row", "Is it a CSV file?")
                if line.strip() and not line.lstrip().startswith("#"):
                    separator = max((",", ";", "\t"), key=line.count)
                    budget.check_columns(path, line.count(separator) + 1)
                    cells = next(csv_module.reader([line], delimiter=separator, skipinitialspace=True))
                    return [cell.strip() or f"column {i + 1}" for i, cell in enumerate(cells)], separator, number
    except UnicodeDecodeError as error:
        raise InputError(path, f"not UTF-8 text ({error.reason})", "a CSV file in UTF-8") from None
    raise InputError(path, "no header row", _WHAT, "Export the log again.")
