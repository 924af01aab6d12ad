"""MCAP files: topics → streams with the clocks ``header``, ``log`` and ``publish``. ROS 2 (CDR), JSON and protobuf messages.

A few chunks of records are in memory at a time. Of a cut or damaged file the rest is read.

Source: MCAP specification (mcap.dev/spec).
"""

from __future__ import annotations

import struct
import zlib
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, TypeAlias

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError
from sysid.logs.layout import Bytes
from sysid.logs.limits import Budget, unpack
from sysid.logs.reader import LogReader, ReadOptions, Stream
from sysid.logs.topics import Topic, check_held, finished, make_decoder

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x07, 0x0F
#: Opcode and length before every record; channel, sequence, log and publish time before the data of a message.
RECORD, MESSAGE_HEAD = 9, 22
#: Records outside of chunks are passed on in blocks of this size.
_BLOCK = 8 * 2**20
#: Largest definition or summary.
_MAX_DEFINITION = 64 * 2**20
#: Threads that unpack chunks, and bytes that they hold at most beside the chunk in use.
_THREADS, _AHEAD = 2, 32 * 2**20

Buffer: TypeAlias = bytes | bytearray | memoryview

HEAD = np.dtype(
    {
        "names": ["opcode", "length", "channel", "log", "publish"],
        "formats": ["u1", "<u8", "<u2", "<u8", "<u8"],
        "offsets": [0, 1, 9, 15, 23],
        "itemsize": RECORD + MESSAGE_HEAD,
    }
)


@dataclass(frozen=True)
class McapBlock:
    """Definitions (opcode, body), and the first bytes of message records in ``data``."""

    definitions: tuple[tuple[int, bytes], ...]
    data: Bytes
    starts: npt.NDArray[np.int64]


@dataclass(frozen=True)
class _Chunk:
    """A packed chunk and the message index behind it."""

    body: bytes
    index: tuple[bytes, ...] = ()
    cut_off: bool = False


@dataclass
class McapFile:
    """Reads a file once; ``losses`` are sentences."""

    path: Path
    budget: Budget
    losses: list[str] = field(default_factory=list)
    position: int = 0
    size: int = 1

    def blocks(self) -> Iterator[McapBlock]:
        """The summary's definitions first (they repeat those whose chunk is damaged), then the data section in order."""
        self.size = size = self.path.stat().st_size
        with self.path.open("rb") as file:
            magic = file.read(len(MAGIC))
            if magic != MAGIC:
                remedy = "Is it a ROS 1 bag?" if magic.startswith(b"#ROSBAG") else "Is it another kind of file?"
                raise InputError(self.path, f"starts with {magic.hex()}", "the magic bytes of an MCAP file", remedy)
            yield McapBlock(tuple(_summary(file, size)), _NOTHING, _NO_STARTS)
            file.seek(len(MAGIC))
            yield from self._unpacked(_data_section(file, size, self.budget.chunk))

    def _unpacked(self, items: Iterator[_Chunk | McapBlock | str]) -> Iterator[McapBlock]:
        """The blocks of ``items`` in order; the next chunks are unpacked in other threads while one is being used."""
        waiting: deque[tuple[Future[McapBlock | str] | McapBlock | str, int]] = deque()
        held = unpacked = 0
        with ThreadPoolExecutor(_THREADS) as pool:
            for item in items:
                size = self._stated_size(item.body) if isinstance(item, _Chunk) else 0
                self.position += (
                    len(item.body) if isinstance(item, _Chunk) else len(item.data) if isinstance(item, McapBlock) else 0
                )
                waiting.append((pool.submit(_unpack, item, self.budget) if isinstance(item, _Chunk) else item, size))
                held += size
                unpacked += size - len(item.body) if isinstance(item, _Chunk) else 0
                self.budget.check_unpacked(self.path, unpacked)
                while waiting and (held > _AHEAD or len(waiting) > 2 * _THREADS):
                    held -= waiting[0][1]
                    yield from self._taken(waiting.popleft()[0])
            while waiting:
                yield from self._taken(waiting.popleft()[0])

    def _stated_size(self, body: bytes) -> int:
        """Bytes of a chunk, unpacked and packed."""
        unpacked = int.from_bytes(body[16:24], "little") if len(body) >= 40 else 0
        return len(body) + min(unpacked, self.budget.chunk)

    def _taken(self, item: Future[McapBlock | str] | McapBlock | str) -> Iterator[McapBlock]:
        found = item.result() if isinstance(item, Future) else item
        if isinstance(found, str):
            self.losses.append(f"{self.path.name}: {found}")
        else:
            yield found


