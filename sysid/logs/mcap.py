"""MCAP files of ROS 2: topics → streams with the clocks ``header``, ``log`` and ``publish``. A cut-off file gives what is left.

Source: MCAP specification (mcap.dev/spec), records of the data section.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError, nearest
from sysid.logs.cdr import Bytes, ColumnDecoder, check_encoding
from sysid.logs.reader import ReadOptions
from sysid.logs.rosmsg import parse_definition
from sysid.logs.stream import Stream
from sysid.logs.table import check_not_empty

MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0F
#: Opcode and length before every record; channel, sequence, log and publish time before the data of a message.
_RECORD, _MESSAGE_HEAD = 9, 22
_SECOND = 1_000_000_000


@dataclass
class _Channel:
    topic: str
    decoder: ColumnDecoder
    log: list[npt.NDArray[np.int64]] = field(default_factory=list)
    publish: list[npt.NDArray[np.int64]] = field(default_factory=list)


@dataclass
class _Log:
    """What has been read of a file so far."""

    path: Path
    wanted: frozenset[str] | None
    schemas: dict[int, tuple[str, str, str]] = field(default_factory=dict)
    topics: dict[int, str] = field(default_factory=dict)
    channels: dict[int, _Channel] = field(default_factory=dict)
    losses: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class McapReader:
    """``header`` stamps (when it was measured) come first; they exist where a message has ``header.stamp`` or ``stamp``."""

    name: str = "mcap"
    suffixes: tuple[str, ...] = (".mcap",)
    clocks: tuple[str, ...] = ("header", "log", "publish")

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        check_not_empty(path, "an MCAP file")
        data = np.fromfile(path, dtype=np.uint8)
        if data[: len(MAGIC)].tobytes() != MAGIC:
            raise InputError(
                path, f"starts with {data[:8].tobytes().hex()}", "the magic bytes of an MCAP file", "Is it a ROS 1 bag?"
            )
        log = _Log(path, options.streams)
        _read_records(data, log)
        known = set(log.topics.values())
        for topic in sorted(options.streams or ()):
            if topic not in known:
                lost = f" ({log.losses[0]})" if log.losses else ""
                raise InputError(path, f"no topic {topic!r}{lost}", nearest(topic, known), "Correct `topic` in the recipe.")
        streams = tuple(_stream(channel, log) for channel in log.channels.values() if channel.decoder.total)
        if not streams:
            found = log.losses[0] if log.losses else "no messages"
            raise InputError(path, found, "at least one readable message", "Record the log again.")
        return streams


def _read_records(data: Bytes, log: _Log) -> None:
    """All messages. Definitions come first: the summary repeats those whose chunk is damaged."""
    records, complete, cut_off = _outline(data)
    for wanted in (_SCHEMA, _CHANNEL):
        for opcode, start, length in records:
            if opcode == wanted:
                _read_definition(opcode, data[start : start + length].tobytes(), log)
    if not complete:
        log.losses.append(f"{log.path.name}: the file is cut off at byte {len(data)}; what lies before has been read")
    for opcode, start, length in records:
        if opcode == _CHUNK:
            _read_chunk(data[start : start + length], log)
    loose = [start - _RECORD for opcode, start, _ in records if opcode == _MESSAGE]
    _take_messages(data, np.array(loose, dtype=np.int64), log)
    if cut_off is not None:
        _read_chunk(data[cut_off:], log, cut_off=True)


def _outline(data: Bytes) -> tuple[list[tuple[int, int, int]], bool, int | None]:
    """Opcode, start and length of every whole record; whether the data section is complete; where a cut-off chunk starts."""
    records: list[tuple[int, int, int]] = []
    position, end, complete = len(MAGIC), len(data), False
    while position + _RECORD <= end:
        opcode = int(data[position])
        length = int(data[position + 1 : position + _RECORD].view("<u8")[0])
        start = position + _RECORD
        if start + length > end:
            return records, complete, start if opcode == _CHUNK else None
        complete = complete or opcode == _DATA_END
        records.append((opcode, start, length))
        position = start + length
        if opcode == _FOOTER:
            break
    return records, complete, None


def _read_definition(opcode: int, body: bytes, log: _Log) -> None:
    reader = _Fields(body)
    if opcode == _SCHEMA:
        number = reader.integer(2)
        name, encoding = reader.text(), reader.text()
        log.schemas[number] = (name, encoding, reader.text())
        return
    number, schema = reader.integer(2), reader.integer(2)
    topic, encoding = reader.text(), reader.text()
    log.topics[number] = topic
    if number in log.channels or (log.wanted is not None and topic not in log.wanted):
        return
    where = f"{log.path}: {topic}"
    name, schema_encoding, text = log.schemas.get(schema, ("", "", ""))
    try:
        check_encoding(encoding, schema_encoding, where)
    except InputError as error:
        if log.wanted is not None:
            raise
        log.losses.append(str(error))
        return
    log.channels[number] = _Channel(topic, ColumnDecoder(parse_definition(name, text, where), where))


@dataclass
class _Fields:
    """Reads the fields of a small record one after the other."""

    body: bytes
    position: int = 0

    def integer(self, size: int) -> int:
        self.position += size
        return int.from_bytes(self.body[self.position - size : self.position], "little")

    def text(self) -> str:
        length = self.integer(4)
        self.position += length
        return self.body[self.position - length : self.position].decode("utf-8", errors="replace")


def _read_chunk(body: Bytes, log: _Log, cut_off: bool = False) -> None:
    head = body[:64].tobytes()
    if len(head) < 40:
        return
    _, _, size, checksum, name_length = struct.unpack_from("<QQQII", head)
    compression = head[32 : 32 + name_length].decode("ascii", errors="replace")
    packed = body[32 + name_length + 8 :]
    records = _unpack(packed.tobytes(), compression, size, log, cut_off)
    if records is None:
        return
    if checksum and not cut_off and zlib.crc32(records) != checksum:
        log.losses.append(f"{log.path.name}: a chunk of {size} bytes fails its checksum and has been left out")
        return
    data = np.frombuffer(records, dtype=np.uint8)
    starts = []
    for position, opcode, length in _walk(records):
        if opcode == _MESSAGE:
            starts.append(position)
        elif opcode in (_SCHEMA, _CHANNEL):
            _read_definition(opcode, records[position + _RECORD : position + _RECORD + length], log)
    _take_messages(data, np.array(starts, dtype=np.int64), log)


def _walk(records: bytes) -> Iterator[tuple[int, int, int]]:
    """Position, opcode and length of every whole record."""
    unpack = struct.Struct("<BQ").unpack_from
    position, end = 0, len(records)
    while position + _RECORD <= end:
        opcode, length = unpack(records, position)
        after = position + _RECORD + length
        if after > end:
            return
        yield position, opcode, length
        position = after


def _unpack(packed: bytes, compression: str, size: int, log: _Log, cut_off: bool) -> bytes | None:
    """The records of a chunk; of a cut-off chunk as many bytes as can be unpacked."""
    if compression == "":
        return packed
    if compression == "zstd":
        import zstandard

        try:
            if not cut_off:
                return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
            return zstandard.ZstdDecompressor().decompressobj().decompress(packed)
        except zstandard.ZstdError as error:
            log.losses.append(f"{log.path.name}: a chunk of {size} bytes cannot be unpacked ({error})")
            return None
    if compression == "lz4":
        import lz4.frame  # type: ignore[import-untyped]

        try:
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed))
        except RuntimeError as error:
            log.losses.append(f"{log.path.name}: a chunk of {size} bytes cannot be unpacked ({error})")
            return None
    raise InputError(log.path, f"chunks compressed with {compression!r}", "zstd, lz4 or none")


def _take_messages(data: Bytes, starts: npt.NDArray[np.int64], log: _Log) -> None:
    """Hand the message records at ``starts`` to their channels."""
    if not len(starts):
        return
    windows = np.ndarray((len(data) - _RECORD - _MESSAGE_HEAD + 1,), dtype=_HEAD, buffer=data, strides=(1,))
    heads = windows[starts]
    for number in np.unique(heads["channel"]):
        channel = log.channels.get(int(number))
        if channel is None:
            continue
        own = heads["channel"] == number
        channel.log.append(heads["log"][own].astype(np.int64))
        channel.publish.append(heads["publish"][own].astype(np.int64))
        sizes = heads["length"][own].astype(np.int64) - _MESSAGE_HEAD
        channel.decoder.add(data, starts[own] + _RECORD + _MESSAGE_HEAD, sizes)


_HEAD = np.dtype(
    {
        "names": ["length", "channel", "log", "publish"],
        "formats": ["<u8", "<u2", "<u8", "<u8"],
        "offsets": [1, 9, 15, 23],
        "itemsize": _RECORD + _MESSAGE_HEAD,
    }
)


def _stream(channel: _Channel, log: _Log) -> Stream:
    decoder = channel.decoder
    stamps: dict[str, npt.NDArray[np.int64]] = {}
    for prefix in ("header.stamp", "stamp"):
        seconds, nanoseconds = decoder.integers(f"{prefix}.sec"), decoder.integers(f"{prefix}.nanosec")
        if seconds is not None and nanoseconds is not None:
            stamps["header"] = seconds * _SECOND + nanoseconds
            break
    stamps["log"] = np.concatenate(channel.log)
    stamps["publish"] = np.concatenate(channel.publish)
    columns = decoder.columns()
    losses = list(log.losses)
    if decoder.unreadable:
        readable = decoder.readable()
        stamps = {clock: values[readable] for clock, values in stamps.items()}
        columns = {path: values[readable] for path, values in columns.items()}
        losses.append(f"{log.path.name}: {channel.topic}: {decoder.unreadable} messages do not follow their schema")
    return Stream(channel.topic, log.path, stamps, columns, {}, tuple(losses))
