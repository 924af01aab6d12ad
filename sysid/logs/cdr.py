"""Messages of one type → columns, many messages at once: CDR (ROS 2) and packed (ROS 1).

One message is walked to learn its layout (:mod:`sysid.logs.layout`); every other message whose length words, byte order and
naming strings are the same, byte for byte, has the same layout, and its columns are cut out by NumPy. What does not match is
walked in turn: a log with few layouts costs few walks, one with a new layout in every message is read message by message.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.logs.layout import Bytes, Layout, learn_layout
from sysid.logs.pieces import Pieces
from sysid.logs.rosmsg import Definition

#: Layouts of one message size that are tried before a message is walked.
MAX_LAYOUTS = 64
#: Key of the layouts that begin messages of any size.
_ANY_SIZE = -1
#: Bytes of messages that are compared and cut at once.
_GATHERED = 16 * 2**20


@dataclass
class ColumnDecoder:
    """Turns the messages of one topic into columns, batch by batch.

    Args:
        definition: their type.
        wanted: fields to read besides the stamps; None for all.
        preview: read all fields of the first so many messages, and only the stamps of those after them.
        packed: as ROS 1 writes them.
        cells: of the topic's table while nothing says which fields are wanted.
    """

    definition: Definition
    wanted: frozenset[str] | None = None
    preview: int | None = None
    packed: bool = False
    cells: int = 2**28
    pieces: Pieces = field(init=False)
    reason: str = ""
    _layouts: dict[int, list[Layout]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.pieces = Pieces(self.wanted, self.cells)
        if self.wanted is not None:
            self.wanted |= self.definition.stamp_fields()

    def add(self, buffer: Bytes, starts: npt.NDArray[np.int64], sizes: npt.NDArray[np.int64]) -> None:
        """Take messages ``buffer[start : start + size]``; they are copied, the buffer may go."""
        if self.preview is not None and self.pieces.total >= self.preview:
            self._stamps_only()
        first = self.pieces.expect(len(starts))
        if self.wanted is not None and not self.wanted:
            return
        left = self._known(_ANY_SIZE, buffer, starts, sizes, np.arange(len(starts)), first)
        while len(left):
            alike = sizes[left] == sizes[left[0]]
            own = self._known(int(sizes[left[0]]), buffer, starts, sizes, left[alike], first)
            left = np.union1d(own, left[~alike]) if len(own) else left[~alike]
            if len(own):
                left = self._learn(int(own[0]), buffer, starts, sizes, left, first)

    def _stamps_only(self) -> None:
        """From here on no field but the stamps is read."""
        self.preview = None
        self.pieces.stamps_only()
        self.wanted = self.definition.stamp_fields()
        self._layouts.clear()

    def _learn(
        self,
        row: int,
        buffer: Bytes,
        starts: npt.NDArray[np.int64],
        sizes: npt.NDArray[np.int64],
        left: npt.NDArray[np.intp],
        first: int,
    ) -> npt.NDArray[np.intp]:
        """Walk message ``row`` and take all that are like it; returns those that are not."""
        message = buffer[starts[row] : starts[row] + sizes[row]].tobytes()
        try:
            layout = learn_layout(message, self.definition, self.wanted, self.packed)
        except IndexError as error:
            self.pieces.bad.append(first + row)
            self.reason = self.reason or str(error)
            return np.asarray(left[left != row], dtype=np.intp)
        known = self._layouts.setdefault(layout.size if layout.whole else _ANY_SIZE, [])
        known.append(layout)
        del known[:-MAX_LAYOUTS]
        fits = sizes[left] == layout.size if layout.whole else sizes[left] >= layout.size
        rest = np.union1d(self._take(layout, buffer, starts, left[fits], first), left[~fits])
        return np.asarray(rest, dtype=np.intp)

    def _known(
        self,
        key: int,
        buffer: Bytes,
        starts: npt.NDArray[np.int64],
        sizes: npt.NDArray[np.int64],
        left: npt.NDArray[np.intp],
        first: int,
    ) -> npt.NDArray[np.intp]:
        """Take the messages that have one of the layouts under ``key``; returns those that have none of them."""
        for layout in reversed(self._layouts.get(key, [])):
            if not len(left):
                break
            long_enough = left if key != _ANY_SIZE else left[sizes[left] >= layout.size]
            if len(long_enough):
                rest = self._take(layout, buffer, starts, long_enough, first)
                left = rest if len(long_enough) == len(left) else np.union1d(rest, left[sizes[left] < layout.size])
        return left

    def _take(
        self,
        layout: Layout,
        buffer: Bytes,
        starts: npt.NDArray[np.int64],
        left: npt.NDArray[np.intp],
        first: int,
    ) -> npt.NDArray[np.intp]:
        """Cut the columns out of the messages that have ``layout``; returns those that do not."""
        most = max(1, _GATHERED // max(1, layout.span))
        rest = [self._take_some(layout, buffer, starts, left[k : k + most], first) for k in range(0, len(left), most)]
        return rest[0] if len(rest) == 1 else np.concatenate(rest)

    def _take_some(
        self,
        layout: Layout,
        buffer: Bytes,
        starts: npt.NDArray[np.int64],
        left: npt.NDArray[np.intp],
        first: int,
    ) -> npt.NDArray[np.intp]:
        messages = gather(buffer, starts[left], layout.span)
        same = np.all(messages[:, layout.fixed] == layout.template, axis=1)
        everyone = bool(same.all())
        rows = (left if everyone else left[same]) + first
        if len(rows) and layout.numbers:
            records = layout.records(messages if everyone else messages[same])
            for path, names in layout.names.items():
                if self.wanted is None or any(name in self.wanted for name in names):
                    self.pieces.put(names, rows, records[path])
                else:
                    for name in names:
                        self.pieces.know(name)
        rest: npt.NDArray[np.intp] = left[:0] if everyone else left[~same]
        return rest


def gather(buffer: Bytes, starts: npt.NDArray[np.int64], size: int) -> Bytes:
    """Rows of ``size`` bytes from any positions, (n, size): one memory copy a row."""
    if size == 0:
        return np.zeros((len(starts), 0), np.uint8)
    windows = np.ndarray((len(buffer) - size + 1,), dtype=f"V{size}", buffer=buffer, strides=(1,))
    return np.ascontiguousarray(windows[starts]).view(np.uint8).reshape(len(starts), size)
