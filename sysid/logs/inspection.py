"""Content of a log file: streams, fields with their ranges, rates, gaps, and the differences between clocks of a stream."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.confined import confined
from sysid.errors import InputError
from sysid.logs.csv import CsvReader
from sysid.logs.labels import without_repeats
from sysid.logs.lerobot import data_files, is_lerobot
from sysid.logs.reader import LogReader, ReadOptions, Stream
from sysid.logs.readers import NAMED, NO_LOGS, is_log, reader_for, reader_named
from sysid.logs.table import NO_TIME, TIME_NAMES, TableReader, guess_time
from sysid.logs.time_unit import TimeUnit
from sysid.logs.topic_columns import STAMP_PATHS
from sysid.numbers import LARGEST_COUNT
from sysid.units import si_factor, split_header

#: A step between two stamps that is longer than this multiple of the median is a gap.
GAP = 3.0
#: Fields of a header, which are listed as clocks.
_HEADER = STAMP_PATHS | {"header.seq"}


@dataclass(frozen=True)
class FieldSummary:
    """Range and share of missing values of one field; in a long log of its beginning."""

    name: str
    unit: str | None
    low: float
    high: float
    missing: float


@dataclass(frozen=True)
class ClockSummary:
    """The stamps of one clock of a stream.

    Args:
        rate_hz: 1 / median step.
        jitter_s: 95 % of the steps differ from the median step by at most this [s].
        gaps: number of steps longer than :data:`GAP` median steps; the longest of them [s] and its begin [s from the first
            stamp].
        backwards: number of steps back in time.
        behind_s: these stamps minus those of the stream's first clock: median, 5 % and 95 % quantiles [s].
    """

    name: str
    first_ns: int
    seconds: float
    rate_hz: float
    jitter_s: float
    gaps: int
    longest_gap_s: float
    longest_gap_at_s: float
    backwards: int
    behind_s: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class StreamSummary:
    """One topic, rigid body, marker, message or table."""

    name: str
    kind: str
    samples: int
    clocks: tuple[ClockSummary, ...]
    fields: tuple[FieldSummary, ...]
    unread_fields: int = 0


@dataclass(frozen=True)
class FileSummary:
    """One log file.

    Args:
        stated: keys that a recipe has to state, with assumed values, as :class:`~sysid.logs.reader.ReadOptions` has them.
        refusal: why it is not read.
        remarks: what was found about the form of a text table, as sentences.
        columns: names of the columns of a table without a header row, which a recipe has to state.
        time_units: plausible units of the time, where nothing decides between them.
        untimed: whether it is a table without a column of times, so that the rate of its rows has to be stated.
    """

    path: Path
    reader: str
    size: int
    streams: tuple[StreamSummary, ...] = ()
    losses: tuple[str, ...] = ()
    stated: Mapping[str, Any] = field(default_factory=dict)
    refusal: str = ""
    remarks: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    time_units: tuple[TimeUnit, ...] = ()
    untimed: bool = False


#: Types that return from the process in which a file is read.
_SUMMARIES = (FileSummary, StreamSummary, FieldSummary, ClockSummary, TimeUnit)


def log_files(paths: Sequence[Path], reader: str | None) -> list[Path]:
    """The log files in ``paths`` and one folder below; with a named ``reader``, also those that only it reads."""
    found: list[Path] = []
    for path in paths:
        if not path.exists():
            raise InputError(path, "no such file or folder", "a log file or a folder of them", "Check the path.")
        if path.is_file():
            found.append(path)
            continue
        if is_lerobot(path):
            found += data_files(path)
            continue
        entries = [entry for pattern in ("*", "*/*") for entry in path.glob(pattern) if entry.is_file()]
        below = [entry for entry in entries if is_log(entry) or NAMED.get(entry.suffix.lower(), "") == reader]
        if not below:
            known = next((entry for entry in entries if entry.suffix.lower() in NO_LOGS), None)
            expected, remedy = "log files in it or one folder below", "Name the file itself."
            if known is not None:
                what, remedy = NO_LOGS[known.suffix.lower()]
                named = NAMED.get(known.suffix.lower())
                remedy = f"Inspect with --reader {named} where it is a log." if named is not None else remedy
                raise InputError(path, f"no log files; {known.name} is {what}", expected, remedy.format(name=known.name))
            raise InputError(path, "no log files", expected, remedy)
        found += sorted(below)
    return list(dict.fromkeys(found))


def inspect_file(
    path: Path,
    reader: str | None = None,
    dbc: Path | None = None,
    expected_hz: float | None = None,
    rate_hz: float | None = None,
) -> FileSummary:
    """Summary of a file; one that cannot be read has a refusal.

    Args:
        dbc: the database of a CAN log.
        expected_hz: rate of the machine [Hz], which may decide between units of time.
        rate_hz: rate of the rows of tables without a column of times [Hz].

    Raises:
        InputError: no such file, or no reader for its suffix.
        SettingsError: no reader has the name ``reader``.
    """
    if not path.exists():
        raise InputError(path, "no such file", "a log file", "Check the path.")
    chosen = reader_named(reader, path) if reader is not None else reader_for(path)
    si_factor("1")  # loads the unit library here once, not in the process of every file
    try:
        budget = ReadOptions(dbc=dbc).budget_of(path, "a log file", None)
        return confined(lambda report: inspect_here(path, chosen, dbc, expected_hz, rate_hz), path, budget.limits, _SUMMARIES)
    except (InputError, PermissionError) as error:
        return FileSummary(path, chosen.name, path.stat().st_size, refusal=_refusal(path, error))


def inspect_here(
    path: Path,
    chosen: LogReader,
    dbc: Path | None = None,
    expected_hz: float | None = None,
    rate_hz: float | None = None,
) -> FileSummary:
    """:func:`inspect_file` by the reader ``chosen`` in this process, without protection against crashes of a library."""
    summary = FileSummary(path, chosen.name, path.stat().st_size)
    try:
        if isinstance(chosen, CsvReader):
            dialect = chosen.dialect(path)
            names = () if dialect.named else dialect.headers
            summary = replace(summary, remarks=dialect.remarks, columns=names)
        stated, units = _unstated(path, chosen, summary.columns, expected_hz)
        summary = replace(summary, stated=stated, time_units=units if len(units) > 1 else ())
        try:
            streams = chosen.read(path, _preview(summary, dbc))
        except InputError as error:
            summary = replace(summary, untimed=error.found == NO_TIME)
            if rate_hz is None or not summary.untimed:
                raise
            summary = replace(summary, stated={"rate_hz": rate_hz})
            streams = chosen.read(path, _preview(summary, dbc))
        if "length_unit" in stated and (likely := _likely_unit(streams)) != stated["length_unit"]:
            summary = replace(summary, stated={**stated, "length_unit": likely})
            streams = chosen.read(path, _preview(summary, dbc))
    except InputError as error:
        return replace(summary, streams=_bare(path, chosen, summary.columns), refusal=_refusal(path, error))
    except PermissionError as error:
        return replace(summary, refusal=_refusal(path, error))
    losses = tuple(dict.fromkeys(loss for stream in streams for loss in (*stream.losses, *stream.left_out)))
    return replace(summary, streams=tuple(summarise(stream) for stream in streams), losses=losses)


def _refusal(path: Path, error: Exception) -> str:
    return f"{path}: may not be read (permission denied)" if isinstance(error, PermissionError) else str(error)


def _preview(summary: FileSummary, dbc: Path | None) -> ReadOptions:
    return ReadOptions(preview=True, header=summary.columns, dbc=dbc, **{"time_unit": "s", **summary.stated})


def _likely_unit(streams: Iterable[Stream]) -> str:
    """The likely unit of positions that were read as metres: no capture volume is 50 m wide, few are 10 m."""
    places = [values for stream in streams for axis, values in stream.columns.items() if axis in ("x", "y", "z")]
    seen = [np.abs(values[np.isfinite(values)]) for values in places]
    reach = max((float(np.median(values)) for values in seen if len(values)), default=0.0)
    return "m" if reach < 50.0 else "cm" if reach < 1000.0 else "mm"


def _bare(path: Path, reader: LogReader, header: tuple[str, ...]) -> tuple[StreamSummary, ...]:
    """The columns of a table without a time column."""
    if not isinstance(reader, TableReader):
        return ()
    try:
        columns = reader.table(path, ReadOptions(header=header)).numbers
    except InputError:
        return ()
    fields = tuple(_field(*split_header(header), values) for header, values in columns)
    return (StreamSummary(path.stem, "", len(columns[0][1]), (), fields),) if columns else ()


def _unstated(
    path: Path, reader: LogReader, header: tuple[str, ...], expected_hz: float | None
) -> tuple[dict[str, Any], tuple[TimeUnit, ...]]:
    """Keys that a recipe has to state for this file, with likely values, and the plausible units of its time."""
    if not isinstance(reader, TableReader):
        return dict(reader.unstated(path)), ()
    guess = guess_time(reader.table(path, ReadOptions(header=header)).numbers, expected_hz)
    if guess is None:
        return {}, ()
    stated: dict[str, Any] = {} if guess.name in TIME_NAMES else {"time": guess.name}
    if guess.units and (len(guess.units) > 1 or guess.units[0].unit != "s"):
        stated["time_unit"] = guess.units[0].unit
    return stated, guess.units


def summarise(stream: Stream) -> StreamSummary:
    """Summary of a stream."""
    first = next(iter(stream.stamps.values()))
    clocks = tuple(_clock(name, stamps, first) for name, stamps in stream.stamps.items())
    shown = [name for name in without_repeats(stream.columns) if name not in _HEADER]
    fields = tuple(_field(name, stream.units.get(name), stream.columns[name]) for name in shown)
    return StreamSummary(
        stream.name, stream.kind, len(stream), clocks, fields, max(0, len(stream.fields) - len(stream.columns))
    )


def _field(name: str, unit: str | None, values: npt.NDArray[np.float64]) -> FieldSummary:
    seen = values[np.abs(values) <= LARGEST_COUNT]  # neither missing nor an overflow
    low, high = (float(seen.min()), float(seen.max())) if len(seen) else (float("nan"), float("nan"))
    return FieldSummary(name, unit, low, high, 1.0 - len(seen) / max(len(values), 1))


def _clock(name: str, stamps: npt.NDArray[np.int64], first: npt.NDArray[np.int64]) -> ClockSummary:
    steps = np.diff(stamps) * 1e-9
    forward = steps[steps > 0.0]
    usual = float(np.median(forward)) if len(forward) else float("nan")
    long = np.flatnonzero(steps > GAP * usual) if len(forward) else np.zeros(0, np.intp)
    worst = int(np.argmax(steps)) if len(long) else 0
    behind = None
    if stamps is not first:
        low, middle, high = np.quantile((stamps - first) * 1e-9, [0.05, 0.5, 0.95])
        behind = (float(middle), float(low), float(high))
    return ClockSummary(
        name=name,
        first_ns=int(stamps[0]),
        seconds=(float(stamps.max()) - float(stamps.min())) * 1e-9,
        rate_hz=1.0 / usual if usual else float("nan"),
        jitter_s=float(np.quantile(np.abs(forward - usual), 0.95)) if len(forward) else float("nan"),
        gaps=len(long),
        longest_gap_s=float(steps[worst]) if len(long) else 0.0,
        longest_gap_at_s=float(stamps[worst] - stamps[0]) * 1e-9 if len(long) else 0.0,
        backwards=int(np.count_nonzero(steps < 0.0)),
        behind_s=behind,
    )
