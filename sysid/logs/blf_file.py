"""Checks of a BLF file before a library reads it: unpacked sizes of containers, sizes of objects.

A file is a header and objects; those of type 10 are containers that hold the logged objects, zlib-packed, one after the other
and across their borders. Every object begins with ``LOBJ``, the size of its header, its version, its own size and its type.
Source: python-can, ``can.io.blf``, which follows Vector's description of the format.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

from sysid.errors import InputError
from sysid.logs.limits import Budget

#: Headers of an object (signature, header size and version, size, type) and of a container (method, unpacked size).
_OBJECT, _CONTAINER = struct.Struct("<4sHHLL"), struct.Struct("<H6xL4x")
_CONTAINER_TYPE, _ZLIB = 10, 2
#: Smallest frame (its object header), and largest object (frames, texts, settings) [bytes].
_SMALLEST, _LARGEST = 32, 16 * 2**20


def most_frames(path: Path, budget: Budget) -> int:
    """Upper bound of the number of frames in the file.

    Raises:
        InputError: no BLF file, a container that unpacks to more than its budget, an object of invalid size.
    """
    total, rest = 0, b""
    size_of_file = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(8)
        if head[:4] != b"LOGG" or len(head) < 8:
            raise InputError(path, f"starts with {head[:4].hex() or 'nothing'}", "the magic bytes 'LOGG' of a BLF log")
        file.seek(int.from_bytes(head[4:8], "little"))
        while len(base := file.read(_OBJECT.size)) == _OBJECT.size:
            signature, _, _, size, kind = _OBJECT.unpack(base)
            body = file.read(max(min(size, size_of_file) - _OBJECT.size, 0))
            file.read(size % 4)
            if signature != b"LOBJ" or kind != _CONTAINER_TYPE or len(body) < _CONTAINER.size:
                continue
            data = _unpacked(path, body, budget)
            total += len(data)
            budget.check_unpacked(path, total)
            rest = _without_objects(path, rest + data)
    return total // _SMALLEST


def _unpacked(path: Path, body: bytes, budget: Budget) -> bytes:
    method, _ = _CONTAINER.unpack_from(body)
    packed = body[_CONTAINER.size :]
    if method != _ZLIB:
        return packed
    unpacker = zlib.decompressobj()
    try:
        data = unpacker.decompress(packed, budget.chunk + 1)
    except zlib.error:
        return b""  # reported when the frames are read
    reason = budget.too_large(len(packed), len(data))
    if reason:
        raise InputError(path, f"a container that {reason}", "a log", "The file is damaged or malicious.")
    return data


def _without_objects(path: Path, data: bytes) -> bytes:
    """The rest behind the last whole object: the beginning of one that continues in the next container."""
    position = 0
    while True:
        start = data.find(b"LOBJ", position, position + 8)
        if start < 0 or start + _OBJECT.size > len(data):
            return data[position:] if len(data) - position < _LARGEST else b""
        size = int.from_bytes(data[start + 8 : start + 12], "little")
        if not _OBJECT.size <= size <= _LARGEST:
            expected = f"{_OBJECT.size} to {_LARGEST}"
            raise InputError(path, f"an object of {size} bytes", expected, "The file is damaged.")
        if start + size > len(data):
            return data[position:]
        position = start + size
