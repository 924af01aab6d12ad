"""The records of an MCAP file, one chunk in memory at a time. A cut-off or damaged file gives what is left.

Source: MCAP specification (mcap.dev/spec).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError
from sysid.logs.layout import Bytes
from sysid.logs.limits import MAX_CHUNK, unpack

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x07, 0x0F
#: Opcode and length before every record; channel, sequence, log and publish time before the data of a message.
RECORD, MESSAGE_HEAD = 9, 22
#: Records outside of chunks are handed on in blocks of this size.
_BLOCK = 8 * 2**20
#: A definition, or the whole summary, is not longer than this.
_MAX_DEFINITION = 64 * 2**20

HEAD = np.dtype(
    {
        "names": ["opcode", "length", "channel", "log", "publish"],
        "formats": ["u1", "<u8", "<u2", "<u8", "<u8"],
        "offsets": [0, 1, 9, 15, 23],
        "itemsize": RECORD + MESSAGE_HEAD,
    }
)


@dataclass(frozen=True)
class Block:
    """Definitions (opcode, body), and message records: where they start in ``data``."""

    definitions: tuple[tuple[int, bytes], ...]
    data: Bytes
    starts: npt.NDArray[np.int64]


@dataclass
class McapFile:
    """Walks a file once; what could not be read stands in ``losses``, in words."""

    path: Path
    losses: list[str] = field(default_factory=list)

    def blocks(self) -> Iterator[Block]:
        """The summary's definitions first (they repeat those whose chunk is damaged), then the data section in order."""
        size = self.path.stat().st_size
        with self.path.open("rb") as file:
            magic = file.read(len(MAGIC))
            if magic != MAGIC:
                remedy = "Is it a ROS 1 bag?" if magic.startswith(b"#ROSBAG") else "Is it another kind of file?"
                raise InputError(self.path, f"starts with {magic.hex()}", "the magic bytes of an MCAP file", remedy)
            yield Block(tuple(_summary(file, size)), _NOTHING, _NO_STARTS)
            file.seek(len(MAGIC))
            yield from self._data_section(file, size)

    def _lose(self, text: str) -> None:
        self.losses.append(f"{self.path.name}: {text}")

    def _data_section(self, file: BinaryIO, size: int) -> Iterator[Block]:
        position = len(MAGIC)
        loose = bytearray()
        chunk: bytes | None = None
        index: list[bytes] = []
        while True:
            head = file.read(RECORD)
            opcode, length = struct.unpack("<BQ", head) if len(head) == RECORD else (0, 0)
            if chunk is not None and opcode != MESSAGE_INDEX:
                yield self._chunk(chunk, index)
                chunk, index = None, []
            if len(loose) > _BLOCK or (loose and opcode in (0, CHUNK, DATA_END, FOOTER)):
                yield _block(bytes(loose))
                loose.clear()
            if opcode in (DATA_END, FOOTER):
                return
            if opcode == 0 and len(head) == RECORD:
                self._lose(f"no record starts at byte {position}; what lies before has been read")
                return
            start = position + RECORD
            if len(head) < RECORD or start + length > size:
                self._lose(f"the file is cut off at byte {size}; what lies before has been read")
                if opcode == CHUNK:
                    yield self._chunk(file.read(min(size - start, MAX_CHUNK)), [], cut_off=True)
                return
            if opcode == CHUNK and length <= MAX_CHUNK:
                chunk = file.read(length)
            elif opcode == MESSAGE_INDEX and chunk is not None:
                index.append(file.read(length))
            elif opcode in (SCHEMA, CHANNEL, MESSAGE) and length <= (MAX_CHUNK if opcode == MESSAGE else _MAX_DEFINITION):
                loose += head + file.read(length)
            else:
                if opcode in (CHUNK, MESSAGE, SCHEMA, CHANNEL):
                    self._lose(f"a record of {length / 2**20:.0f} MiB at byte {position} is too large and has been left out")
                file.seek(length, 1)
            position = start + length

    def _chunk(self, body: bytes, index: list[bytes], cut_off: bool = False) -> Block:
        """The records of a chunk; nothing where it is damaged."""
        nothing = Block((), _NOTHING, _NO_STARTS)
        if len(body) < 40:
            return nothing
        _, _, size, checksum, name_length = struct.unpack_from("<QQQII", body)
        compression = body[32 : 32 + name_length].decode("ascii", errors="replace")
        packed = body[32 + name_length + 8 :]
        try:
            records = unpack(packed, compression, size, cut_off) if compression else packed
        except ValueError as error:
            self._lose(f"a chunk of {size} bytes cannot be unpacked ({error})")
            return nothing
        if checksum and not cut_off and zlib.crc32(records) != checksum:
            self._lose(f"a chunk of {size} bytes fails its checksum and has been left out")
            return nothing
        return _indexed_block(records, index) or _block(records)


