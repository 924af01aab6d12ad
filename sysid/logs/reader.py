"""What a log reader is: a name, the suffixes it takes, the clocks its streams carry, and ``read``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from sysid.logs.limits import MAX_TEXT, Budget, check_file
from sysid.logs.stream import Stream


def _silent(share: float) -> None:
    """A listener that does not care."""


@dataclass(frozen=True)
class ReadOptions:
    """What a recipe can tell a reader.

    Args:
        streams: read these streams (topics) alone; None reads all.
        fields: topic → fields to read of it (bags); None reads all. Memory is that of the fields read.
        columns: of a table with one stream (CSV, Parquet, MATLAB): those to read beside the time; None reads all.
        preview: for a look into a bag: all stamps, but values of the first messages of a topic alone.
        seconds: for a look at the beginning: a reader may leave unread what comes so many seconds after the first stamp.
        time: column or variable that holds the stamps (CSV, Parquet, MATLAB).
        time_unit: unit of that column.
        rate_hz: sample rate of a table that has no stamps at all; its rows are then evenly spaced, the first one at zero.
        length_unit: unit of positions where the file does not state one (Motive).
        rotation: order of Euler angles where the file does not state it (Motive), e.g. ``XYZ``.
        dbc: database that says which signals CAN frames carry.
        budget: what reading may take; None: what a file of its size may.
        progress: called with the share of the file that has been read, by readers that know it.
    """

    streams: frozenset[str] | None = None
    fields: Mapping[str, frozenset[str]] | None = None
    columns: frozenset[str] | None = None
    preview: bool = False
    seconds: float | None = None
    time: str | None = None
    time_unit: str = "s"
    rate_hz: float | None = None
    length_unit: str | None = None
    rotation: str | None = None
    dbc: Path | None = None
    budget: Budget | None = None
    progress: Callable[[float], None] = _silent

    def budget_of(self, path: Path, what: str, limit: int | None = MAX_TEXT) -> Budget:
        """What reading ``path`` may take: the budget that is given, or that of the file and the CAN database with it.

        Raises:
            InputError: missing, a pipe, a device or a folder, without bytes, or more than ``limit`` bytes.
        """
        size = check_file(path, what, limit)
        if self.budget is not None:
            return self.budget
        return Budget.of(size + (self.dbc.stat().st_size if self.dbc is not None and self.dbc.is_file() else 0))


#: Everything that is in a file.
ALL = ReadOptions()


class LogReader(Protocol):
    """One file format. ``clocks`` lists the stamps its streams may carry, the default first."""

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