def _data_section(file: BinaryIO, size: int, largest: int) -> Iterator[_Chunk | McapBlock | str]:
    """Chunks, the records outside of chunks, and losses, in the order of the file."""
    position = len(MAGIC)
    loose = bytearray()
    chunk: bytes | None = None
    index: list[bytes] = []
    while True:
        head = file.read(min(RECORD, size - position))  # bytes appended since are not read
        opcode, length = struct.unpack("<BQ", head) if len(head) == RECORD else (0, 0)
        if chunk is not None and opcode != MESSAGE_INDEX:
            yield _Chunk(chunk, tuple(index))
            chunk, index = None, []
        if len(loose) > _BLOCK or (loose and opcode in (0, CHUNK, DATA_END, FOOTER)):
            yield _block(loose)
            loose = bytearray()
        if opcode in (DATA_END, FOOTER):
            return
        if opcode == 0 and len(head) == RECORD:
            yield f"no record starts at byte {position}; the part before it has been read"
            return
        start = position + RECORD
        if len(head) < RECORD or start + length > size:
            yield f"the file is cut off at byte {size}; the part before it has been read"
            if opcode == CHUNK:
                yield _Chunk(file.read(min(size - start, largest)), cut_off=True)
            return
        if opcode == CHUNK and length <= largest:
            chunk = file.read(length)
        elif opcode == MESSAGE_INDEX and chunk is not None and length <= _MAX_DEFINITION:
            index.append(file.read(length))
        elif opcode in (SCHEMA, CHANNEL, MESSAGE) and length <= (largest if opcode == MESSAGE else _MAX_DEFINITION):
            loose += head
            loose += file.read(length)
        else:
            if opcode in (CHUNK, MESSAGE, SCHEMA, CHANNEL):
                yield f"a record of {length / 2**20:.0f} MiB at byte {position} is too large and has been left out"
            file.seek(length, 1)
        position = start + length


def _unpack(chunk: _Chunk, budget: Budget) -> McapBlock | str:
    """The records of a chunk, or why there are none."""
    body = chunk.body
    if len(body) < 40:
        return McapBlock((), _NOTHING, _NO_STARTS)
    _, _, size, checksum, name_length = struct.unpack_from("<QQQII", body)
    compression = body[32 : 32 + name_length].decode("ascii", errors="replace")
    packed = memoryview(body)[32 + name_length + 8 :]
    try:
        records = unpack(packed, compression, size, budget, chunk.cut_off) if compression else packed
    except ValueError as error:
        return f"a chunk of {size} bytes cannot be unpacked ({error})"
    if checksum and not chunk.cut_off and zlib.crc32(records) != checksum:
        return f"a chunk of {size} bytes fails its checksum and has been left out"
    return indexed_block(records, chunk.index) or _block(records)


_NOTHING: Bytes = np.zeros(0, np.uint8)
_NO_STARTS = np.zeros(0, np.int64)


def _summary(file: BinaryIO, size: int) -> Iterator[tuple[int, bytes]]:
    """Schemas and channels of the summary section; none where the footer is missing or invalid."""
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


def walk(records: Buffer, start: int = 0, end: int | None = None) -> Iterator[tuple[int, int, int]]:
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


def _block(records: Buffer) -> McapBlock:
    """Index of consecutive records."""
    starts = []
    definitions = []
    for position, opcode, length in walk(records):
        if opcode == MESSAGE and length >= MESSAGE_HEAD:
            starts.append(position)
        elif opcode in (SCHEMA, CHANNEL):
            definitions.append((opcode, bytes(records[position + RECORD : position + RECORD + length])))
    return McapBlock(tuple(definitions), np.frombuffer(records, np.uint8), np.array(starts, dtype=np.int64))