_NOTHING: Bytes = np.zeros(0, np.uint8)
_NO_STARTS = np.zeros(0, np.int64)


def _summary(file: BinaryIO, size: int) -> Iterator[tuple[int, bytes]]:
    """Schemas and channels of the summary section; nothing where the footer is missing or makes no sense."""
    at = size - len(MAGIC) - RECORD - 20
    if at < len(MAGIC):
        return
    file.seek(at)
    opcode, length, start = struct.unpack("<BQQ", file.read(RECORD + 8))
    if opcode != FOOTER or length != 20 or not len(MAGIC) <= start < at or at - start > 4 * _MAX_DEFINITION:
        return
    file.seek(start)
    records = file.read(at - start)
    for position, kind, extent in walk(records):
        if kind in (SCHEMA, CHANNEL):
            yield kind, records[position + RECORD : position + RECORD + extent]


def walk(records: bytes, start: int = 0, end: int | None = None) -> Iterator[tuple[int, int, int]]:
    """Position, opcode and length of every whole record."""
    unpack_head = struct.Struct("<BQ").unpack_from
    position, end = start, len(records) if end is None else end
    while position + RECORD <= end:
        opcode, length = unpack_head(records, position)
        after = position + RECORD + length
        if after > end:
            return
        yield position, opcode, length
        position = after


def _block(records: bytes) -> Block:
    """Records one after the other."""
    starts = []
    definitions = []
    for position, opcode, length in walk(records):
        if opcode == MESSAGE and length >= MESSAGE_HEAD:
            starts.append(position)
        elif opcode in (SCHEMA, CHANNEL):
            definitions.append((opcode, records[position + RECORD : position + RECORD + length]))
    return Block(tuple(definitions), np.frombuffer(records, np.uint8), np.array(starts, dtype=np.int64))


def _indexed_block(records: bytes, index: list[bytes]) -> Block | None:
    """The same by the message index behind the chunk; None unless the index accounts for every byte of the chunk."""
    entries = [np.frombuffer(body, "<u8", offset=6, count=(len(body) - 6) // 16 * 2)[1::2] for body in index if len(body) > 6]
    if not entries:
        return None
    starts = np.sort(np.concatenate(entries).astype(np.int64))
    if not len(starts) or starts[0] < 0 or starts[-1] + HEAD.itemsize > len(records):
        return None
    data = np.frombuffer(records, np.uint8)
    heads = np.ndarray((len(records) - HEAD.itemsize + 1,), dtype=HEAD, buffer=data, strides=(1,))[starts]
    lengths = heads["length"].astype(np.int64)
    if np.any(heads["opcode"] != MESSAGE) or np.any((lengths < MESSAGE_HEAD) | (lengths > len(records))):
        return None
    ends = starts + RECORD + lengths
    before, after = np.concatenate([[0], ends]), np.concatenate([starts, [len(records)]])
    if np.any(after < before):
        return None
    definitions = []
    for gap in np.flatnonzero(after > before):
        position = int(before[gap])
        for at, opcode, length in walk(records, position, int(after[gap])):
            if opcode == MESSAGE:
                return None
            if opcode in (SCHEMA, CHANNEL):
                definitions.append((opcode, records[at + RECORD : at + RECORD + length]))
            position = at + RECORD + length
        if position != after[gap]:
            return None
    return Block(tuple(definitions), data, starts)
