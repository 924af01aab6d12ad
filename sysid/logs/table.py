"""Shared by readers of tables: parsing in chunks, choice of the time column, stamps in nanoseconds."""

from __future__ import annotations

import warnings
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid import scratch
from sysid.errors import InputError, nearest
from sysid.logs.reader import ALL, LogReader, ReadOptions, Stream
from sysid.logs.time_unit import FEWEST, SECONDS, TimeUnit, as_unit, days_origin, likely_units
from sysid.units import si_factor, split_header

#: What the error about a table without a column of times has found.
NO_TIME = "no time column"
#: Names under which a time column is found without a recipe, in this order.
TIME_NAMES = ("time", "t", "Time", "timestamp")

#: Rates [Hz] outside of which stamps without a unit are not taken for seconds.
SLOWEST_HZ, FASTEST_HZ = 0.5, 50e3

#: Header and values of each column.
Columns: TypeAlias = Sequence[tuple[str, npt.NDArray[np.float64]]]

#: Header and values of each column (n,): float64, whole numbers, or stamps in nanoseconds (datetime64, timedelta64).
TypedColumns: TypeAlias = Sequence[tuple[str, npt.NDArray[Any]]]

#: Stamps that are converted, and cells of a text table that are parsed, at a time.
_PIECE, CELLS = 2**18, 2**20

#: The loss of a text log whose last row may be cut: it would give a wrong value, not a missing one.
CUT_ROW = "the last row has no line end and may be cut: left out"


@dataclass(frozen=True)
class Table:
    """What a reader found in a plain table.

    Args:
        columns: those with numbers or stamps.
        losses: as of :class:`sysid.logs.Stream`.
        unread: name of a column without numbers → what it has instead.
        headers: of all columns with numbers or stamps, also of those that were not read.
    """

    columns: TypedColumns = ()
    losses: tuple[str, ...] = ()
    unread: Mapping[str, str] = field(default_factory=dict)
    headers: tuple[str, ...] = ()

    @classmethod
    def joined(cls, tables: Sequence[Table]) -> Table:
        """The columns of several tables beside each other."""
        return cls(
            [column for table in tables for column in table.columns],
            tuple(loss for table in tables for loss in table.losses),
            {name: reason for table in tables for name, reason in table.unread.items()},
        )

    @property
    def numbers(self) -> Columns:
        """All columns as float64; stamps in seconds, with that unit in the header."""
        return [
            (f"{split_header(header)[0]} [s]" if values.dtype.kind in "mM" else header, _floats(values))
            for header, values in self.columns
        ]


class TableReader(LogReader):
    """Reader of a format with one plain table a file."""

    clocks = ("time",)

    @abstractmethod
    def table(self, path: Path, options: ReadOptions = ALL) -> Table:
        """The wanted columns, in the order of the file."""


