"""The numeric variables of a MATLAB file of version 4 to 7 (``-v4``, ``-v6``, ``-v7``), and those in its structures.

SciPy's reader trusts the sizes that a damaged file states, which can end the process, and reads every variable. This one checks
sizes and reads only requested variables. Texts, cells, sparse matrices, objects, arrays of structures and complex numbers are
named only.
Source: MathWorks, "MAT-File Format", level 5 and level 4.
"""

from __future__ import annotations

import io
import math
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from sysid import scratch
from sysid.logs.limits import FREE, MAX_RATIO, Budget

#: Storage types of numbers → NumPy code without byte order.
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _PACKED = 14, 15
#: Array classes: structure, and the numeric ones.
_STRUCTURE, _NUMERIC = 2, range(6, 16)
_MAX_DEPTH = 16
#: What variables of other classes are.
_OTHERS = {
    1: "a cell array", 2: "an array of structures", 3: "an object", 4: "text", 5: "a sparse matrix", 16: "a function",
    17: "an object, such as datetime or table",
}  # fmt: skip
_COMPLEX, _COMPLEX_FLAG = "complex numbers", 0x800
#: Sizes, flags, names: longer ones are damage. Bytes that are unpacked at a time.
_MAX_HEAD, _PIECE = 2**20, 2**20


class MatError(ValueError):
    """The file is damaged, or exceeds its limits."""


@dataclass(frozen=True)
class MatVariable:
    """Position of the numbers of a variable.

    Args:
        shape: without dimensions of one, first index fastest.
        kind: stored type of the numbers.
        source: first byte and number of bytes of the top-level variable in the file; ``packed`` with zlib.
        start: offset of the numbers within the unpacked variable [bytes].
    """

    shape: tuple[int, ...]
    kind: np.dtype[Any]
    source: tuple[int, int]
    packed: bool
    start: int

    @property
    def count(self) -> int:
        return math.prod(self.shape)