def indexed_block(records: Buffer, index: Sequence[bytes]) -> McapBlock | None:
    """:func:`_block` from the message index behind the chunk; None unless the index accounts for every byte of the chunk."""
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
                definitions.append((opcode, bytes(records[at + RECORD : at + RECORD + length])))
            position = at + RECORD + length
        if position != after[gap]:
            return None
    return McapBlock(tuple(definitions), data, starts)


class McapReader(LogReader):
    """The default clock is ``header`` (time of measurement), for messages with ``header.stamp`` or ``stamp``."""

    name = "mcap"
    suffixes = (".mcap",)
    clocks = ("header", "log", "publish")

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        budget = options.budget_of(path, "an MCAP file", None)
        file = McapFile(path, budget)
        log = _Log(path, options, budget, file.losses)
        for block in file.blocks():
            for opcode, body in block.definitions:
                log.define(opcode, body)
            log.take(block)
            options.progress(min(1.0, file.position / file.size))
        return finished(log.topics.values(), log.names.values(), options, path, file.losses)


@dataclass
class _Log:
    """State of reading one file."""

    path: Path
    options: ReadOptions
    budget: Budget
    losses: list[str]
    schemas: dict[int, tuple[str, str, bytes]] = field(default_factory=dict)
    names: dict[int, str] = field(default_factory=dict)
    #: Channel number → its topic; two channels of one topic and type are one stream.
    channels: dict[int, Topic] = field(default_factory=dict)
    topics: dict[tuple[str, str, str], Topic] = field(default_factory=dict)

    def define(self, opcode: int, body: bytes) -> None:
        """Parse a schema or channel record that is not yet known."""
        reader = _Fields(body)
        number = reader.integer(2)
        if opcode == SCHEMA:
            self.schemas.setdefault(number, (reader.text(), reader.text(), reader.block()))
        elif opcode == CHANNEL and number not in self.names:
            self._channel(number, reader.integer(2), reader.text(), reader.text())

    def _channel(self, number: int, schema: int, topic: str, encoding: str) -> None:
        self.names[number] = topic
        if not self.options.wants(topic):
            return
        kind, schema_encoding, text = self.schemas.get(schema, ("", "", b""))
        key = (topic, kind, encoding)
        if key not in self.topics:
            where = f"{self.path}: {topic}"
            self.budget.check_topics(self.path, len(self.topics) + 1)
            try:
                decoder = make_decoder(topic, kind, encoding, schema_encoding, text, self.options, where, self.budget)
            except InputError as error:
                if self.options.streams is not None:
                    raise
                self.losses.append(str(error))
                return
            others = sum(name == topic for name, _, _ in self.topics)
            self.topics[key] = Topic(f"{topic}#{others + 1}" if others else topic, kind, decoder)
        self.channels[number] = self.topics[key]

    def take(self, block: McapBlock) -> None:
        """Pass the messages of ``block`` to their topics."""
        if not len(block.starts):
            return
        data: Bytes = block.data
        windows = np.ndarray((len(data) - HEAD.itemsize + 1,), dtype=HEAD, buffer=data, strides=(1,))
        heads = windows[block.starts]
        for number in np.unique(heads["channel"]):
            topic = self.channels.get(int(number))
            if topic is None:
                continue
            own = heads["channel"] == number
            topic.log.extend(heads["log"][own].astype(np.int64))
            topic.publish.extend(heads["publish"][own].astype(np.int64))
            sizes = heads["length"][own].astype(np.int64) - MESSAGE_HEAD
            topic.decoder.add(data, block.starts[own] + RECORD + MESSAGE_HEAD, sizes)
        check_held(self.path, self.topics.values(), self.budget)


@dataclass
class _Fields:
    """The fields of a small record in order; fields beyond its end are empty."""

    body: bytes
    position: int = 0

    def integer(self, size: int) -> int:
        self.position += size
        return int.from_bytes(self.body[self.position - size : self.position], "little")

    def block(self) -> bytes:
        length = self.integer(4)
        self.position += length
        return self.body[self.position - length : self.position]

    def text(self) -> str:
        return self.block().decode("utf-8", errors="replace")
