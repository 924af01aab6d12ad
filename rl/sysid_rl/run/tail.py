"""New messages of an MCAP file that is still being written.

Incomplete records are read later. The file may be truncated to its last complete record, as by a writer on a full disk.
Source: MCAP specification (mcap.dev/spec).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import breakup_chunk
from mcap_ros2.decoder import DecoderFactory

from sysid.errors import InputError
from sysid_rl.run.mcap_pieces import MAGIC

#: Bytes of opcode and length before every record.
_HEAD = 9


class LogMessage(NamedTuple):
    """A message: topic, time of recording [ns], and a body with its fields as attributes."""

    topic: str
    log_ns: int
    body: Any


class Tail:
    """The reader of one file.

    Args:
        topics: of the messages to read.

    Raises:
        InputError: it is no MCAP file.
    """

    def __init__(self, path: Path, topics: frozenset[str]) -> None:
        self.path, self._topics, self._at = path, topics, len(MAGIC)
        #: Whether the end of the file was read.
        self.finished = False
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._decoders: dict[int, Callable[[bytes], Any]] = {}
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise InputError(str(path), "no MCAP file", "a flight log of the runner")

    def new(self) -> list[LogMessage]:
        """Messages since the last call; the file is finished if it was removed, as the log of a run without a cycle is."""
        try:
            with self.path.open("rb") as file:
                file.seek(self._at)
                data = file.read()
        except FileNotFoundError:
            self.finished = True
            return []
        found: list[LogMessage] = []
        at = 0
        while len(data) - at >= _HEAD and not self.finished:
            end = at + _HEAD + int.from_bytes(data[at + 1 : at + _HEAD], "little")
            if end > len(data):
                break
            for record in _records(data[at], data[at + _HEAD : end]):
                found += self._take(record)
            self.finished = data[at] == Opcode.DATA_END
            at = end
        self._at += at
        return found

    def _take(self, record: McapRecord) -> Iterator[LogMessage]:
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self._channels[record.id] = record
        elif isinstance(record, Message) and (channel := self._channels[record.channel_id]).topic in self._topics:
            if channel.id not in self._decoders:
                decoder = DecoderFactory().decoder_for(channel.message_encoding, self._schemas[channel.schema_id])
                assert decoder is not None
                self._decoders[channel.id] = decoder
            yield LogMessage(channel.topic, record.log_time, self._decoders[channel.id](record.data))


def _records(opcode: int, body: bytes) -> list[McapRecord]:
    stream = ReadDataStream(BytesIO(body))
    if opcode == Opcode.SCHEMA:
        return [Schema.read(stream)]
    if opcode == Opcode.CHANNEL:
        return [Channel.read(stream)]
    if opcode == Opcode.CHUNK:
        return breakup_chunk(Chunk.read(stream), validate_crc=True)
    return []
