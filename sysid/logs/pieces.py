"""Values of one topic as they come: collected piece by piece, made into columns at the end.

Messages go as soon as their values have been cut out, so that a log larger than the memory can be read; of a topic without
wanted fields (``wanted = None``) everything is kept up to :data:`MAX_CELLS`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

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

Rows = npt.NDArray[np.intp]
Values = npt.NDArray[Any]


@dataclass
class Pieces:
    """Columns that grow. ``wanted``: fields to keep besides the stamps, None for all."""

    wanted: frozenset[str] | None = None
    total: int = 0
    bad: list[int] = field(default_factory=list)
    fields: dict[str, None] = field(default_factory=dict)
    crowded: bool = False
    _parts: dict[str, list[tuple[int | Rows, Values]]] = field(default_factory=dict)

    def put(self, path: str, rows: Rows, values: Values) -> None:
        """Values of one field in ``rows``, which rise."""
        if path not in self.fields:
            if len(self.fields) >= MAX_FIELDS:
                self.crowded = True
                return
            self.fields[path] = None
        if self.wanted is not None and path not in self.wanted and path not in _STAMPS:
            return
        together = len(rows) and int(rows[-1]) - int(rows[0]) + 1 == len(rows)
        self._parts.setdefault(path, []).append((int(rows[0]) if together else rows, values))

    def know(self, path: str) -> None:
        """A field that the file has, whether wanted or not."""
        if len(self.fields) < MAX_FIELDS:
            self.fields[path] = None

    def columns(self) -> dict[str, npt.NDArray[np.float64]]:
        """Field → values (total,), NaN in messages that do not have it. Can be asked for once: the pieces go."""
        paths = list(self._parts)
        if self.wanted is not None:
            paths = [path for path in paths if path in self.wanted]
        elif self.total:
            room = max(1, MAX_CELLS // self.total)
            self.crowded = self.crowded or len(paths) > room
            paths = paths[:room]
        return {path: self._column(self._parts.pop(path)) for path in paths}

    def _column(self, parts: list[tuple[int | Rows, Values]]) -> npt.NDArray[np.float64]:
        if len(parts) == 1 and len(parts[0][1]) == self.total:
            return parts[0][1].astype(np.float64)
        column = np.full(self.total, np.nan)
        for rows, values in parts:
            column[rows if not isinstance(rows, int) else slice(rows, rows + len(values))] = values
        return column

    def integers(self, path: str) -> npt.NDArray[np.int64] | None:
        """One integer field without the detour over float64, 0 in unreadable messages; None where a readable one lacks it."""
        result = np.zeros(self.total, np.int64)
        found = 0
        for rows, values in self._parts.get(path, ()):
            if values.dtype.kind not in "iu":
                return None
            result[rows if not isinstance(rows, int) else slice(rows, rows + len(values))] = values
            found += len(values)
        return result if found and found == self.total - len(self.bad) else None

    def header_stamps(self) -> npt.NDArray[np.int64] | None:
        """When each message says it was measured [ns]; None where it does not say."""
        for seconds, nanoseconds in STAMP_FIELDS:
            whole, rest = self.integers(seconds), self.integers(nanoseconds)
            if whole is not None and rest is not None:
                return whole * 1_000_000_000 + rest
        return None

    def readable(self) -> npt.NDArray[np.bool_]:
        """Which messages could be decoded, (total,)."""
        result = np.ones(self.total, dtype=bool)
        result[self.bad] = False
        return result
