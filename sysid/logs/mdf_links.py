"""Checks of the blocks of an MDF 4 file before a library reads it: chains end, and packed data are no decompression bomb.

The header links to chains of data groups, file histories, hierarchies, attachments and events; a data group to its channel
groups and its data, a channel group to its channels, a channel to its components and its own data. No block belongs to two
chains. Data are one block, or lists of blocks; a packed one (``DZ``) states its unpacked size.
Source: ASAM MDF 4.1 programmers' guide, "Block structure".
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from sysid.errors import InputError
from sysid.logs.limits import Budget

#: Positions of the header's links to the chains: data groups, histories, hierarchies, attachments, events.
_CHAINS = {88: "DG", 96: "FH", 104: "CH", 112: "AT", 120: "EV"}
#: Id, length and number of links (24 bytes) are followed by the links to the next block of the kind and to the first child.
_COUNT, _NEXT, _BELOW = 16, 24, 32
_CHILD = {"DG": "CG", "CG": "CN", "CN": "CN", "CH": "CH"}
#: Position of the link of a data group and of a channel to their data.
_DATA = {"DG": 40, "CN": 64}
#: Of a packed block: original kind, method, parameter, size unpacked and packed.
_PACKED = struct.Struct("<2sBxLQQ")
_PIECE = 2**20


def check_blocks(path: Path, budget: Budget) -> None:
    """Raise where a chain of blocks has no end, or a packed block is larger than stated or allowed.

    Raises:
        InputError: the file is damaged, or malicious.
    """
    with path.open("rb") as file:
        packed = unpacked = 0
        for at in _blocks(path, file):
            if _read(file, at, 4) == b"##DZ":
                sizes = _packed_block(path, file, at, budget)
                packed, unpacked = packed + sizes[0], unpacked + sizes[1]
                budget.check_unpacked(path, unpacked)
        reason = budget.too_large(packed, unpacked, at_once=False)
        if reason:
            raise InputError(path, f"packed data: {reason}", "a log", "The file is damaged or malicious.")


def _blocks(path: Path, file: BinaryIO) -> Iterator[int]:
    """Positions of all blocks of data."""
    waiting = [(kind, _link(file, at)) for at, kind in _CHAINS.items()]
    seen: set[tuple[str, int]] = set()
    while waiting:
        kind, at = waiting.pop()
        if not at:
            continue
        if (kind, at) in seen:
            raise InputError(path, f"two links to the block at byte {at}", "chains of blocks that end", "The file is damaged.")
        seen.add((kind, at))
        waiting.append((kind, _link(file, at + _NEXT)))
        if kind == "DL":
            for number in range(1, int.from_bytes(_read(file, at + _COUNT, 4), "little")):
                block = _link(file, at + _NEXT + 8 * number)
                if not block:
                    break
                yield block
        if kind in _CHILD and not (kind in ("CN", "CH") and _read(file, _link(file, at + _BELOW), 4) != f"##{kind}".encode()):
            waiting.append((_CHILD[kind], _link(file, at + _BELOW)))
        if kind in _DATA:
            data = _link(file, at + _DATA[kind])
            data = _link(file, data + _NEXT) if data and _read(file, data, 4) == b"##HL" else data
            if data and _read(file, data, 4) == b"##DL":
                waiting.append(("DL", data))
            elif data:
                yield data


def _packed_block(path: Path, file: BinaryIO, at: int, budget: Budget) -> tuple[int, int]:
    """Packed and unpacked size of a packed block [bytes]."""
    head = _read(file, at + _NEXT, _PACKED.size)
    if len(head) < _PACKED.size:
        return 0, 0
    _, _, _, stated, size = _PACKED.unpack(head)
    reason = budget.too_large(size, stated)
    unpacker, left, total = zlib.decompressobj(), min(size, path.stat().st_size), 0
    while not reason and left > 0 and (piece := file.read(min(left, _PIECE))):
        left -= len(piece)
        while piece and not reason:
            try:
                total += len(unpacker.decompress(piece, _PIECE))
            except zlib.error:
                return size, total  # reported when the samples are read
            piece = unpacker.unconsumed_tail
            reason = f"more than the {stated} bytes that it states" if total > stated else ""
    if reason:
        raise InputError(path, f"a packed block at byte {at}: {reason}", "a log", "The file is damaged or malicious.")
    return size, total


def _read(file: BinaryIO, at: int, size: int) -> bytes:
    file.seek(at)
    return file.read(size)


def _link(file: BinaryIO, at: int) -> int:
    """Target of the link at this position; 0 where it is outside the file."""
    cell = _read(file, at, 8)
    target: int = struct.unpack("<Q", cell)[0] if len(cell) == 8 else 0
    return target if target < file.seek(0, 2) else 0
