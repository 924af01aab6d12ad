"""Shared by readers of tables: parsing in chunks, choice of the time column, stamps in nanoseconds."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid import scratch
from sysid.errors import InputError, nearest
from sysid.logs.reader import ReadOptions
from sysid.logs.stream import Stream
from sysid.units import si_factor, split_header

#: Names under which a time column is found without a recipe, in this order.
TIME_NAMES = ("time", "t", "Time", "timestamp")

#: Header and values of each column.
Columns: TypeAlias = Sequence[tuple[str, npt.NDArray[np.float64]]]

#: Stamps that are converted, and cells of a text table that are parsed, at a time.
_PIECE, CELLS = 2**18, 2**20

#: The loss of a text log whose last row may be cut: it would give a wrong value, not a missing one.
CUT_ROW = "the last row has no line end and may be cut: left out"


def without_line_end(path: Path) -> bool:
    """Whether a text file ends within a row."""
    with path.open("rb") as file:
        if not file.seek(0, 2):
            return False
        file.seek(-1, 2)
        return file.read(1) not in (b"\n", b"\r")


def text_chunks(
    path: Path, cells: int, progress: Callable[[float], None], damage: str, expected: str, **settings: Any
) -> Iterator[pd.DataFrame]:
    """The rows of a text table in chunks, because text takes several times the memory of its numbers.

    Args:
        cells: in a row, one more than expected: it is empty in every row that fits.
        progress: called with the share of the file that has been read.
        damage, expected: of the error where the table cannot be parsed.
        settings: of :func:`pandas.read_csv`.

    Raises:
        InputError: rows that cannot be parsed, or not UTF-8.
    """
    size = path.stat().st_size
    try:
        with path.open("rb") as file, pd.read_csv(
            file, header=None, names=list(range(cells)), index_col=False, encoding="utf-8-sig", low_memory=False,
            chunksize=max(1, CELLS // cells), **settings,
        ) as chunks:  # fmt: skip
            while True:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", pd.errors.ParserWarning)  # the caller checks for longer rows
                    chunk = next(chunks, None)
                if chunk is None:
                    return
                progress(min(1.0, file.tell() / size))
                yield chunk
    except pd.errors.EmptyDataError:
        return
    except (pd.errors.ParserError, UnicodeDecodeError) as error:
        raise InputError(path, f"{damage} ({' '.join(str(error).split())})", expected) from None


def is_wanted(header: str, options: ReadOptions, units_in_headers: bool = True) -> bool:
    """Whether a column is to be read: it is wanted, or may be the time."""
    if options.columns is None:
        return True
    name = split_header(header)[0] if units_in_headers else header
    if name in options.columns or name == options.time:
        return True
    return options.time is None and options.rate_hz is None and name in TIME_NAMES


def table_stream(
    path: Path,
    columns: Columns,
    options: ReadOptions,
    losses: tuple[str, ...] = (),
    units_in_headers: bool = True,
    known: Sequence[str] = (),
) -> Stream:
    """The stream of a plain table of (header, values); headers may carry units (``boom.cylinder [mm]``).

    ``known``: all headers, where only the wanted columns were read.

    Raises:
        InputError: no time column, no rows, a time column with missing values, two columns of one name.
    """
    values: dict[str, npt.NDArray[np.float64]] = {}
    units: dict[str, str] = {}
    fields = tuple(split_header(header)[0] if units_in_headers else header for header in known)
    for header, column in columns:
        name, unit = split_header(header) if units_in_headers else (header, None)
        if name in values:
            raise InputError(path, f"two columns are named {name!r}", "one column a name", "Rename or drop one of them.")
        values[name] = column
        if unit is not None:
            units[name] = unit
    if options.rate_hz is not None and options.time is None:
        rows = max((len(column) for column in values.values()), default=0)
        step = 1e9 / options.rate_hz
        stamps = scratch.computed(rows, lambda a, b: np.rint(np.arange(a, b) * step).astype(np.int64), np.int64)
    else:
        time = _time_name(path, tuple(values), options, fields)
        factor, si = si_factor(units.pop(time, options.time_unit), path)
        if si != "s":
            raise InputError(f"{path}: {time}", f"a unit of [{si}]", "a unit of time such as s, ms or ns")
        stamps = to_ns(values.pop(time), factor, f"{path}: {time}")
    if not len(stamps):
        raise InputError(path, "a header but no rows", "at least one row of numbers", "Export the log again.")
    return Stream(path.stem, path, {"time": stamps}, values, units, losses, fields)


def guess_time(columns: Columns) -> tuple[str, str] | None:
    """The time column and its unit: one with such a name, else the first increasing one; None where none increases."""
    rising = {}
    for header, values in columns:
        name, unit = split_header(header)
        steps = np.diff(values)
        if len(values) > 1 and np.all(np.isfinite(values)) and np.all(steps >= 0.0) and np.any(steps > 0.0):
            rising[name] = (values, unit)
    for name in (*TIME_NAMES, *(name for name in rising if "time" in name.lower() or "stamp" in name.lower()), *rising):
        if name in rising:
            values, unit = rising[name]
            return name, unit or _time_unit(name, values)
    return None


def _time_unit(name: str, values: npt.NDArray[np.float64]) -> str:
    """The unit of a Unix time since 2001 follows from its size, that of others from the name; seconds otherwise."""
    size = float(np.median(np.abs(values)))
    for limit, unit in ((1e18, "ns"), (1e15, "us"), (1e12, "ms")):
        if size > limit:
            return unit
    return next((unit for unit in ("ns", "us", "ms") if name.lower().endswith(f"_{unit}")), "s")


def to_ns(seconds: npt.NDArray[np.float64], factor: float, where: str) -> npt.NDArray[np.int64]:
    """Stamps in units of ``factor`` seconds as int64 nanoseconds.

    Whole units and fractions are converted separately, so that a Unix time in seconds keeps its float64 precision.
    """
    if not np.all(np.isfinite(seconds)):
        bad = int(np.flatnonzero(~np.isfinite(seconds))[0])
        raise InputError(where, f"no time in row {bad + 1}", "a number in every row", "Remove the row or repair the export.")
    scale = factor * 1e9
    largest = max(float(np.max(seconds, initial=0.0)), -float(np.min(seconds, initial=0.0))) * scale
    if largest > 9.2e18:  # 292 years
        expected = "times that fit into 64 bits of nanoseconds"
        raise InputError(where, f"a time of {largest * 1e-9:.3g} s", expected, "State the right unit of the time column.")
    stamps: npt.NDArray[np.int64] = scratch.empty(len(seconds), np.int64)
    for begin in range(0, len(seconds), _PIECE):
        piece = seconds[begin : begin + _PIECE]
        whole = np.floor(piece)
        units = whole.astype(np.int64) * int(scale) if scale == int(scale) else np.rint(whole * scale).astype(np.int64)
        stamps[begin : begin + _PIECE] = units + np.rint((piece - whole) * scale).astype(np.int64)
    return stamps


def _time_name(path: Path, names: tuple[str, ...], options: ReadOptions, known: tuple[str, ...]) -> str:
    if options.time is not None:
        if options.time not in names:
            found, expected = f"no time column {options.time!r}", nearest(options.time, known or names)
            raise InputError(path, found, expected, "Correct `time` in the recipe.")
        return options.time
    for name in TIME_NAMES:
        if name in names:
            return name
    raise InputError(
        path,
        "no time column",
        f"a column named {TIME_NAMES[0]!r}; found {', '.join(known or names) or 'none'}",
        'Name the column in the recipe: `time = "<column>"`, or the rate of evenly spaced rows: `rate_hz = …`.',
    )
