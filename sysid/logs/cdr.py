"""CDR messages of one type → columns, many messages at once.

Where a value lies in a CDR message depends only on the length words (of sequences and strings) before it and on the byte
order. One message is walked to learn its *layout*; every other message of the same size whose length words, byte order and
naming strings are the same, byte for byte, has the same layout, and its columns are cut out by NumPy. What does not match is
walked in turn: a log with few layouts costs few walks, one with a new layout in every message is read message by message.

Source: OMG Common Data Representation (plain XCDR1), DDS-RTPS encapsulation header.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError
from sysid.logs.rosmsg import PRIMITIVES, Definition

#: Sibling arrays of equal length are addressed by the entries of a string array with one of these names.
NAME_FIELDS = ("name", "names", "joint_names")
#: Longer arrays (images, scans, point clouds) are skipped: they are no signals.
MAX_ELEMENTS = 512

Bytes = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Layout:
    """Where the numbers of a message lie.

    Args:
        size: bytes of the message.
        numbers: field path → (NumPy type code with byte order, position).
        aliases: further path of a number → its path (``position[boom]`` → ``position[2]``).
        fixed: positions whose bytes decide on the layout, (k,).
        template: the bytes there, (k,).
    """

    size: int
    numbers: Mapping[str, tuple[str, int]]
    aliases: Mapping[str, str]
    fixed: npt.NDArray[np.intp]
    template: Bytes


@dataclass
class _Walk:
    data: bytes
    definition: Definition
    order: str
    position: int = 4
    numbers: dict[str, tuple[str, int]] = field(default_factory=dict)
    aliases: dict[str, str] = field(default_factory=dict)
    fixed: list[tuple[int, int]] = field(default_factory=list)

    def align(self, size: int) -> None:
        self.position += -(self.position - 4) % size

    def take(self, size: int) -> int:
        start = self.position
        self.position += size
        if self.position > len(self.data):
            raise IndexError(f"the message ends after {len(self.data)} bytes")
        return start

    def length_word(self) -> int:
        self.align(4)
        start = self.take(4)
        self.fixed.append((start, 4))
        return int.from_bytes(self.data[start : start + 4], "little" if self.order == "<" else "big")

    def string(self, keep: bool) -> str:
        length = self.length_word()
        start = self.take(length)
        if not keep:
            return ""
        self.fixed.append((start, length))
        return self.data[start : start + max(length - 1, 0)].decode("utf-8", errors="replace")

    def message(self, kind: str, prefix: str) -> None:
        names: list[str] = []
        arrays: list[tuple[str, int]] = []
        fields = self.definition.types[kind]
        if not fields:
            self.take(1)  # an empty message carries one byte
        for member in fields:
            path = prefix + member.name
            if member.length is None:
                self.single(member.kind, path)
                continue
            count = self.length_word() if member.length < 0 else member.length
            if member.kind in ("string", "wstring"):
                keep = member.name in NAME_FIELDS
                texts = [self.text(member.kind, keep) for _ in range(count)]
                names = texts if keep else names
            elif member.kind in PRIMITIVES:
                self.array(member.kind, path, count)
                arrays.append((path, count))
            else:
                for index in range(count):
                    self.message(member.kind, f"{path}[{index}].")
        for path, count in arrays:
            if count == len(names) <= MAX_ELEMENTS:
                self.aliases |= {f"{path}[{name}]": f"{path}[{index}]" for index, name in enumerate(names)}

    def text(self, kind: str, keep: bool) -> str:
        if kind == "wstring":
            raise IndexError("wide strings are not supported")
        return self.string(keep)

    def single(self, kind: str, path: str) -> None:
        if kind in ("string", "wstring"):
            self.text(kind, False)
        elif kind in PRIMITIVES:
            code = PRIMITIVES[kind]
            size = int(code[1])
            self.align(size)
            self.numbers[path] = (self.order + code, self.take(size))
        else:
            self.message(kind, path + ".")

    def array(self, kind: str, path: str, count: int) -> None:
        code = PRIMITIVES[kind]
        size = int(code[1])
        if not count:
            return  # an empty sequence is not aligned to its elements
        self.align(size)
        start = self.take(size * count)
        if count <= MAX_ELEMENTS:
            self.numbers |= {f"{path}[{i}]": (self.order + code, start + i * size) for i in range(count)}


def learn_layout(data: bytes, definition: Definition) -> Layout:
    """Walk one message.

    Raises:
        IndexError: the message does not follow its schema (too short, an encapsulation other than plain CDR).
    """
    if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
        raise IndexError(f"encapsulation {data[:2].hex() or 'missing'} instead of plain CDR")
    walk = _Walk(data, definition, "<" if data[1] == 1 else ">", fixed=[(0, 2)])
    walk.message(definition.root, "")
    positions = np.concatenate([np.arange(start, start + length) for start, length in walk.fixed]).astype(np.intp)
    template = np.frombuffer(data, np.uint8)[positions]
    return Layout(len(data), walk.numbers, walk.aliases, positions, template)


@dataclass
class ColumnDecoder:
    """Collects the messages of one topic, chunk by chunk, and turns them into columns."""

    definition: Definition
    where: str
    layouts: list[Layout] = field(default_factory=list)
    unreadable: int = 0
    total: int = 0
    _pieces: list[tuple[Layout, npt.NDArray[np.intp], Bytes]] = field(default_factory=list)

    def add(self, buffer: Bytes, starts: npt.NDArray[np.int64], sizes: npt.NDArray[np.int64]) -> None:
        """Take messages ``buffer[start : start + size]``; they are copied, the buffer may go."""
        rows = np.arange(self.total, self.total + len(starts))
        self.total += len(starts)
        for size in np.unique(sizes):
            chosen = np.flatnonzero(sizes == size)
            if size == 0:
                self.unreadable += len(chosen)
                continue
            messages = _gather(buffer, starts[chosen], int(size))
            self._match(messages, rows[chosen])

    def _match(self, messages: Bytes, rows: npt.NDArray[np.intp]) -> None:
        left = np.arange(len(rows))
        for layout in reversed(self.layouts):
            if layout.size == messages.shape[1] and len(left):
                left = self._assign(layout, messages, rows, left)
        while len(left):
            try:
                layout = learn_layout(messages[left[0]].tobytes(), self.definition)
            except IndexError:
                self.unreadable += 1
                left = left[1:]
                continue
            self.layouts.append(layout)
            left = self._assign(layout, messages, rows, left)

    def _assign(
        self, layout: Layout, messages: Bytes, rows: npt.NDArray[np.intp], left: npt.NDArray[np.intp]
    ) -> npt.NDArray[np.intp]:
        same = np.all(messages[np.ix_(left, layout.fixed)] == layout.template, axis=1)
        chosen = left[same]
        if len(chosen):
            self._pieces.append((layout, rows[chosen], messages if len(chosen) == len(messages) else messages[chosen]))
        rest: npt.NDArray[np.intp] = left[~same]
        return rest

    def columns(self) -> dict[str, npt.NDArray[np.float64]]:
        """Field path → values (total,), NaN in messages that do not have it; aliases included."""
        result: dict[str, npt.NDArray[np.float64]] = {}
        for layout, rows, messages in self._merged():
            whole = len(rows) == self.total
            by_alias: dict[str, list[str]] = {}
            for alias, path in layout.aliases.items():
                by_alias.setdefault(path, []).append(alias)
            view = _as_records(messages, layout)
            for path in layout.numbers:
                values = view[path].astype(np.float64)
                for name in (path, *by_alias.get(path, ())):
                    if whole:
                        result[name] = values
                    else:
                        column = result.setdefault(name, np.full(self.total, np.nan))
                        column[rows] = values
        return result

    def integers(self, path: str) -> npt.NDArray[np.int64] | None:
        """One integer field without the detour over float64, 0 in unreadable messages; None where a readable one lacks it."""
        result = np.zeros(self.total, np.int64)
        found = 0
        for layout, rows, messages in self._merged():
            if path in layout.numbers:
                result[rows] = _as_records(messages, layout)[path]
                found += len(rows)
        return result if found == self.total - self.unreadable else None

    def readable(self) -> npt.NDArray[np.bool_]:
        """Which messages followed their schema, (total,)."""
        result = np.zeros(self.total, dtype=bool)
        for _, rows, _ in self._merged():
            result[rows] = True
        return result

    def _merged(self) -> list[tuple[Layout, npt.NDArray[np.intp], Bytes]]:
        """One piece a layout, rows rising."""
        if len(self._pieces) > len(self.layouts):
            pieces = []
            for layout in self.layouts:
                own = [(rows, messages) for owner, rows, messages in self._pieces if owner is layout]
                pieces.append((layout, np.concatenate([r for r, _ in own]), np.concatenate([m for _, m in own])))
            self._pieces = pieces
        return self._pieces


def _gather(buffer: Bytes, starts: npt.NDArray[np.int64], size: int) -> Bytes:
    """Rows of ``size`` bytes from any positions, (n, size): one memory copy a row."""
    windows = np.ndarray((len(buffer) - size + 1,), dtype=f"V{size}", buffer=buffer, strides=(1,))
    return np.ascontiguousarray(windows[starts]).view(np.uint8).reshape(len(starts), size)


def _as_records(messages: Bytes, layout: Layout) -> npt.NDArray[np.void]:
    kinds = np.dtype(
        {
            "names": list(layout.numbers),
            "formats": [code for code, _ in layout.numbers.values()],
            "offsets": [position for _, position in layout.numbers.values()],
            "itemsize": layout.size,
        }
    )
    return np.ascontiguousarray(messages).view(kinds).reshape(len(messages))


def check_encoding(message: str, schema: str, where: str) -> None:
    """Raise :class:`InputError` unless messages are CDR with a ``ros2msg`` schema."""
    if message != "cdr" or schema != "ros2msg":
        raise InputError(where, f"messages in {message!r} with a schema in {schema!r}", "'cdr' with 'ros2msg' (ROS 2)")
