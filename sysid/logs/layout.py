"""The layout of a message: positions of its numbers, found by parsing the message once. CDR (ROS 2) and packed (ROS 1).

The position of a value depends only on the length words (of sequences and strings) before it and on the byte order. A layout
therefore stores these bytes; every message with the same bytes there has the same layout. With wanted fields parsing ends at
the last of them, before images, point clouds or texts behind it.

Source: OMG DDS-XTypes 1.3, 7.4 (plain CDR of versions 1 and 2), DDS-RTPS encapsulation header. ROS 1 writes version 1 without
that header, without padding, always little-endian, and texts without the closing zero (roscpp, "Messages Serialization").
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from sysid.logs.labels import are_joint_names, are_names, bracketed
from sysid.logs.rosmsg import PRIMITIVES, TEXTS, Definition, Field

#: Longer arrays (images, scans, point clouds) are skipped, because they are no signals.
MAX_ELEMENTS = 512
#: A message with more values outside of arrays is not read.
MAX_STEPS = 1_000_000

#: Encapsulation of version 1 and 2 → its byte order and the largest alignment.
_PLAIN = {0x00: (">", 8), 0x01: ("<", 8), 0x06: (">", 4), 0x07: ("<", 4), 0x10: (">", 4), 0x11: ("<", 4)}
#: Those in which a type may have gained or lost members, which its definition in the bag does not state.
_EXTENSIBLE = {
    **dict.fromkeys((0x02, 0x03), "parameter-list CDR"),
    **dict.fromkeys((0x08, 0x09, 0x14, 0x15), "delimited CDR of version 2"),
    **dict.fromkeys((0x0A, 0x0B, 0x12, 0x13), "parameter-list CDR of version 2"),
}
#: Bytes of a wide text for each unit of its length, by which middlewares differ, and their encodings.
_WIDE = {4: "utf-32", 2: "utf-16", 1: "utf-16"}
#: A message may be filled up to a multiple of four bytes.
_MAX_FILL = 3

Bytes = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Layout:
    """Positions of the numbers of a message.

    Args:
        size: bytes of the message, or of its beginning up to the last wanted field.
        whole: whether the whole message was parsed; then only messages of the same size have this layout.
        numbers: field path → (NumPy type code with byte order, position).
        aliases: second path of a number → its path (``position[boom]`` → ``position[2]``).
        fixed: positions of the bytes that determine the layout, (k,).
        template: the bytes there, (k,).
        texts: array → the text that labels each of its elements.
    """

    size: int
    whole: bool
    numbers: Mapping[str, tuple[str, int]]
    aliases: Mapping[str, str]
    fixed: npt.NDArray[np.intp]
    template: Bytes
    texts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @cached_property
    def span(self) -> int:
        """Bytes from the beginning that contain all numbers and fixed positions."""
        ends = [position + int(code[-1]) for code, position in self.numbers.values()]
        return max([*ends, int(self.fixed.max(initial=-1)) + 1])

    @cached_property
    def names(self) -> Mapping[str, tuple[str, ...]]:
        """Path of each number → that path and its further ones."""
        names = {path: [path] for path in self.numbers}
        for alias, path in self.aliases.items():
            names[path].append(alias)
        return {path: tuple(own) for path, own in names.items()}

    @cached_property
    def _record(self) -> np.dtype[np.void]:
        return np.dtype(
            {
                "names": list(self.numbers),
                "formats": [code for code, _ in self.numbers.values()],
                "offsets": [position for _, position in self.numbers.values()],
                "itemsize": self.span,
            }
        )

    def records(self, messages: Bytes) -> npt.NDArray[np.void]:
        """``messages`` (n, span or more) as records with one named entry a number."""
        return np.ascontiguousarray(messages[:, : self.span]).view(self._record).reshape(len(messages))


def layout_of(data: bytes, definition: Definition, wanted: frozenset[str] | None = None, packed: bool = False) -> Layout:
    """Parse one message, to its end or until all ``wanted`` fields are found; ``packed``: as ROS 1 serialises it.

    Raises:
        IndexError: the message does not follow its schema (too short, an encapsulation other than plain CDR).
    """
    if packed:
        begin, order, largest = 0, "<", 1
    else:
        begin, (order, largest) = 4, _plain(data)

    def walk(wide: int) -> _Parser:
        return _Parser(data, definition, order, largest, wanted, begin, wide, fixed=[(0, 2)] if begin else []).read()

    parsed = _of_fitting_width(walk, len(data)) if definition.has_wide_texts else walk(0)
    positions = np.array([at for start, length in parsed.fixed for at in range(start, start + length)], dtype=np.intp)
    template = np.frombuffer(data, np.uint8)[positions]
    size = parsed.position if parsed.enough else len(data)
    aliases = {alias: path for path, alias in parsed.aliases.items()}
    return Layout(size, not parsed.enough, parsed.numbers, aliases, positions, template, parsed.labelled)


def _plain(data: bytes) -> tuple[str, int]:
    """Byte order and largest alignment of a message in plain CDR.

    Raises:
        IndexError: another encapsulation.
    """
    if len(data) >= 4 and data[0] == 0 and data[1] in _PLAIN:
        return _PLAIN[data[1]]
    name = _EXTENSIBLE.get(data[1], "") if len(data) >= 4 and data[0] == 0 else ""
    raise IndexError(f"encapsulation {data[:2].hex() or 'missing'}{f', {name},' if name else ''} instead of plain CDR")


def _of_fitting_width(walk: Callable[[int], _Parser], size: int) -> _Parser:
    """The message with the width of its wide texts that accounts for every byte.

    Raises:
        IndexError: none does, or two do that place its numbers differently.
    """
    found: list[_Parser] = []
    for wide in _WIDE:
        with contextlib.suppress(IndexError):
            found.append(walk(wide))
    fitting = [parsed for parsed in found if size - parsed.position <= _MAX_FILL]
    if not fitting or any(other.numbers != fitting[0].numbers for other in fitting):
        raise IndexError("wide texts whose characters are not of one known width")
    return fitting[0]


def _names(member: Field) -> bool:
    """Whether a field names the elements of the arrays beside it."""
    return member.length is not None and member.kind in TEXTS and are_names(member.name)


@dataclass(frozen=True)
class _Array:
    """An array that has been read.

    Args:
        length: as its definition states it; -1 for a sequence.
        numbers: begin and end of its numbers in the order in which they were found.
        texts: those that identify its elements; empty where they have none.
        series: its elements are messages with sequences that joint names label, as the points of a trajectory.
    """

    path: str
    length: int
    count: int
    numbers: tuple[int, int]
    texts: tuple[str, ...] = ()
    series: bool = False


@dataclass
class _Parser:
    data: bytes
    definition: Definition
    order: str
    largest: int
    wanted: frozenset[str] | None
    position: int
    wide: int
    steps: int = 0
    mute: int = 0
    #: Arrays with wanted elements whose labels have not been read yet.
    open: int = 0
    #: Joint names of the messages around the current one, with their length as defined.
    scope: tuple[tuple[int, tuple[str, ...]], ...] = ()
    numbers: dict[str, tuple[str, int]] = field(default_factory=dict)
    #: Path of a number by index → by label.
    aliases: dict[str, str] = field(default_factory=dict)
    labelled: dict[str, tuple[str, ...]] = field(default_factory=dict)
    fixed: list[tuple[int, int]] = field(default_factory=list)
    paths: list[str] = field(default_factory=list)
    missing: set[str] | None = field(init=False)

    def __post_init__(self) -> None:
        self.missing = None if self.wanted is None or self.wide else set(self.wanted)

    @property
    def packed(self) -> bool:
        return self.largest == 1

    @property
    def second(self) -> bool:
        """Whether it is CDR of version 2, in which the size precedes an array of texts or messages."""
        return self.largest == 4

    def read(self) -> _Parser:
        """Read the message."""
        self.message(self.definition.root, "")
        return self

    @property
    def enough(self) -> bool:
        return self.missing is not None and not self.missing and not self.open

    def wants(self, array: str) -> bool:
        """Whether any element of an array may be wanted."""
        root = array.partition("[")[0] + "["
        return not self.mute and (self.wanted is None or any(path.startswith(root) for path in self.wanted))

    def align(self, size: int) -> None:
        if not self.packed:
            self.position += -(self.position - 4) % min(size, self.largest)

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

    def text(self, kind: str, keep: bool) -> str:
        length = self.length_word() * (self.wide if kind == "wstring" else 1)
        start = self.take(length)
        wide = self.wide_text(start, length) if kind == "wstring" else ""
        if not keep:
            return ""
        self.fixed.append((start, length))
        if kind == "wstring":
            return wide
        end = start + length if self.packed else start + max(length - 1, 0)
        return self.data[start:end].decode("utf-8", errors="replace")

    def wide_text(self, start: int, length: int) -> str:
        """A wide text; raises IndexError where its bytes are no text, because its characters have another width."""
        try:
            code = f"{_WIDE[self.wide]}-{'le' if self.order == '<' else 'be'}"
            text = self.data[start : start + length].decode(code).removesuffix("\0")
        except UnicodeDecodeError:
            text = "\0"
        if "\0" in text:
            raise IndexError("no wide text")
        return text

    def found(self, path: str, kind: str, start: int) -> None:
        if not self.mute:
            self.numbers[path] = (self.order + kind, start)
            self.paths.append(path)
            if self.missing is not None:
                self.missing.discard(path)

    def message(self, kind: str, prefix: str, identity: str | None = None) -> str:
        """Read a message; returns its text ``identity``."""
        outer, text = self.scope, ""
        fields = self.definition.types[kind]
        unread = sum(map(_names, fields))  # names may come after their arrays
        self.scope = () if unread else outer
        names, waiting, held = [*self.scope], list[_Array](), 0
        if not fields and not self.packed:
            self.take(1)  # an empty message carries one byte
        for member in fields:
            path = prefix + member.name
            if member.length is None:
                text = self.single(member.kind, path, member.name == identity) or text
            else:
                if self.second and member.kind not in PRIMITIVES:
                    self.align(4)
                    self.take(4)
                count = self.length_word() if member.length < 0 else member.length
                if member.kind in TEXTS:
                    own = _names(member)
                    texts = self.texts(member.kind, count, own and count <= MAX_ELEMENTS and not self.mute)
                    names += [(member.length, texts)] if own else []
                    unread -= own
                    self.scope = (*self.scope, (member.length, texts)) if are_joint_names(member.name) else self.scope
                else:
                    waiting.append(self.elements(member.kind, path, member.length, count))
                    if unread and self.wants(path):
                        self.open += 1
                        held += 1
                if not unread:
                    for array in waiting:
                        self.label(array, names)
                    self.open -= held
                    waiting, held = [], 0
            if self.enough:
                break
        self.scope = outer
        return text

    def elements(self, kind: str, path: str, length: int, count: int) -> _Array:
        """Read the elements of an array of numbers or messages."""
        begin = len(self.paths)
        if kind in PRIMITIVES:
            self.array(kind, path, count)
            return _Array(path, length, count, (begin, len(self.paths)))
        texts = self.messages(kind, path, count)
        return _Array(path, length, count, (begin, len(self.paths)), texts, self.definition.has_series(kind))

    def label(self, array: _Array, names: Sequence[tuple[int, tuple[str, ...]]]) -> None:
        """Add a path by label to the numbers of an array whose elements have texts, or as many names beside it.

        A vector of fixed length beside a sequence of names is not theirs, even where it has their length.
        """
        others = self.scope if array.series else ()
        fitting = (own[1] for own in names if own[0] == array.length and len(own[1]) == array.count and own not in others)
        texts = array.texts or next(fitting, ())
        if self.mute or not any(texts):
            return
        self.labelled[array.path] = texts
        labels, start = bracketed(texts), len(array.path)
        for path in self.paths[slice(*array.numbers)]:
            end = path.index("]", start)
            label = labels[int(path[start + 1 : end])]
            if label:
                alias = self.aliases[path] = f"{array.path}[{label}{self.aliases.get(path, path)[end:]}"
                if self.missing is not None:
                    self.missing.discard(alias)

    def texts(self, kind: str, count: int, keep: bool) -> tuple[str, ...]:
        if count > len(self.data):
            raise IndexError(f"{count} texts in a message of {len(self.data)} bytes")
        self.step(count)
        texts = tuple(self.text(kind, keep) for _ in range(count))
        return texts if keep else ()

    def step(self, count: int = 1) -> None:
        self.steps += count
        if self.steps > MAX_STEPS:
            raise IndexError(f"more than {MAX_STEPS} values outside of arrays")

    def single(self, kind: str, path: str, keep: bool) -> str:
        """Read a single value; returns a text that is to be kept."""
        self.step()
        if kind in TEXTS:
            return self.text(kind, keep)
        if kind in PRIMITIVES:
            code = PRIMITIVES[kind]
            size = int(code[1])
            self.align(size)
            self.found(path, code, self.take(size))
        else:
            self.message(kind, path + ".")
        return ""

    def array(self, kind: str, path: str, count: int) -> None:
        code = PRIMITIVES[kind]
        size = int(code[1])
        if not count:
            return  # an empty sequence is not aligned to its elements
        self.align(size)
        start = self.take(size * count)
        if count <= MAX_ELEMENTS:
            for index in range(count):
                self.found(f"{path}[{index}]", code, start + index * size)
        elif self.missing:
            for wanted in [w for w in self.missing if w.startswith(f"{path}[") and w[len(path) + 1 : -1].isdecimal()]:
                index = int(wanted[len(path) + 1 : -1])
                if index < count:
                    self.found(wanted, code, start + index * size)

    def messages(self, kind: str, path: str, count: int) -> tuple[str, ...]:
        """Elements of a sequence of messages, of which those beyond :data:`MAX_ELEMENTS` are skipped; the texts that identify
        them.
        """
        if count > len(self.data):
            raise IndexError(f"{count} elements in a message of {len(self.data)} bytes")
        identity = self.definition.identity(kind) if count <= MAX_ELEMENTS and self.wants(path) else None
        self.open += identity is not None
        texts = []
        for index in range(min(count, MAX_ELEMENTS)):
            self.step()
            texts.append(self.message(kind, f"{path}[{index}].", identity))
            if self.enough:
                return ()
        self.open -= identity is not None
        self.skip(kind, count - MAX_ELEMENTS)
        return tuple(texts) if identity is not None else ()

    def skip(self, kind: str, count: int) -> None:
        """Messages that are not read."""
        if count <= 0:
            return
        phases: list[int | None] = [None] if self.packed else list(range(8))
        sizes = {} if self.second else {phase: self.definition.fixed_size(kind, phase) for phase in phases}
        if sizes and all(sizes.values()):
            for _ in range(count):
                self.take(sizes[None if self.packed else (self.position - 4) % 8] or 0)
            return
        self.mute += 1
        for _ in range(count):
            self.step()
            self.message(kind, "")
        self.mute -= 1