def _floats(values: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    if values.dtype == np.float64:
        return values
    if values.dtype.kind not in "mM":
        return scratch.computed(len(values), lambda first, last: values[first:last])
    missing = np.isnat(values)
    seconds: npt.NDArray[np.float64] = np.where(missing, np.nan, values.view(np.int64) * 1e-9)
    return seconds


def without_line_end(path: Path, encoding: str = "utf-8") -> bool:
    """Whether a text file ends within a row."""
    size = 2 if encoding.startswith("utf-16") else 1
    with path.open("rb") as file:
        if file.seek(0, 2) < size:
            return False
        file.seek(-size, 2)
        return file.read(size).decode(encoding, "replace") not in ("\n", "\r")


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
    name = split_header(header)[0] if units_in_headers else header
    return options.columns is None or name in options.columns or is_time(name, options)


def is_time(name: str, options: ReadOptions) -> bool:
    """Whether a column is the time, or may be it."""
    return name == options.time or (options.time is None and options.rate_hz is None and name in TIME_NAMES)


def table_stream(path: Path, table: Table, options: ReadOptions, units_in_headers: bool = True) -> Stream:
    """The stream of a plain table; headers may carry units (``boom.cylinder [mm]``).

    Raises:
        InputError: no time column, no rows, a time column with missing values, two columns of one name, or a wanted column
            without numbers.
    """
    values: dict[str, npt.NDArray[Any]] = {}
    units: dict[str, str] = {}
    losses, unread = list(table.losses), dict(table.unread)
    known = () if options.columns is None else table.headers
    fields = tuple(split_header(header)[0] if units_in_headers else header for header in known)
    for header, column in table.columns:
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
        time = _time_name(path, values, options, fields, unread)
        stamps, loss = _stamps(path, time, values.pop(time), units.pop(time, None), options)
        losses += [loss] if loss else []
    if not len(stamps):
        raise InputError(path, "a header but no rows", "at least one row of numbers", "Export the log again.")
    for name in [name for name, column in values.items() if column.dtype.kind in "mM"]:
        unread[name] = "dates or times, which only a time column has"
        del values[name]
    for wanted in sorted(options.columns or ()):
        for name, reason in unread.items():  # also an element or a field of it
            if wanted == name or (wanted not in values and wanted.startswith((f"{name}[", f"{name}."))):
                raise no_numbers(path, name, reason)
    numbers = {name: _floats(column) for name, column in values.items()}
    units = {name: unit for name, unit in units.items() if name in numbers}
    return Stream(path.stem, path, {"time": stamps}, numbers, units, tuple(losses), fields, unread=unread)


def no_numbers(path: Path, name: str, reason: str) -> InputError:
    """The refusal of a column that is needed and has no numbers."""
    remedy = f"Export it as numbers, with their unit in the header (`{name} [mm]`); rename or drop it if it is no measurement."
    return InputError(f"{path}: column {name!r}", reason, "numbers", remedy)


def _stamps(
    path: Path, time: str, values: npt.NDArray[Any], stated: str | None, options: ReadOptions
) -> tuple[npt.NDArray[np.int64], str]:
    """The stamps of a time column [ns], and what was assumed of them."""
    where = f"{path}: {time}"
    if values.dtype.kind in "mM":
        return to_ns(values, 1e-9, where), ""
    unit = stated or options.time_unit
    if unit is None:
        _check_unit(path, time, _floats(values), options)
    factor, si = si_factor(unit or "s", path)
    if si != "s":
        raise InputError(where, f"a unit of [{si}]", "a unit of time such as s, ms or ns")
    _check_padding(where, values, factor)
    origin, calendar = (0.0, "") if factor != SECONDS["day"] else days_origin(values)
    if not calendar:
        return to_ns(values, factor, where), ""
    return to_ns(_floats(values) - origin, factor, where), f"{time}: {calendar}, taken as dates in UTC"


def _check_padding(where: str, values: npt.NDArray[Any], factor: float) -> None:
    """Raise InputError for seconds and unpadded nanoseconds with a dot between them: 12.5 for 12 s and 5 ns.

    These go back where the nanoseconds have one digit more than before, in every second from 12.99… to 12.10….
    """
    if factor != 1.0 or values.dtype.kind != "f" or not np.isfinite(values).all():
        return
    back = np.flatnonzero(values[1:] < values[:-1])
    if len(back) < FEWEST:
        return
    whole = np.floor(values)
    seconds = 1 + int(np.count_nonzero(whole[1:] != whole[:-1]))
    tenths = np.floor((values[back + 1] - whole[back + 1]) * 10.0 + 1e-5)
    # All seconds but the first and the last are complete.
    if np.count_nonzero(tenths == 1.0) < max(seconds - 2, FEWEST) or np.any(whole[1:] < whole[:-1]):
        return
    row = int(back[0])
    raise InputError(
        f"{where}: rows {row + 1} and {row + 2}",
        f"{values[row]:.9f} and {values[row + 1]:.9f}: stamps go back {len(back)} times in {seconds} s, in each to its first "
        "tenth, as nanoseconds without leading zeros do (12.5 for 12 s and 5 ns)",
        "nine digits of nanoseconds after the dot (12.000000005)",
        "Write seconds and nanoseconds as one number: `sec + 1e-9 * nsec`.",
    )


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


def to_ns(seconds: npt.NDArray[Any], factor: float, where: str) -> npt.NDArray[np.int64]:
    """Stamps in units of ``factor`` seconds, or datetime64 and timedelta64 in nanoseconds, as int64 nanoseconds.

    Integers are multiplied as such. Of floats, whole units and fractions are converted separately, so that a Unix time in
    seconds keeps its float64 precision.
    """
    if not np.all(np.isfinite(seconds)):
        bad = int(np.flatnonzero(~np.isfinite(seconds))[0])
        raise InputError(where, f"no time in row {bad + 1}", "a number in every row", "Remove the row or repair the export.")
    if seconds.dtype.kind in "mM":
        stamps: npt.NDArray[np.int64] = seconds.view(np.int64)
        return stamps
    scale = factor * 1e9
    largest = max(float(np.max(seconds, initial=0)), -float(np.min(seconds, initial=0))) * scale
    if largest > 9.2e18:  # 292 years
        expected = "times that fit into 64 bits of nanoseconds"
        raise InputError(where, f"a time of {largest * 1e-9:.3g} s", expected, "State the right unit of the time column.")
    if seconds.dtype.kind in "iu" and scale == int(scale):
        return scratch.computed(len(seconds), lambda a, b: seconds[a:b].astype(np.int64) * int(scale), np.int64)
    stamps = scratch.empty(len(seconds), np.int64)
    for begin in range(0, len(seconds), _PIECE):
        piece = seconds[begin : begin + _PIECE]
        whole = np.floor(piece)
        units = whole.astype(np.int64) * int(scale) if scale == int(scale) else np.rint(whole * scale).astype(np.int64)
        stamps[begin : begin + _PIECE] = units + np.rint((piece - whole) * scale).astype(np.int64)
    return stamps


def _time_name(
    path: Path,
    values: Mapping[str, npt.NDArray[Any]],
    options: ReadOptions,
    known: tuple[str, ...],
    unread: Mapping[str, str],
) -> str:
    """The time column: that of the recipe, one with such a name, or the only one of dates."""
    named = (options.time,) if options.time is not None else TIME_NAMES
    for name in named:
        if name in values:
            return name
        if name in unread:
            expected = "seconds, timestamps, or (in CSV and JSON) dates with time in ISO 8601: 2026-03-01T12:00:00.5"
            remedy = "Write the time as a number of seconds from any origin."
            raise InputError(f"{path}: column {name!r}", unread[name], expected, remedy)
    if options.time is not None:
        found, expected = f"no time column {options.time!r}", nearest(options.time, known or values)
        raise InputError(path, found, expected, "Correct `time` in the recipe.")
    dated = [name for name, column in values.items() if column.dtype.kind == "M"]
    if len(dated) == 1:
        return dated[0]
    raise InputError(
        path,
        NO_TIME,
        f"a column named {TIME_NAMES[0]!r}; found {', '.join(known or (*values, *unread)) or 'none'}",
        'Name the column in the recipe: `time = "<column>"`, or the rate of evenly spaced rows: `rate_hz = …`.',
    )
