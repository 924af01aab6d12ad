"""CSV: one header row, one time column, numbers; an empty cell is a missing value. Comma, semicolon or tab."""

from __future__ import annotations

import csv as csv_module
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from sysid.errors import InputError
from sysid.logs.limits import check_whole
from sysid.logs.reader import ReadOptions
from sysid.logs.stream import Stream
from sysid.logs.table import Columns, table_stream


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
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", pd.errors.ParserWarning)  # longer rows are looked for below
                # One column more than the header has: it is empty in every row that fits.
                table = pd.read_csv(
                    path, sep=separator, skiprows=skipped, header=None, names=list(range(len(headers) + 1)), index_col=False,
                    skipinitialspace=True, na_values=["", "NaN", "nan", "None"], encoding="utf-8-sig", low_memory=False,
                )  # fmt: skip
        except (pd.errors.ParserError, UnicodeDecodeError) as error:
            raise InputError(
                path, f"not readable as CSV ({' '.join(str(error).split())})", "rows with as many cells as the header has"
            ) from None
        longer = np.flatnonzero(table[len(headers)].notna().to_numpy())
        if len(longer):
            where = f"{path}: row {int(longer[0]) + 1} below the header"
            raise InputError(where, f"more than {len(headers)} cells", "as many cells as the header has", "Repair the row.")
        columns = []
        losses = []
        for index, header in enumerate(headers):
            numbers = pd.to_numeric(table[index], errors="coerce").to_numpy(dtype=np.float64)
            text = int(np.count_nonzero(np.isnan(numbers) & table[index].notna().to_numpy()))
            if text and np.isnan(numbers).all():
                continue  # a column of labels
            if text:
                losses.append(f"{path.name}: column {header!r}: {text} cells are not numbers")
            columns.append((header, numbers))
        return columns, tuple(losses)


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