def find_variables(path: Path, budget: Budget) -> tuple[dict[str, MatVariable], dict[str, str]]:
    """Variable, or ``structure.field`` → position of its numbers; and what the variables without numbers are.

    Raises:
        MatError: the file is damaged or unpacks to more than its budget.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(128)
        found: dict[str, MatVariable] = {}
        others: dict[str, str] = {}
        if head[126:128] not in (b"IM", b"MI"):
            file.seek(0)
            for name, variable in _version_4(file, size):
                if isinstance(variable, MatVariable):
                    found[name] = variable
                else:
                    others[name] = variable
            return found, others
        order = "<" if head[126:128] == b"IM" else ">"
        left = min(budget.unpacked, max(FREE, size * MAX_RATIO))
        while tag := file.read(8):
            if len(tag) < 8:
                raise MatError("the file is cut off")
            kind, extent = struct.unpack(f"{order}II", tag)
            start = file.tell()
            if size - start < extent:
                raise MatError(f"the file is cut off: {size - start} of {extent} bytes of a variable")
            if kind in (_PACKED, _MATRIX):
                bytes_: _Bytes = _Unpacked(file, start, extent, left) if kind == _PACKED else _Plain(file, start, extent)
                parser = _Parser(bytes_, order, (start, extent), kind == _PACKED, found, others)
                element = parser.element(2**32 + 8) if kind == _PACKED else _Element(kind, 0, extent)
                if element.kind == _MATRIX:
                    parser.matrix(element, "", 0)
                left -= bytes_.position if kind == _PACKED else 0
                budget.check_columns(path, len(found), "variables")
            file.seek(start + extent)
    return found, others


def read_variables(path: Path, variables: Mapping[str, MatVariable]) -> dict[str, npt.NDArray[Any]]:
    """The numbers of ``variables`` in their stored types; each packed variable is unpacked once.

    Raises:
        MatError: the file is damaged.
    """
    found: dict[str, npt.NDArray[Any]] = {}
    source: tuple[int, int] | None = None
    with path.open("rb") as file:
        for name, variable in sorted(variables.items(), key=lambda item: (item[1].source, item[1].start)):
            if variable.source != source:
                source = variable.source
                limit = 2**62  # find_variables has unpacked it within the limit
                bytes_: _Bytes = _Unpacked(file, *source, limit) if variable.packed else _Plain(file, *source)
            array = scratch.empty(variable.count, variable.kind)
            bytes_.skip(variable.start - bytes_.position)
            bytes_.fill(array.data.cast("B") if len(array) else memoryview(b""))
            scratch.leave()
            found[name] = array.reshape(variable.shape, order="F")
    return {name: found[name] for name in variables}


#: Version 4: the hundreds, tens and ones of the type say how numbers are stored, and whether they are numbers.
_STORED_4 = ("f8", "f4", "i4", "i2", "u2", "u1")


def _version_4(file: io.BufferedReader, size: int) -> Iterator[tuple[str, MatVariable | str]]:
    """Matrices one after the other: type, rows, columns, complex, length of the name; name; numbers, or what else it is."""
    while head := file.read(20):
        for order in "<>":
            kind, rows, columns, is_complex, length = struct.unpack(f"{order}5i", head.ljust(20, b"\xff"))
            if kind // 1000 == "<>".index(order) and 0 <= kind % 100 < 60 and 0 < length <= 256 and rows >= 0 and columns >= 0:
                break
        else:
            raise MatError("no variable of a MATLAB file of version 4 or 5")
        code = np.dtype(order + _STORED_4[kind % 100 // 10])
        extent = rows * columns * code.itemsize
        name = file.read(length).split(b"\0")[0].decode("latin-1")
        start = file.tell()
        if size - start < extent:
            raise MatError(f"the file is cut off: {max(size - start, 0)} of {extent} bytes of {name!r}")
        file.seek(start + extent * (2 if is_complex else 1))
        shape = tuple(extent for extent in (rows, columns) if extent != 1)
        if is_complex or kind % 10:
            yield name, _COMPLEX if is_complex else _OTHERS[4] if kind % 10 == 1 else _OTHERS[5]
        elif shape:
            yield name, MatVariable(shape, code, (start, extent), False, 0)


class _Bytes(Protocol):
    """The bytes of a top-level variable, one after the other."""

    @property
    def position(self) -> int: ...

    def skip(self, count: int) -> None: ...

    def fill(self, view: memoryview) -> None: ...


@dataclass
class _Plain:
    """Unpacked in the file."""

    file: io.BufferedReader
    start: int
    size: int
    position: int = 0

    def skip(self, count: int) -> None:
        self.position += count
        if self.position > self.size:
            raise MatError("an element is cut off")

    def fill(self, view: memoryview) -> None:
        self.file.seek(self.start + self.position)
        self.skip(len(view))
        if self.file.readinto(view) != len(view):
            raise MatError("the file is cut off")


@dataclass
class _Unpacked:
    """Unpacked while they are read, at most ``limit`` bytes."""

    file: io.BufferedReader
    start: int
    size: int
    limit: int
    position: int = 0
    _taken: int = 0
    _unpacker: Any = field(default_factory=zlib.decompressobj)
    _waiting: bytes = b""

    def skip(self, count: int) -> None:
        while count > 0:
            count -= len(self._next(count))

    def fill(self, view: memoryview) -> None:
        while len(view):
            piece = self._next(len(view))
            view[: len(piece)] = piece
            view = view[len(piece) :]

    def _next(self, count: int) -> bytes:
        """One to ``count`` bytes."""
        while True:
            if not self._waiting and self._taken < self.size:
                self.file.seek(self.start + self._taken)
                self._waiting = self.file.read(min(_PIECE, self.size - self._taken))
                self._taken += len(self._waiting)
            ended = not self._waiting
            try:
                piece: bytes = self._unpacker.decompress(self._waiting, min(count, _PIECE))
            except zlib.error as error:
                raise MatError(f"a packed variable is damaged ({error})") from None
            self._waiting = self._unpacker.unconsumed_tail
            self.position += len(piece)
            if self.position > self.limit:
                raise MatError(f"variables that unpack to more than {self.limit / 2**20:.0f} MiB")
            if piece:
                return piece
            if ended or self._unpacker.eof:
                raise MatError("an element is cut off")


@dataclass(frozen=True)
class _Element:
    """``small``: size and data share the tag, of which these are the bytes."""

    kind: int
    start: int
    size: int
    small: bytes | None = None

    @property
    def end(self) -> int:
        return self.start + self.size


@dataclass
class _Parser:
    """Parses the elements of a top-level variable; the positions of numbers go into ``found``, all else into ``others``."""

    bytes_: _Bytes
    order: str
    source: tuple[int, int]
    packed: bool
    found: dict[str, MatVariable]
    others: dict[str, str]

    def element(self, end: int) -> _Element:
        """The tag of the next element, which has to end before ``end``."""
        if self.bytes_.position + 8 > end:
            raise MatError("an element is cut off")
        tag = bytearray(8)
        self.bytes_.fill(memoryview(tag))
        kind, size = struct.unpack(f"{self.order}II", tag)
        start = self.bytes_.position
        if kind >> 16:
            size, kind = kind >> 16, kind & 0xFFFF
            if size > 4:
                raise MatError(f"a small element of {size} bytes")
            return _Element(kind, start - 4, size, bytes(tag[4 : 4 + size]))
        if start + size > end:
            raise MatError(f"an element of {size} bytes where {end - start} are left")
        return _Element(kind, start, size)

    def head(self, element: _Element) -> bytes:
        """The bytes of a short element: sizes, flags, a name."""
        if element.small is not None:
            return element.small
        if element.size > _MAX_HEAD:
            raise MatError(f"a head of {element.size} bytes")
        data = bytearray(element.size)
        self.bytes_.fill(memoryview(data))
        return bytes(data)

    def leave(self, element: _Element, end: int) -> None:
        """Skip to the next element."""
        if element.small is None:
            self.bytes_.skip(min(element.end + -element.size % 8, end) - self.bytes_.position)

    def integers(self, element: _Element) -> list[int]:
        code = _NUMBERS.get(element.kind)
        if code is None or code[0] not in "iu":
            raise MatError(f"a size or flag of type {element.kind}")
        kind = np.dtype(self.order + code)
        data = self.head(element)
        return [int(value) for value in np.frombuffer(data, kind, len(data) // kind.itemsize)]

    def matrix(self, element: _Element, prefix: str, depth: int) -> None:
        """Note the positions of the numbers of a variable and of its fields."""
        if depth > _MAX_DEPTH:
            raise MatError(f"structures more than {_MAX_DEPTH} levels deep")
        if element.size == 0:
            return  # an empty matrix
        end, missing = element.end, "a variable without flags, size and name"
        flags = self._required(end, missing)
        if flags.size < 8:
            raise MatError(missing)
        word = self.integers(flags)[0]
        array_class, is_complex = word & 0xFF, word & _COMPLEX_FLAG
        self.leave(flags, end)
        sizes = self._required(end, missing)
        shape = tuple(self.integers(sizes))
        self.leave(sizes, end)
        title = self._required(end, missing)
        name = self.head(title).decode("latin-1")
        self.leave(title, end)
        if array_class in _NUMERIC and not is_complex:
            self.numeric(prefix or name, shape, self._next(end))
        elif array_class == _STRUCTURE and all(size == 1 for size in shape):
            self.structure(prefix or name, end, depth)
        elif prefix or name:
            self.others[prefix or name] = (
                _COMPLEX if is_complex else _OTHERS.get(array_class, f"a variable of class {array_class}")
            )

    def _next(self, end: int) -> _Element | None:
        return self.element(end) if self.bytes_.position + 8 <= end else None

    def _required(self, end: int, missing: str) -> _Element:
        element = self._next(end)
        if element is None:
            raise MatError(missing)
        return element

    def numeric(self, name: str, shape: tuple[int, ...], element: _Element | None) -> None:
        code = "f8" if element is None else _NUMBERS.get(element.kind)
        if code is None:
            raise MatError(f"numbers of type {element.kind if element is not None else 0}")
        kind = np.dtype(self.order + code)
        count = 0 if element is None else element.size // kind.itemsize
        if min(shape, default=0) < 0 or count != math.prod(shape):
            raise MatError(f"{name}: {count} numbers for a size of {' × '.join(map(str, shape))}")
        squeezed = tuple(size for size in shape if size != 1)
        if squeezed:
            self.found[name] = MatVariable(
                squeezed, kind, self.source, self.packed, element.start if element is not None else 0
            )

    def structure(self, name: str, end: int, depth: int) -> None:
        missing = f"{name}: a structure without names of fields"
        length = self._required(end, missing)
        widths = self.integers(length)
        if not widths or not 0 < widths[0] <= 1024:
            raise MatError(missing)
        self.leave(length, end)
        names = self._required(end, missing)
        raw, width = self.head(names), widths[0]
        self.leave(names, end)
        for at in range(0, len(raw) - width + 1, width):
            value = self._next(end)
            if value is None:
                return
            if value.kind == _MATRIX:
                field_name = raw[at : at + width].split(b"\0")[0].decode("latin-1")
                self.matrix(value, f"{name}.{field_name}", depth + 1)
            self.leave(value, end)
