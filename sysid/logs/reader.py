"""What a log reader is: a name, the suffixes it takes, the clocks its streams carry, and ``read``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from sysid.logs.stream import Stream


@dataclass(frozen=True)
class ReadOptions:
    """What a recipe can tell a reader.

    Args:
        streams: read these streams (topics) alone; None reads all.
        fields: topic → fields to read of it (bags); None reads all. Memory is that of the fields read.
        preview: for a look into a bag: all stamps, but values of the first messages of a topic alone.
        seconds: for a look at the beginning: a reader may leave unread what comes so many seconds after the first stamp.
        time: column or variable that holds the stamps (CSV, Parquet, MATLAB).
        time_unit: unit of that column.
        rate_hz: sample rate of a table that has no stamps at all; its rows are then evenly spaced, the first one at zero.
        length_unit: unit of positions where the file does not state one (Motive).
        rotation: order of Euler angles where the file does not state it (Motive), e.g. ``XYZ``.
        dbc: database that says which signals CAN frames carry.
    """

    streams: frozenset[str] | None = None
    fields: Mapping[str, frozenset[str]] | None = None
    preview: bool = False
    seconds: float | None = None
    time: str | None = None
    time_unit: str = "s"
    rate_hz: float | None = None
    length_unit: str | None = None
    rotation: str | None = None
    dbc: Path | None = None


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
            InputError: the file is empty, not of this format, or of a version that is not supported.
        """
        ...
