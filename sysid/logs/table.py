"""Shared by readers of tables: parsing in chunks, choice of the time column, stamps in nanoseconds."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid import scratch
from sysid.errors import InputError, nearest
from sysid.logs.reader import ReadOptions
from sysid.logs.stream import Stream
from sysid.logs.time_unit import TimeUnit, as_unit, likely_units
from sysid.units import si_factor, split_header

#: Names under which a time column is found without a recipe, in this order.
TIME_NAMES = ("time", "t", "Time", "timestamp")

#: Rates [Hz] outside of which stamps without a unit are not taken for seconds.
SLOWEST_HZ, FASTEST_HZ = 0.5, 50e3

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
    path: Path,
    cells: int,
    progress: Callable[[float], None],
    damage: str | None,
    expected: str,
    encoding: str = "utf-8-sig",
    offset: int = 0,
    **settings: Any,
) -> Iterator[pd.DataFrame]:
    """The rows of a text table in chunks, because text takes several times the memory of its numbers.

    Args:
        cells: in a row, one more than expected: it is empty in every row that fits.
        progress: called with the share of the file that has been read.
        damage, expected: of the error where the table cannot be parsed; None: the parser's own error is raised.
        encoding: of the text.
        offset: bytes before the first row.
        settings: of :func:`pandas.read_csv`.

    Raises:
        InputError: rows that cannot be parsed, or not in this encoding.
        ParserError: rows that cannot be parsed, without ``damage``.
    """
    size = path.stat().st_size
    try:
        with path.open("rb") as file:
            file.seek(offset)
            with pd.read_csv(
                file, header=None, names=list(range(cells)), index_col=False, encoding=encoding, low_memory=False,
                chunksize=max(1, CELLS // cells), **settings,
            ) as chunks:  # fmt: skip
                while True:
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore", pd.errors.ParserWarning)  # the caller checks for longer rows
                        chunk = next(chunks, None)
                    if chunk is None:
                        return
                    progress(min(1.0, (size if file.closed else file.tell()) / size))
                    yield chunk
    except pd.errors.EmptyDataError:
        return
    except (pd.errors.ParserError, UnicodeError) as error:
        if damage is None and isinstance(error, pd.errors.ParserError):
            raise
        damage = damage or f"text that is not {encoding}"
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
        if time not in units and options.time_unit is None:
            _check_unit(path, time, values[time], options)
        factor, si = si_factor(units.pop(time, options.time_unit or "s"), path)
        if si != "s":
            raise InputError(f"{path}: {time}", f"a unit of [{si}]", "a unit of time such as s, ms or ns")
        stamps = to_ns(values.pop(time), factor, f"{path}: {time}")
    if not len(stamps):
        raise InputError(path, "a header but no rows", "at least one row of numbers", "Export the log again.")
    return Stream(path.stem, path, {"time": stamps}, values, units, losses, fields)


@dataclass(frozen=True)
class TimeGuess:
    """The likely time column: its name, the unit that its header states, and else the plausible ones, the likeliest first."""

    name: str
    stated: str | None
    units: tuple[TimeUnit, ...]


def guess_time(columns: Columns, expected_hz: float | None = None) -> TimeGuess | None:
    """The likely time column: one with such a name, else the first increasing one; None where none increases.

    ``expected_hz``: rate of the machine [Hz], which may decide between units.
    """
    rising = {}
    for header, values in columns:
        name, unit = split_header(header)
        if len(values) > 1 and np.all(np.isfinite(values)) and _rises(values):
            rising[name] = (values, unit)
    words = ("time", "stamp", "zeit")
    for name in (*TIME_NAMES, *(name for name in rising if any(word in name.lower() for word in words)), *rising):
        if name in rising:
            values, unit = rising[name]
            return TimeGuess(name, unit, () if unit is not None else likely_units(values, name, expected_hz))
    return None


def _rises(values: npt.NDArray[np.float64]) -> bool:
    """Whether values rise, except for few late or repeated ones."""
    steps = np.diff(values)
    return bool(np.any(steps > 0.0) and np.count_nonzero(steps < 0.0) <= 0.01 * len(steps))


def _check_unit(path: Path, time: str, values: npt.NDArray[np.float64], options: ReadOptions) -> None:
    """Raise InputError where stamps of no stated unit have no plausible rate in seconds, but in another unit."""
    read = as_unit(values, "s")
    if read is None or SLOWEST_HZ <= read.rate_hz <= FASTEST_HZ:
        return
    likely = [unit for unit in likely_units(values, time, options.expected_hz) if unit.unit != "s"]
    if likely:
        unit = likely[0].unit
        raise InputError(
            f"{path}: {time}",
            f"stamps of no stated unit; as seconds {read.rate_hz:.3g} Hz over {read.seconds:.4g} s",
            f"{' or '.join(map(str, likely))}",
            f'State `time_unit = "{unit}"` in the recipe or `{time} [{unit}]` in the header; "s" if seconds are right.',
        )


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
