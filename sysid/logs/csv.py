"""CSV: one header row, one time column, numbers; an empty cell is a missing value.

Delimiter, decimal mark, encoding, a row of units and remarks are found from the first rows (:mod:`sysid.logs.dialect`). Every
row has as many cells as the header; empty ones at its end do not count. Cells that hold a list, ``"[0.1, 0.2]"`` under
``positions``, become columns of their own: ``positions[0]``, ``positions[1]``.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid import scratch
from sysid.errors import InputError
from sysid.logs.cells import CellColumn
from sysid.logs.dialect import REMARKS, Dialect, find_dialect
from sysid.logs.limits import MAX_LINE
from sysid.logs.reader import ALL, ReadOptions, Stream
from sysid.logs.table import CUT_ROW, Table, TableReader, is_time, is_wanted, table_stream, text_chunks, without_line_end
from sysid.units import split_header

#: Cells without a value.
MISSING = frozenset({"", "NaN", "nan", "None", "-", "--"})


@dataclass
class RowLines:
    """Reads the file a second time, line by line and only as far as needed. A row in quotes may continue over several lines."""

    path: Path
    dialect: Dialect
    _row: int = 0
    _rows: Iterator[tuple[int, int, int]] = field(init=False)

    def __post_init__(self) -> None:
        csv.field_size_limit(MAX_LINE)
        self._rows = self._read()

    def __iter__(self) -> Iterator[tuple[int, int, int]]:
        """Line and number of cells of every further row, and the cells up to the last one with a value."""
        return self._rows

    def between(self, first: int, last: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """Line and number of cells of the rows ``first`` to ``last`` - 1, counted from 0; later rows than before only."""
        for _ in range(first - self._row):
            next(self._rows, None)
        found = np.fromiter(
            (number for _, row in zip(range(last - first), self._rows, strict=False) for number in row[:2]), np.intp
        )
        self._row = last
        return found[::2], found[1::2]

    def _read(self) -> Iterator[tuple[int, int, int]]:
        delimiter, number = self.dialect.delimiter, 0
        with self.path.open(encoding=self.dialect.encoding, errors="replace", newline=None) as file:
            for line in file:
                number += 1
                if number <= self.dialect.lines or (line.isspace() and (delimiter == " " or delimiter not in line)):
                    continue
                first = number
                if '"' in line:
                    rows = csv.reader(chain([line], file), delimiter=delimiter, skipinitialspace=True)
                    cells = [cell for cell in next(rows) if cell or delimiter != " "]
                    number += rows.line_num - 1
                else:
                    cells = line.split() if delimiter == " " else line.split(delimiter)
                yield first, len(cells), max((k for k, cell in enumerate(cells, 1) if cell.strip() not in MISSING), default=0)


_WHAT = "a CSV file with one header row"
#: The number of rows is estimated from this many samples of the file of this size [bytes], and rounded up by a margin.
_PLACES, _SAMPLE, _MARGIN = 8, 2**17, 1.02


class CsvReader(TableReader):
    """Headers are canonical names (``boom.cylinder [mm]``), or the recipe maps them."""

    name = "csv"
    suffixes = (".csv", ".tsv", ".txt")

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        return (table_stream(path, self.table(path, options), options),)

    def dialect(self, path: Path, options: ReadOptions = ALL) -> Dialect:
        """The form of the file, also of one without a header row."""
        return find_dialect(path, options, options.budget_of(path, _WHAT, None))

    def table(self, path: Path, options: ReadOptions = ALL) -> Table:
        """The wanted columns, in the order of the file.

        Raises:
            InputError: no header row, or a row with more or fewer cells than it.
        """
        budget = options.budget_of(path, _WHAT, None)
        dialect = self.dialect(path, options)
        dialect.check_named(path)
        headers = dialect.headers
        likely = min(_expected_rows(path), budget.rows)
        cells = {
            i: CellColumn(
                header,
                f"{path}: {header}",
                budget,
                dialect.decimal,
                dialect.proven,
                likely,
                is_time(split_header(header)[0], options),
            )
            for i, header in enumerate(headers)
            if _is_read(header, options)
        }
        rows = 0
        checked = _CheckedRows(path, dialect)
        cut = without_line_end(path, dialect.encoding)
        for table in checked.tables(_pieces(path, dialect, cut, options.progress)):
            for index, column in cells.items():
                column.take(table[index])
            rows += len(table)
            scratch.leave()
        losses = (*((CUT_ROW,) if cut and rows else ()), *checked.losses)
        found = Table.joined([Table((), losses), *(column.table() for column in cells.values())])
        return replace(found, losses=tuple(f"{path.name}: {loss}" for loss in found.losses), headers=headers)


def _is_read(header: str, options: ReadOptions) -> bool:
    """Whether a column or an element of its lists (``positions[2]``) is wanted."""
    if is_wanted(header, options):
        return True
    name = split_header(header)[0]
    return any(wanted.startswith(f"{name}[") for wanted in options.columns or ())


@dataclass
class _CheckedRows:
    """Chunks of rows without remarks, empty rows and repeated headers; a row with too few or too many cells is refused."""

    path: Path
    dialect: Dialect
    losses: list[str] = field(default_factory=list)
    _first: int = 0
    _repeated: int = 0
    _lines: RowLines | None = None

    def tables(self, pieces: Iterator[tuple[pd.DataFrame, bool]]) -> Iterator[pd.DataFrame]:
        """The chunks of ``pieces``, each with True where it is the last."""
        while True:
            try:
                piece, last = next(pieces, (None, True))
            except pd.errors.ParserError as error:
                raise self._unparsed(error) from None
            if piece is None:
                break
            keep = self._kept(piece)
            self._check(piece, keep, last)
            self._first += len(piece)
            yield piece if keep.all() else piece[keep]
        if self._repeated:
            self.losses.append(f"the header is repeated in {self._repeated} rows: left out")

    def _kept(self, table: pd.DataFrame) -> npt.NDArray[np.bool_]:
        """False for remarks and repeated headers."""
        keep = np.ones(len(table), dtype=bool)
        first = table[0]
        if not len(table) or pd.api.types.is_numeric_dtype(first):
            return keep
        text = first.astype(str)
        keep &= ~text.str.startswith(REMARKS).to_numpy(dtype=bool)
        cells = self.dialect.cells
        if cells and cells[0]:
            for row in np.flatnonzero((text.str.strip() == cells[0]).to_numpy(dtype=bool)).tolist():
                if all(str(table.iat[row, i]).strip() == cell for i, cell in enumerate(cells) if cell and i < table.shape[1]):
                    keep[row] = False
                    self._repeated += 1
        return keep

    def _check(self, table: pd.DataFrame, keep: npt.NDArray[np.bool_], last: bool) -> None:
        """Drop empty rows, and refuse rows that are too long or too short.

        The parser fills a short row up, so that its last cell is missing. Only then the lines are read a second time.
        """
        width = len(self.dialect.headers)
        longer = table[list(range(width, table.shape[1]))].notna().any(axis=1).to_numpy() & keep
        doubtful = longer | (table[width - 1].isna().to_numpy() & keep) if width > 1 else longer
        if not doubtful.any():
            return
        rows = np.flatnonzero(doubtful)
        empty = rows[table.iloc[rows].isna().all(axis=1).to_numpy()]
        keep[empty] = False
        doubtful[empty] = False
        if not doubtful.any():
            return
        if self._lines is None:
            self._lines = RowLines(self.path, self.dialect)
        lines, counts = self._lines.between(self._first, self._first + len(table))
        count = len(lines)
        short = (counts < width) & doubtful[:count]
        bad = np.flatnonzero(longer[:count] | short)
        if not len(bad):
            return
        row = int(bad[0])
        usual = self.dialect.width == width
        if usual and last and len(bad) == 1 and row == len(table) - 1 and short[row]:
            keep[row] = False
            self.losses.append(f"line {lines[row]}, the last row, has {counts[row]} of {width} values and may be cut: left out")
            return
        raise self._ragged(int(lines[row]), int(counts[row]))

    def _unparsed(self, error: pd.errors.ParserError) -> InputError:
        """The first row of another length up to the one that is too long for the parser, else what the parser states."""
        lines, width = RowLines(self.path, self.dialect), len(self.dialect.headers)
        for line, count, filled in lines:
            if count > width + 1 or filled > width or 0 < filled <= count < width:
                return self._ragged(line, count)
        expected = "rows with as many cells as the header has"
        return InputError(self.path, f"not readable as CSV ({' '.join(str(error).split())})", expected, "Export the log again.")

    def _ragged(self, line: int, count: int) -> InputError:
        header, width = self.dialect.header_line, len(self.dialect.headers)
        names = f"the header in line {header} has names" if header else "the recipe's `columns` has names"
        expected = f"{width}, as many as {names}"
        if count != self.dialect.width:
            remedy = "Repair or remove the line. Where the logger writes other columns from there on, cut the file there."
        elif count > width and self.dialect.delimiter == ",":
            remedy = "Most rows are like this. Is the decimal mark a comma, too? Then export with another delimiter; else name "
            remedy += "the columns in the recipe: `columns = [...]`."
        else:
            remedy = "Most rows are like this: repair the header, or name the columns in the recipe: `columns = [...]`."
        return InputError(f"{self.path}: line {line}", f"{count} value{'s' if count != 1 else ''}", expected, remedy)


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


def _pieces(path: Path, dialect: Dialect, cut: bool, progress: Callable[[float], None]) -> Iterator[tuple[pd.DataFrame, bool]]:
    """The rows in chunks, numbered from 0, each with True where it is the last; without a last row that may be ``cut``."""
    before: pd.DataFrame | None = None
    cells = max(len(dialect.headers) + 1, dialect.longest_remark)
    chunks = text_chunks(
        path, cells, progress, None, "rows with as many cells as the header has",
        dialect.encoding, dialect.offset, sep=dialect.separator, decimal=dialect.decimal, skipinitialspace=True,
        na_values=sorted(MISSING),
    )  # fmt: skip
    while True:
        try:
            chunk = next(chunks, None)
        except pd.errors.ParserError:
            if before is not None:  # its rows come first
                yield before, False
            raise
        if chunk is None:
            break
        if before is not None:
            yield before, False
        before = chunk
    if before is not None:
        yield before.iloc[:-1] if cut else before, True
