"""A column that grows while a log is read, in one block of memory; pages without values are never allocated."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid import scratch

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
            room[: self._end] = self._room[: self._end]
            self._room = room
        if end > self._end:
            self._room[self._end : end if filled is None else filled] = self.fill
            self._end = end

    def _widen(self, kind: np.dtype[Any]) -> None:
        self.kind = np.promote_types(self.kind, kind).newbyteorder("=") if self.found else kind.newbyteorder("=")
        room = scratch.empty(len(self._room), self.kind)
        room[: self._end] = self._room[: self._end]
        self._room = room
