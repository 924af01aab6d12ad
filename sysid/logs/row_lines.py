"""Line numbers and numbers of cells of the rows of a text table, for rows that a parser has filled up or cut."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sysid.logs.dialect import Dialect
from sysid.logs.limits import MAX_LINE

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
