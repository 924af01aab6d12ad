"""The interface of a log reader, and its options."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from sysid.errors import InputError, nearest
from sysid.logs.limits import MAX_TEXT, Budget, check_file
from sysid.logs.stream import Stream


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


class LogReader(Protocol):
    """Reader of one file format. ``clocks`` lists the stamps of its streams, the default first."""

    @property
    def name(self) -> str: ...

    @property
    def suffixes(self) -> tuple[str, ...]: ...

    @property
    def clocks(self) -> tuple[str, ...]: ...

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        """All streams of the file.

        Raises:
            InputError: the file is empty, not of this format or version, or takes more than its budget.
        """
        ...
