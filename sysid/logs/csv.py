"""CSV: one header row, one time column, numbers; an empty cell is a missing value. Comma, semicolon or tab.

Cells that hold a list, ``"[0.1, 0.2]"`` under ``positions``, become columns of their own: ``positions[0]``, ``positions[1]``.
"""

from __future__ import annotations

import csv as csv_module
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.errors import InputError
from sysid.logs.limits import MAX_CELLS, check_whole
from sysid.logs.reader import ReadOptions
from sysid.logs.stream import Stream
from sysid.logs.table import CUT_ROW, Columns, table_stream, without_line_end
from sysid.units import split_header


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
        columns: list[tuple[str, npt.NDArray[np.float64]]] = []
        losses: list[str] = []
        if len(table) and without_line_end(path):
            table = table.iloc[:-1]
            losses.append(f"{path.name}: {CUT_ROW}")
        for index, header in enumerate(headers):
            if _are_lists(table[index]):
                elements, lost = _elements(path, header, table[index])
                columns += elements
                losses += lost
                continue
            numbers = pd.to_numeric(table[index], errors="coerce").to_numpy(dtype=np.float64)
            text = int(np.count_nonzero(np.isnan(numbers) & table[index].notna().to_numpy()))
            if text and np.isnan(numbers).all():
                continue  # a column of labels
            if text:
                losses.append(f"{path.name}: column {header!r}: {text} cells are not numbers")
            columns.append((header, numbers))
        return columns, tuple(losses)


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
