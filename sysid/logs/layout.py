"""The layout of a message: positions of its numbers, found by parsing the message once. CDR (ROS 2) and packed (ROS 1).

The position of a value depends only on the length words (of sequences and strings) before it and on the byte order. A layout
therefore stores these bytes; every message with the same bytes there has the same layout. With wanted fields parsing ends at
the last of them, before images, point clouds or texts behind it.

Source: OMG Common Data Representation (plain XCDR1), DDS-RTPS encapsulation header. ROS 1 writes the same without that
header, without padding, always little-endian, and texts without the closing zero (roscpp, "Messages Serialization").
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from sysid.logs.rosmsg import PRIMITIVES, Definition, Field

#: Arrays of equal length beside or below a string array with one of these names are addressed by its entries:
#: ``position[boom]`` of a JointState, ``points[0].positions[boom]`` of a JointTrajectory.
NAME_FIELDS = ("name", "names", "joint_names")
#: Longer arrays (images, scans, point clouds) are skipped, because they are no signals.
MAX_ELEMENTS = 512
#: A message with more values outside of arrays is not read.
MAX_STEPS = 1_000_000

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
    """

    size: int
    whole: bool
    numbers: Mapping[str, tuple[str, int]]
    aliases: Mapping[str, str]
    fixed: npt.NDArray[np.intp]
    template: Bytes

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
    missing = None if wanted is None else set(wanted)
    if packed:
        walk = _Parser(data, definition, "<", True, missing, 0)
    else:
        if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
            raise IndexError(f"encapsulation {data[:2].hex() or 'missing'} instead of plain CDR")
        walk = _Parser(data, definition, "<" if data[1] == 1 else ">", False, missing, 4, fixed=[(0, 2)])
    walk.message(definition.root, "")
    positions = np.array([at for start, length in walk.fixed for at in range(start, start + length)], dtype=np.intp)
    template = np.frombuffer(data, np.uint8)[positions]
    return Layout(walk.position if walk.enough else len(data), not walk.enough, walk.numbers, walk.aliases, positions, template)


def _names(member: Field) -> bool:
    """Whether a field names the elements of the arrays beside it."""
    return member.name in NAME_FIELDS and member.length is not None and member.kind in ("string", "wstring")


@dataclass
class _Parser:
    data: bytes
    definition: Definition
    order: str
    packed: bool
    missing: set[str] | None
    position: int
    steps: int = 0
    mute: int = 0
    #: Names of the elements of arrays: those of the message, else of the one that contains it.
    scope: list[str] = field(default_factory=list)
    numbers: dict[str, tuple[str, int]] = field(default_factory=dict)
    aliases: dict[str, str] = field(default_factory=dict)
    fixed: list[tuple[int, int]] = field(default_factory=list)

    @property
    def enough(self) -> bool:
        return self.missing is not None and not self.missing

    def align(self, size: int) -> None:
        if not self.packed:
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

    def text(self, kind: str, keep: bool) -> str:
        if kind == "wstring":
            raise IndexError("wide strings are not supported")
        length = self.length_word()
        start = self.take(length)
        if not keep:
            return ""
        self.fixed.append((start, length))
        end = start + length if self.packed else start + max(length - 1, 0)
        return self.data[start:end].decode("utf-8", errors="replace")

    def found(self, path: str, kind: str, start: int) -> None:
        if not self.mute:
            self.numbers[path] = (self.order + kind, start)
            if self.missing is not None:
                self.missing.discard(path)

    def message(self, kind: str, prefix: str) -> None:
        outer = names = self.scope
        arrays: list[tuple[str, int]] = []
        fields = self.definition.types[kind]
        if any(_names(member) for member in fields):
            names = self.scope = []  # its own names may come after its arrays
        if not fields and not self.packed:
            self.take(1)  # an empty message carries one byte
        for member in fields:
            path = prefix + member.name
            if member.length is None:
                self.single(member.kind, path)
            else:
                count = self.length_word() if member.length < 0 else member.length
                if member.kind in ("string", "wstring"):
                    keep = _names(member) and count <= MAX_ELEMENTS and not self.mute
                    texts = self.texts(member.kind, count, keep)
                    names = self.scope = texts if keep else names
                elif member.kind in PRIMITIVES:
                    self.array(member.kind, path, count)
                    arrays.append((path, count))
                else:
                    self.messages(member.kind, path, count)
                if names:
                    arrays = self.name_elements(arrays, names)
            if self.enough:
                return
        self.scope = outer

    def name_elements(self, arrays: list[tuple[str, int]], names: list[str]) -> list[tuple[str, int]]:
        """Add a second path to the elements of arrays as long as ``names``; returns the arrays of another length.

        A name that is a whole number is skipped, because ``position[2]`` always is the third element.
        """
        left = []
        for path, count in arrays:
            if count != len(names):
                left.append((path, count))
                continue
            for index, name in enumerate(names):
                if name.isdecimal():
                    continue
                alias, element = f"{path}[{name}]", f"{path}[{index}]"
                if element in self.numbers:
                    self.aliases[alias] = element
                    if self.missing is not None:
                        self.missing.discard(alias)
        return left

    def texts(self, kind: str, count: int, keep: bool) -> list[str]:
        if count > len(self.data):
            raise IndexError(f"{count} texts in a message of {len(self.data)} bytes")
        self.step(count)
        return [self.text(kind, keep) for _ in range(count)]

    def step(self, count: int = 1) -> None:
        self.steps += count
        if self.steps > MAX_STEPS:
            raise IndexError(f"more than {MAX_STEPS} values outside of arrays")

    def single(self, kind: str, path: str) -> None:
        self.step()
        if kind in ("string", "wstring"):
            self.text(kind, False)
        elif kind in PRIMITIVES:
            code = PRIMITIVES[kind]
            size = int(code[1])
            self.align(size)
            self.found(path, code, self.take(size))
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
            for index in range(count):
                self.found(f"{path}[{index}]", code, start + index * size)
        elif self.missing:
            for wanted in [w for w in self.missing if w.startswith(f"{path}[") and w[len(path) + 1 : -1].isdecimal()]:
                index = int(wanted[len(path) + 1 : -1])
                if index < count:
                    self.found(wanted, code, start + index * size)

    def messages(self, kind: str, path: str, count: int) -> None:
        """Elements of a sequence of messages; those beyond :data:`MAX_ELEMENTS` are skipped."""
        if count > len(self.data):
            raise IndexError(f"{count} elements in a message of {len(self.data)} bytes")
        for index in range(min(count, MAX_ELEMENTS)):
            self.step()
            self.message(kind, f"{path}[{index}].")
            if self.enough:
                return
        rest = count - MAX_ELEMENTS
        if rest <= 0:
            return
        phases: list[int | None] = [None] if self.packed else list(range(8))
        sizes = {phase: self.definition.fixed_size(kind, phase) for phase in phases}
        if all(sizes.values()):
            for _ in range(rest):
                self.take(sizes[None if self.packed else (self.position - 4) % 8] or 0)
            return
        self.mute += 1
        for _ in range(rest):
            self.step()
            self.message(kind, "")
        self.mute -= 1
