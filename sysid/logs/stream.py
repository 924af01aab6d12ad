"""A stream: the samples of one sensor or controller in one file, with their own stamps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError, nearest


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
