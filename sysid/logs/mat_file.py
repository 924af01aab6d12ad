"""The numeric variables of a MATLAB file of version 4 to 7 (``-v4``, ``-v6``, ``-v7``), and those in its structures.

Written here because the common reader trusts the sizes that a damaged file states and ends the process with it. Texts, cells,
sparse matrices, objects, arrays of structures and imaginary parts are passed over: they are no signals.
Source: MathWorks, "MAT-File Format", level 5 and level 4.
"""

from __future__ import annotations

import math
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
import numpy.typing as npt

from sysid.logs.limits import FREE, MAX_RATIO, MAX_TEXT

#: Storage types of numbers → NumPy code without byte order.
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _PACKED = 14, 15
#: Array classes: structure, and the numeric ones.
_STRUCTURE, _NUMERIC = 2, range(6, 16)
_MAX_DEPTH = 16


class MatError(ValueError):
    """The file is damaged, or asks for more than is read."""


@dataclass(frozen=True)
class _Element:
    kind: int
    start: int
    size: int


def read_arrays(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Variable, or ``structure.field`` → numbers without dimensions of one, in the types the file has.

    Raises:
        MatError: the file is damaged or unpacks to more than is read.
    """
    found: dict[str, npt.NDArray[Any]] = {}
    with path.open("rb") as file:
        head = file.read(128)
        if head[126:128] not in (b"IM", b"MI"):
            file.seek(0)
            return dict(_version_4(file))
        order: Literal["<", ">"] = "<" if head[126:128] == b"IM" else ">"
        left = min(MAX_TEXT, max(FREE, path.stat().st_size * MAX_RATIO))
        for kind, body in _top_level(file, order):
            data = _unpacked(body, left) if kind == _PACKED else body
            left -= len(data)
            inner = _Reader(data, order)
            if kind == _PACKED:
                element = inner.element(0, len(data))
                if element.kind == _MATRIX:
                    inner.matrix(element, "", found, 0)
            elif kind == _MATRIX:
                inner.matrix(_Element(kind, 0, len(data)), "", found, 0)
    return found


#: Version 4: the hundreds, tens and ones of the type say how numbers are stored, and whether they are numbers.
_STORED_4 = ("f8", "f4", "i4", "i2", "u2", "u1")


def _version_4(file: BinaryIO) -> Iterator[tuple[str, npt.NDArray[Any]]]:
    """Matrices one after the other: type, rows, columns, complex, length of the name; name; numbers."""
    while head := file.read(20):
        for order in "<>":
            kind, rows, columns, is_complex, length = struct.unpack(f"{order}5i", head.ljust(20, b"\xff"))
            if kind // 1000 == "<>".index(order) and 0 <= kind % 100 < 60 and 0 < length <= 256 and rows >= 0 and columns >= 0:
                break
        else:
            raise MatError("no variable of a MATLAB file of version 4 or 5")
        code = np.dtype(order + _STORED_4[kind % 100 // 10])
        size = rows * columns * code.itemsize
        name = file.read(length).split(b"\0")[0].decode("latin-1")
        if size > MAX_TEXT:
            raise MatError(f"{name}: {rows} × {columns} numbers")
        data = _read(file, size, repr(name))
        if is_complex:
            file.seek(size, 1)
        array = np.frombuffer(data, code).reshape((rows, columns), order="F").squeeze()
        if kind % 10 == 0 and array.ndim:
            yield name, array


def _top_level(file: BinaryIO, order: str) -> Iterator[tuple[int, bytes]]:
    while tag := file.read(8):
        if len(tag) < 8:
            raise MatError("the file is cut off")
        kind, size = struct.unpack(f"{order}II", tag)
        yield kind, _read(file, size, "a variable")


def _read(file: BinaryIO, size: int, what: str) -> bytes:
    """``size`` bytes, asked for only where the file has them."""
    left = os.fstat(file.fileno()).st_size - file.tell()
    if left < size:
        raise MatError(f"the file is cut off: {max(left, 0)} of {size} bytes of {what}")
    return file.read(size)


def _unpacked(packed: bytes, limit: int) -> bytes:
    unpacker = zlib.decompressobj()
    try:
        data = unpacker.decompress(packed, max(limit, 1) + 1)
    except zlib.error as error:
        raise MatError(f"a packed variable is damaged ({error})") from None
    if len(data) > limit:
        raise MatError(f"variables that unpack to more than {limit / 2**20:.0f} MiB, {MAX_RATIO} times the file")
    return data


@dataclass(frozen=True)
class _Reader:
    data: bytes
    order: str

    def element(self, at: int, end: int) -> _Element:
        """The element at ``at``; it has to end before ``end``."""
        if at + 8 > end:
            raise MatError("an element is cut off")
        kind, size = struct.unpack_from(f"{self.order}II", self.data, at)
        if kind >> 16:  # a small element: size and data share the tag
            size, kind, start = kind >> 16, kind & 0xFFFF, at + 4
            if size > 4:
                raise MatError(f"a small element of {size} bytes")
        else:
            start = at + 8
        if start + size > end:
            raise MatError(f"an element of {size} bytes where {end - start} are left")
        return _Element(kind, start, size)

    def elements(self, start: int, end: int) -> Iterator[_Element]:
        at = start
        while at + 8 <= end:
            element = self.element(at, end)
            yield element
            small = element.start == at + 4
            at = at + 8 if small else element.start + element.size + (-element.size % 8 if element.kind != _PACKED else 0)

    def numbers(self, element: _Element) -> npt.NDArray[Any]:
        code = _NUMBERS.get(element.kind)
        if code is None:
            raise MatError(f"numbers of type {element.kind}")
        kind = np.dtype(self.order + code)
        return np.frombuffer(self.data, kind, element.size // kind.itemsize, element.start)

    def integers(self, element: _Element) -> npt.NDArray[Any]:
        values = self.numbers(element)
        if values.dtype.kind not in "iu":
            raise MatError(f"a size or flag of type {element.kind}")
        return values

    def matrix(self, element: _Element, prefix: str, into: dict[str, npt.NDArray[Any]], depth: int) -> None:
        """Put the numbers of a variable, and of what it contains, into ``into``."""
        if depth > _MAX_DEPTH:
            raise MatError(f"structures more than {_MAX_DEPTH} levels deep")
        if element.size == 0:
            return  # an empty matrix
        parts = self.elements(element.start, element.start + element.size)
        flags, sizes, title = (next(parts, None) for _ in range(3))
        if flags is None or sizes is None or title is None or flags.size < 8:
            raise MatError("a variable without flags, size and name")
        array_class = int(self.integers(flags)[0]) & 0xFF
        shape = tuple(int(size) for size in self.integers(sizes))
        text = self.data[title.start : title.start + title.size].decode("latin-1")
        name = prefix or text
        if array_class in _NUMERIC:
            self.numeric(name, shape, next(parts, None), into)
        elif array_class == _STRUCTURE and all(size == 1 for size in shape):
            self.structure(name, parts, into, depth)

    def numeric(self, name: str, shape: tuple[int, ...], element: _Element | None, into: dict[str, npt.NDArray[Any]]) -> None:
        values = self.numbers(element) if element is not None else np.zeros(0)
        if min(shape, default=0) < 0 or len(values) != math.prod(shape):
            raise MatError(f"{name}: {len(values)} numbers for a size of {' × '.join(map(str, shape))}")
        array = values.reshape(shape, order="F").squeeze()
        if array.ndim:
            into[name] = array

    def structure(self, name: str, parts: Iterator[_Element], into: dict[str, npt.NDArray[Any]], depth: int) -> None:
        length, names = next(parts, None), next(parts, None)
        if length is None or names is None:
            raise MatError(f"{name}: a structure without names of fields")
        widths = self.integers(length)
        if not len(widths) or not 0 < int(widths[0]) <= 1024:
            raise MatError(f"{name}: a structure without names of fields")
        width = int(widths[0])
        raw = self.data[names.start : names.start + names.size]
        fields = [raw[at : at + width].split(b"\0")[0].decode("latin-1") for at in range(0, len(raw) - width + 1, width)]
        for field, value in zip(fields, parts, strict=False):
            if value.kind == _MATRIX:
                self.matrix(value, f"{name}.{field}", into, depth + 1)
