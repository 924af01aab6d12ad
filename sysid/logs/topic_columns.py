"""Columns of one topic that grow while its messages are decoded, each in one block of memory; pages without values are never
allocated.

No message is kept after its values have been extracted, so that a log larger than the memory can be read. Where no fields are
named (``wanted = None``), all are kept up to ``cells``.
"""

from __future__ import annotations

from array import array
from copy import copy
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid import scratch
from sysid.logs.labels import ArrayLabels

_FIRST = 1024

Rows = npt.NDArray[np.intp]
Values = npt.NDArray[Any]


@dataclass
class GrowingArray:
    """Values by row.

    The capacity doubles when it is exhausted; only then values are copied. Unused capacity takes no memory, because the
    operating system allocates a page when it is first written.

    Args:
        fill: value of rows without one.
        kind: type of the values; integers of other types widen it, a float makes it float64.
        found: number of values that were put.
        expected: number of rows, where it is known; a wrong number costs copies or unused capacity.
    """

    fill: float
    kind: np.dtype[Any] = field(default_factory=lambda: np.dtype(np.float64))
    found: int = 0
    _end: int = 0
    expected: int = 0
    _room: Values = field(init=False)

    def __post_init__(self) -> None:
        self._room = np.empty(0, self.kind)

    def __copy__(self) -> GrowingArray:
        twin = GrowingArray(self.fill, self.kind, self.found, self._end)
        twin._room = scratch.empty(self._end, self.kind)
        twin._room[:] = self._room[: self._end]
        return twin

    def put(self, rows: Rows | slice, values: Values) -> None:
        """Values of increasing ``rows``."""
        if not len(values):
            return
        if self.kind.kind in "iu" and values.dtype.newbyteorder("=") != self.kind:
            self._widen(values.dtype)
        if isinstance(rows, slice):
            self._reach(rows.stop, rows.start)
            scratch.put(self._room, rows.start, values)
        else:
            self._reach(int(rows[-1]) + 1)
            self._room[rows] = values
        self.found += len(values)

    def extend(self, values: Values) -> None:
        """Values of the next rows."""
        self.put(slice(self._end, self._end + len(values)), values)

    def whole(self, total: int) -> Values:
        """The values of rows 0 to ``total`` - 1, without a copy."""
        self._reach(total)
        return self._room[:total]

    def _reach(self, end: int, filled: int | None = None) -> None:
        """Extend to ``end`` rows, filled up to ``filled``; the caller writes the rest."""
        if end > len(self._room):
            room = scratch.empty(max(_FIRST, 2 * len(self._room), end, self.expected), self.kind)
            for first, last in scratch.pieces(self._end):
                scratch.put(room, first, self._room[first:last])
            self._room = room
        if end > self._end:
            self._room[self._end : end if filled is None else filled] = self.fill
            self._end = end

    def _widen(self, kind: np.dtype[Any]) -> None:
        self.kind = np.promote_types(self.kind, kind).newbyteorder("=") if self.found else kind.newbyteorder("=")
        room = scratch.empty(len(self._room), self.kind)
        room[: self._end] = self._room[: self._end]
        self._room = room


#: Fields of one topic: names that change from message to message would otherwise fill the memory.
MAX_FIELDS = 4096

#: Fields that hold the stamp of a message: (seconds, nanoseconds).
STAMP_FIELDS = tuple(
    (f"{prefix}.{seconds}", f"{prefix}.{nanoseconds}")
    for prefix in ("header.stamp", "stamp", "timestamp")
    for seconds, nanoseconds in (("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs"), ("seconds", "nanos"))
)
STAMP_PATHS = frozenset(path for pair in STAMP_FIELDS for path in pair)


