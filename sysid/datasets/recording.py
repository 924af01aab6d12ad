"""A dataset version in memory: aligned recordings of one machine, with their provenance."""

from __future__ import annotations

import functools
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pandas as pd

from sysid.datasets.chunked import Array
from sysid.datasets.clocks import ClockRecord as ClockRecord
from sysid.errors import InputError, StoreError, nearest
from sysid.machine import Machine
from sysid.scratch import filled

Role = Literal["fit", "select", "held_out"]
Kind = Literal["motion", "poses"]


@dataclass(frozen=True)
class Recording:
    """One wide table after alignment.

    Args:
        name: unique in its dataset.
        table: ``time`` [s] and one float64 column a signal (SI), on the grid k/rate_hz for ``motion``; NaN where nothing was
            measured. For ``poses`` each row is one static pose and ``time`` is the middle of its still phase.
        rate_hz: sample rate of a ``motion`` recording.
        start_ns: stamp of ``time == 0`` on the machine's clock.
    """

    name: str
    table: pd.DataFrame
    rate_hz: float
    kind: Kind = "motion"
    start_ns: int = 0

    def __len__(self) -> int:
        return len(self.table)

    @property
    def signals(self) -> tuple[str, ...]:
        return tuple(str(column) for column in self.table.columns if column != "time")

    def values(self, signal: str) -> Array:
        """The signal as float64 (n,), read-only; all NaN where the recording does not have it."""
        found = self._arrays.get(signal)
        if found is None:
            if signal in self.table.columns:
                found = self.table[signal].to_numpy(dtype=np.float64).view()
                found.setflags(write=False)
            else:
                found = _missing(len(self.table))
            self._arrays[signal] = found
        return found

    @functools.cached_property
    def derived(self) -> dict[Hashable, Any]:
        """A cache of results that depend on this recording alone, with keys of the modules that use it."""
        return {}

    @functools.cached_property
    def _arrays(self) -> dict[str, Array]:
        """Plain arrays of signals, without a copy, because a fit accesses them thousands of times."""
        return {}


_longest_missing = np.empty(0)


def _missing(count: int) -> Array:
    """An array (count,) of NaN, read-only: a part of the longest one, which all recordings share."""
    global _longest_missing
    if len(_longest_missing) < count:
        _longest_missing = filled(count, np.nan)
        _longest_missing.setflags(write=False)
    return _longest_missing[:count]


@dataclass(frozen=True)
class Source:
    """A raw file."""

    path: str
    sha256: str
    size: int
    losses: tuple[str, ...] = ()


@dataclass(frozen=True)
class Dataset:
    """An immutable dataset version.

    ``version`` counts from 1 in its workspace; ``digest`` is its content address; ``streams``: file stem → its signals.
    """

    name: str
    version: int
    digest: str
    machine: Machine
    recordings: tuple[Recording, ...]
    units: Mapping[str, str]
    splits: Mapping[str, Role] = field(default_factory=dict)
    sources: tuple[Source, ...] = ()
    clocks: tuple[ClockRecord, ...] = ()
    quality: Mapping[str, Any] = field(default_factory=dict)
    streams: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @classmethod
    def of(cls, machine: Machine, recordings: Iterable[Recording], splits: Mapping[str, Role] | None = None) -> Dataset:
        """Tables in memory as a dataset that is in no store: version 1, a digest of zeros.

        Raises:
            InputError: two recordings of one name, or a role of a recording that is not there.
        """
        recordings, splits = tuple(recordings), dict(splits or {})
        names = [recording.name for recording in recordings]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"recordings of {machine.name}", f"{names.count(name)} named {name!r}", "a name for each")
        for name in splits:
            if name not in names:
                raise InputError(f"splits of {machine.name}", f"a role of {name!r}", nearest(name, names))
        return cls(machine.name, 1, "0" * 64, machine, recordings, {}, splits)

    @property
    def reference(self) -> str:
        """``name@version``."""
        return f"{self.name}@{self.version}"

    def recording(self, name: str) -> Recording:
        for recording in self.recordings:
            if recording.name == name:
                return recording
        raise StoreError(self.reference, f"no recording {name!r}", nearest(name, [r.name for r in self.recordings]))

    def of_kind(self, kind: Kind) -> tuple[Recording, ...]:
        return tuple(recording for recording in self.recordings if recording.kind == kind)

    def with_role(self, *roles: Role, kind: Kind = "motion") -> tuple[Recording, ...]:
        """The recordings of ``kind`` whose split is one of ``roles``, in the dataset's order."""
        return tuple(r for r in self.of_kind(kind) if self.splits.get(r.name) in roles)
