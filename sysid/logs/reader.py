"""The interface of a log reader: its options, the streams that it gives, and reading in a process of its own
(:mod:`sysid.confined`), with the memory and processor time of the log's budget.

A stream is the samples of one sensor or controller in one file, with their own stamps.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sysid.confined import confined
from sysid.errors import InputError, nearest
from sysid.logs.limits import MAX_TEXT, Budget, check_file
from sysid.units import si_factor


@dataclass(frozen=True)
class Stream:
    """One table of one log file, before any alignment.

    Args:
        name: topic, rigid body, or file stem; unique within its file.
        source: the file it was read from.
        stamps: clock name (``log``, ``publish``, ``header``, ``capture``) → int64 nanoseconds, each (n,).
        columns: field name → float64 values (n,), NaN where the file has none.
        units: field name → unit as the file states it; a field without an entry has none stated.
        losses: what could not be read, as sentences for the quality report.
        fields: every field of the file, where only some were read; empty where all were.
        kind: message type, where the file names one.
        unread: name of a column of a table that has no numbers → what it has instead.
    """

    name: str
    source: Path
    stamps: Mapping[str, npt.NDArray[np.int64]]
    columns: Mapping[str, npt.NDArray[np.float64]]
    units: Mapping[str, str] = field(default_factory=dict)
    losses: tuple[str, ...] = ()
    fields: tuple[str, ...] = ()
    kind: str = ""
    unread: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(next(iter(self.stamps.values())))

    @property
    def left_out(self) -> tuple[str, ...]:
        """The columns without numbers, as sentences; of many the first three and the number of the others."""
        found = tuple(f"column {name!r} left out: {reason}" for name, reason in self.unread.items())
        return found if len(found) <= 4 else (*found[:3], f"{len(found) - 3} more columns without numbers left out")

    def on_clock(self, clock: str | None) -> npt.NDArray[np.int64]:
        """The stamps of a clock, (n,) [ns]; None: of the first.

        Raises:
            InputError: the stream does not have that clock.
        """
        if clock is not None and clock not in self.stamps:
            why = next((f" ({loss})" for loss in self.losses if f"no clock {clock!r}" in loss), "")
            remedy = f'Set `clock = "{next(iter(self.stamps))}"` in the recipe.'
            raise InputError(f"{self.source}: {self.name}", f"no {clock!r} stamps{why}", nearest(clock, self.stamps), remedy)
        return self.stamps[clock if clock is not None else next(iter(self.stamps))]


@dataclass(frozen=True)
class ReadOptions:
    """Settings of a reader.

    Args:
        streams: names of the streams (topics) to read; None reads all.
        fields: topic → fields to read (bags); None reads all. Only these take memory.
        columns: of a table with one stream (CSV, Parquet, MATLAB): those to read beside the time; None reads all.
        part: the file is one of several parts of a bag: a wanted topic may have no message in it.
        preview: read all stamps of a bag, but only the values of the first messages of each topic.
        seconds: a reader may skip everything later than this after the first stamp [s].
        time: column or variable that holds the stamps (CSV, Parquet, MATLAB).
        time_unit: unit of that column; None: that of its header, else seconds where the rate is plausible.
        expected_hz: rate of the machine [Hz], which decides between units of time in the error about an implausible one.
        rate_hz: sample rate of a table without stamps, whose rows are evenly spaced from zero [Hz].
        header: names of the columns of a CSV file without a header row, or instead of its own; empty: those of the file.
        delimiter, decimal: of a CSV file; None: found from its rows.
        length_unit: unit of positions where the file states none.
        rotation: order of Euler angles where the file does not state it (Motive), e.g. ``XYZ``.
        dbc: database (DBC) of a CAN log.
        budget: limits of memory and time; None: those of a file of its size.
        progress: called with the share of the file that has been read.
    """

    streams: frozenset[str] | None = None
    fields: Mapping[str, frozenset[str]] | None = None
    columns: frozenset[str] | None = None
    part: bool = False
    preview: bool = False
    seconds: float | None = None
    time: str | None = None
    time_unit: str | None = None
    expected_hz: float | None = None
    rate_hz: float | None = None
    header: tuple[str, ...] = ()
    delimiter: str | None = None
    decimal: str | None = None
    length_unit: str | None = None
    rotation: str | None = None
    dbc: Path | None = None
    budget: Budget | None = None
    progress: Callable[[float], None] = lambda share: None

    def wants(self, stream: str) -> bool:
        """Whether the stream is to be read."""
        return self.streams is None or stream in self.streams

    def check_streams(self, path: Path, names: Iterable[str], what: str, remedy: str = "Correct the recipe.") -> None:
        """Raise InputError where a wanted stream, such as a marker, is not among the ``names`` of the file."""
        known = set(names)
        for wanted in sorted(self.streams or ()):
            if wanted not in known:
                raise InputError(path, f"no {what} {wanted!r}", nearest(wanted, known), remedy)

    def budget_of(self, path: Path, what: str, limit: int | None = MAX_TEXT) -> Budget:
        """The given budget, or that of the file together with its CAN database.

        Raises:
            InputError: missing, a pipe, a device or a folder, without bytes, or more than ``limit`` bytes.
        """
        size = check_file(path, what, limit)
        if self.budget is not None:
            return self.budget
        return Budget.of(size + (self.dbc.stat().st_size if self.dbc is not None and self.dbc.is_file() else 0))


#: Reads everything.
ALL = ReadOptions()


class LogReader(ABC):
    """Reader of one file format. ``clocks`` lists the stamps of its streams, the default first."""

    name: str
    suffixes: tuple[str, ...] = ()
    clocks: tuple[str, ...]

    @abstractmethod
    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        """All streams of the file.

        Raises:
            InputError: the file is empty, not of this format or version, or takes more than its budget.
        """

    def unstated(self, path: Path) -> dict[str, str]:
        """Keys that a recipe has to state because the file does not, with a common value."""
        return {}


def read_confined(reader: LogReader, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
    """``reader.read(path, options)`` in a process of its own.

    Raises:
        InputError: as of the reader; it took more than its budget, or crashed.
    """
    limits = options.budget_of(path, "a log file", None).limits
    si_factor("1")  # loads the unit library here once, not in the process of every file
    return confined(
        lambda report: reader.read(path, replace(options, progress=report)), path, limits, (Stream,), options.progress
    )
