"""Messages of one type → columns, many messages at once: CDR (ROS 2) and packed (ROS 1).

One message is parsed to find its layout (:mod:`sysid.logs.layout`). Every other message with the same length words, byte order
and naming strings has the same layout, and NumPy extracts its columns. A message that matches no known layout is parsed next.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.logs.layout import Bytes, Layout, layout_of
from sysid.logs.rosmsg import Definition
from sysid.logs.topic_columns import TopicColumns

Rows = npt.NDArray[np.intp]

#: Layouts of one message size that are kept.
MAX_LAYOUTS = 64
#: Key of layouts that do not depend on the size of the message.
_ANY_SIZE = -1
#: Bytes of messages that are compared at once.
_GATHERED = 16 * 2**20


@dataclass(frozen=True)
class _Messages:
    """Messages ``buffer[start : start + size]``, of which the first is row ``first`` of the columns."""

    buffer: Bytes
    starts: npt.NDArray[np.int64]
    sizes: npt.NDArray[np.int64]
    first: int


@dataclass
class ColumnDecoder:
    """Turns the messages of one topic into columns, batch by batch.

    Args:
        definition: their type.
        wanted: fields to read besides the stamps; None for all.
        preview: number of messages of which all fields are read; of later ones only the stamps.
        packed: serialised by ROS 1.
        cells: limit of the topic's table where ``wanted`` is None.
    """

    definition: Definition
    wanted: frozenset[str] | None = None
    preview: int | None = None
    packed: bool = False
    cells: int = 2**28
    columns: TopicColumns = field(init=False)
    reason: str = ""
    _layouts: dict[int, list[Layout]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.columns = TopicColumns(self.wanted, self.cells)
        if self.wanted is not None:
            self.wanted |= self.definition.stamp_fields()

    def add(self, buffer: Bytes, starts: npt.NDArray[np.int64], sizes: npt.NDArray[np.int64]) -> None:
        """Decode messages ``buffer[start : start + size]``; their values are copied."""
        if self.preview is not None and self.columns.total >= self.preview:
            self._stamps_only()
        messages = _Messages(buffer, starts, sizes, self.columns.expect(len(starts)))
        if self.wanted is not None and not self.wanted:
            return
        left = self._decode_known(_ANY_SIZE, messages, np.arange(len(starts)))
        while len(left):
            same_size = sizes[left] == sizes[left[0]]
            own = self._decode_known(int(sizes[left[0]]), messages, left[same_size])
            left = np.union1d(own, left[~same_size]) if len(own) else left[~same_size]
            if len(own):
                left = self._decode_like(int(own[0]), messages, left)

    def _stamps_only(self) -> None:
        """From here on only the stamps are read."""
        self.preview = None
        self.columns.stamps_only()
        self.wanted = self.definition.stamp_fields()
        self._layouts.clear()

    def _decode_like(self, row: int, messages: _Messages, left: Rows) -> Rows:
        """Parse message ``row`` and decode all with the same layout; returns the others."""
        start, sizes = messages.starts[row], messages.sizes
        try:
            data = messages.buffer[start : start + sizes[row]].tobytes()
            layout = layout_of(data, self.definition, self.wanted, self.packed)
        except IndexError as error:
            self.columns.bad.append(messages.first + row)
            self.reason = self.reason or str(error)
            return np.asarray(left[left != row], dtype=np.intp)
        known = self._layouts.setdefault(layout.size if layout.whole else _ANY_SIZE, [])
        known.append(layout)
        del known[:-MAX_LAYOUTS]
        for array, texts in layout.texts.items():
            self.columns.labels.saw(array, texts)
        fits = sizes[left] == layout.size if layout.whole else sizes[left] >= layout.size
        rest = np.union1d(self._decode(layout, messages, left[fits]), left[~fits])
        return np.asarray(rest, dtype=np.intp)

    def _decode_known(self, key: int, messages: _Messages, left: Rows) -> Rows:
        """Decode the messages with one of the layouts under ``key``; returns the others."""
        for layout in reversed(self._layouts.get(key, [])):
            if not len(left):
                break
            long_enough = left if key != _ANY_SIZE else left[messages.sizes[left] >= layout.size]
            if len(long_enough):
                rest = self._decode(layout, messages, long_enough)
                left = rest if len(long_enough) == len(left) else np.union1d(rest, left[messages.sizes[left] < layout.size])
        return left

    def _decode(self, layout: Layout, messages: _Messages, left: Rows) -> Rows:
        """Extract the columns of the messages with ``layout``; returns the others."""
        count = max(1, _GATHERED // max(1, layout.span))
        rest = [self._decode_chunk(layout, messages, left[k : k + count]) for k in range(0, len(left), count)]
        return rest[0] if len(rest) == 1 else np.concatenate(rest)

    def _decode_chunk(self, layout: Layout, messages: _Messages, left: Rows) -> Rows:
        data = gather(messages.buffer, messages.starts[left], layout.span)
        same = np.all(data[:, layout.fixed] == layout.template, axis=1)
        everyone = bool(same.all())
        rows = (left if everyone else left[same]) + messages.first
        if len(rows):
            for array, texts in layout.texts.items():
                self.columns.labels.repeated(array, texts, len(rows))
        if len(rows) and layout.numbers:
            records = layout.records(data if everyone else data[same])
            for path, names in layout.names.items():
                if self.wanted is None or any(name in self.wanted for name in names):
                    self.columns.put(names, rows, records[path])
                else:
                    for name in names:
                        self.columns.know(name)
        rest: Rows = left[:0] if everyone else left[~same]
        return rest


def gather(buffer: Bytes, starts: npt.NDArray[np.int64], size: int) -> Bytes:
    """Rows of ``size`` bytes from any positions, (n, size): one memory copy a row."""
    if size == 0:
        return np.zeros((len(starts), 0), np.uint8)
    windows = np.ndarray((len(buffer) - size + 1,), dtype=f"V{size}", buffer=buffer, strides=(1,))
    return np.ascontiguousarray(windows[starts]).view(np.uint8).reshape(len(starts), size)
