"""Values of one topic as they come, put into columns at once.

Messages go as soon as their values have been cut out, so that a log larger than the memory can be read; of a topic without
wanted fields (``wanted = None``) everything is kept up to :data:`MAX_CELLS`.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.logs.growing import Growing, Rows, Values

#: Fields of one topic; names that change from message to message would otherwise fill the memory.
MAX_FIELDS = 4096
#: Cells of one topic's table (2 GiB) while nothing says which fields are wanted.
MAX_CELLS = 2**28

#: Where the stamp of a message stands: (seconds, nanoseconds).
STAMP_FIELDS = tuple(
    (f"{prefix}.{seconds}", f"{prefix}.{nanoseconds}")
    for prefix in ("header.stamp", "stamp", "timestamp")
    for seconds, nanoseconds in (("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs"), ("seconds", "nanos"))
)
_STAMPS = frozenset(path for pair in STAMP_FIELDS for path in pair)


@dataclass
class Pieces:
    """Columns that grow. ``wanted``: fields to keep besides the stamps, None for all."""

    wanted: frozenset[str] | None = None
    total: int = 0
    bad: array[int] = field(default_factory=lambda: array("q"))
    fields: dict[str, None] = field(default_factory=dict)
    crowded: bool = False
    #: Messages of a preview, whose values have been read; None where those of all messages are.
    previewed: int | None = None
    _columns: dict[str, Growing] = field(default_factory=dict)
    #: Whole numbers as they are: a stamp does not fit a float.
    _stamps: dict[str, Growing] = field(default_factory=dict)

    def expect(self, count: int) -> int:
        """Make ready for so many more messages; returns the row of the first of them."""
        first = self.total
        self.total += count
        if self.wanted is None and self.previewed is None:
            while len(self._columns) > self._room():
                self._columns.popitem()
                self.crowded = True
        return first

    def stamps_only(self) -> None:
        """Values of the messages to come are not kept, only their stamps."""
        if self.previewed is None:
            self.previewed = self.total

    def put(self, path: str, rows: Rows, values: Values) -> None:
        """Values of one field in ``rows``, which rise."""
        if path not in self.fields:
            if len(self.fields) >= MAX_FIELDS:
                self.crowded = True
                return
            self.fields[path] = None
        if not len(rows):
            return
        begin, end = int(rows[0]), int(rows[-1]) + 1
        where = slice(begin, end) if end - begin == len(rows) else rows
        if path in _STAMPS:
            stamps = self._stamps.get(path)
            if stamps is None:
                stamps = self._stamps[path] = Growing(0, values.dtype.newbyteorder("="))
            stamps.put(where, values)
        if self.previewed is not None or (self.wanted is not None and path not in self.wanted):
            return
        column = self._columns.get(path)
        if column is None:
            if self.wanted is None and len(self._columns) >= self._room():
                self.crowded = True
                return
            column = self._columns[path] = Growing(np.nan)
        column.put(where, values)

    def _room(self) -> int:
        """Columns that a table of so many messages may have."""
        return max(1, MAX_CELLS // max(1, self.total))

    def know(self, path: str) -> None:
        """A field that the file has, whether wanted or not."""
        if len(self.fields) < MAX_FIELDS:
            self.fields[path] = None

    def columns(self) -> dict[str, npt.NDArray[np.float64]]:
        """Field → values (total,), of a preview (previewed,); NaN in messages without it. Given away: they can be had once."""
        rows = self.total if self.previewed is None else self.previewed
        return {path: self._columns.pop(path).whole(rows) for path in list(self._columns)}

    def integers(self, path: str) -> npt.NDArray[np.int64] | None:
        """One field of whole numbers, 0 in unreadable messages; None where a readable one lacks it."""
        stamps = self._stamps.get(path)
        if stamps is None or stamps.kind.kind not in "iu" or stamps.found != self.total - len(self.bad):
            return None
        return stamps.whole(self.total)

    def header_stamps(self) -> npt.NDArray[np.int64] | None:
        """When each message says it was measured [ns]; None where it does not say."""
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