@dataclass
class TopicColumns:
    """Columns that grow.

    Args:
        wanted: fields to keep besides the stamps; None for all.
        cells: limit of the topic's table where ``wanted`` is None.
    """

    wanted: frozenset[str] | None = None
    cells: int = 2**28
    total: int = 0
    bad: array[int] = field(default_factory=lambda: array("q"))
    fields: dict[str, None] = field(default_factory=dict)
    labels: ArrayLabels = field(default_factory=ArrayLabels)
    crowded: bool = False
    #: Number of messages of a preview, of which the values are read; None: all.
    previewed: int | None = None
    _columns: dict[str, GrowingArray] = field(default_factory=dict)
    #: Names with the same values in every message (``position[2]``, ``position[boom]``) → their common column.
    _sharing: dict[tuple[str, ...], GrowingArray] = field(default_factory=dict)
    #: Integers: a stamp in nanoseconds does not fit a float.
    _stamps: dict[str, GrowingArray] = field(default_factory=dict)

    def expect(self, count: int) -> int:
        """Prepare for ``count`` more messages; returns the row of the first."""
        first = self.total
        self.total += count
        if self.wanted is None and self.previewed is None:
            while len(self._columns) > self._room() and len(self._sharing) > 1:
                for name in self._sharing.popitem()[0]:
                    del self._columns[name]
                self.crowded = True
        return first

    def stamps_only(self) -> None:
        """From the next message on, keep only stamps."""
        if self.previewed is None:
            self.previewed = self.total

    def put(self, names: tuple[str, ...], rows: Rows, values: Values) -> None:
        """Values of one field under all its names, in increasing ``rows``."""
        if not len(rows):
            return
        begin, end = int(rows[0]), int(rows[-1]) + 1
        where = slice(begin, end) if end - begin == len(rows) else rows
        for column in self._kept(tuple(name for name in names if self._is_new_or_known(name))):
            column.put(where, values)
        for name in names:
            if name in STAMP_PATHS:
                stamps = self._stamps.get(name)
                if stamps is None:
                    stamps = self._stamps[name] = GrowingArray(0, values.dtype.newbyteorder("="))
                stamps.put(where, values)

    def _is_new_or_known(self, name: str) -> bool:
        if name not in self.fields:
            if len(self.fields) >= MAX_FIELDS and (self.wanted is None or name not in self.wanted):
                self.crowded = True
                return False
            self.fields[name] = None
        return True

    def _kept(self, names: tuple[str, ...]) -> list[GrowingArray]:
        """The columns of values under these names: one where the names have always had the same values, else one for each."""
        if self.previewed is not None:
            return []
        if self.wanted is not None:
            names = tuple(name for name in names if name in self.wanted)
        known = self._sharing.get(names)
        if known is not None:
            return [known]
        if not any(name in self._columns for name in names):
            if self.wanted is None and len(self._columns) + len(names) > self._room():
                self.crowded = True
                return []
            column = GrowingArray(np.nan)
            self._columns.update(dict.fromkeys(names, column))
            if names:
                self._sharing[names] = column
            return [column]
        for others in [others for others in self._sharing if len(others) > 1 and not set(others).isdisjoint(names)]:
            shared = self._sharing.pop(others)
            for name in others:
                self._columns[name] = self._sharing[(name,)] = copy(shared)
        return [column for name in names for column in self._kept((name,))]

    def _room(self) -> int:
        """Number of columns allowed for the messages so far."""
        return max(1, self.cells // max(1, self.total))

    @property
    def held(self) -> int:
        """Number of values kept, each column once."""
        columns = {id(column): column.found for column in (*self._columns.values(), *self._stamps.values())}
        return sum(columns.values())

    def know(self, path: str) -> None:
        """Note a field of the file that is not wanted."""
        if len(self.fields) < MAX_FIELDS:
            self.fields[path] = None

    def release(self) -> dict[str, npt.NDArray[np.float64]]:
        """Field → values (total,), of a preview (previewed,); NaN in messages without it. Moved out: callable once."""
        rows = self.total if self.previewed is None else self.previewed
        self._sharing.clear()
        columns = {name: self._columns.pop(name).whole(rows) for name in list(self._columns)}
        for values in columns.values():
            values.setflags(write=False)  # two names may share them
        return columns

    def integers(self, path: str) -> npt.NDArray[np.int64] | None:
        """An integer field, 0 in unreadable messages; None where a readable message lacks it."""
        stamps = self._stamps.get(path)
        if stamps is None or stamps.kind.kind not in "iu" or stamps.found != self.total - len(self.bad):
            return None
        return stamps.whole(self.total)

    def header_stamps(self) -> npt.NDArray[np.int64] | None:
        """Stamps of measurement in the messages [ns]; None where they have none."""
        for seconds, nanoseconds in STAMP_FIELDS:
            whole, rest = self.integers(seconds), self.integers(nanoseconds)
            if whole is not None and rest is not None:
                stamps = whole.astype(np.int64)
                stamps *= 1_000_000_000
                stamps += rest.astype(np.int64)
                return stamps
        return None

    def readable(self) -> npt.NDArray[np.bool_]:
        """Which messages could be decoded, (total,)."""
        result = np.ones(self.total, dtype=bool)
        result[np.asarray(self.bad, dtype=np.intp)] = False
        return result
