"""An MCAP file that is written durably in pieces: everything synced can be read after a crash of the writer.

Definitions are synced before any message. Messages are buffered until :meth:`PieceWriter.sync` writes them as one chunk with
its checksum and waits for the disk. A file without an end is read like a truncated one.
Source: MCAP specification (mcap.dev/spec).
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Mapping
from pathlib import Path

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from sysid.files import on_disk

MAGIC = b"\x89MCAP0\r\n"


class PieceWriter:
    """One file, new.

    Raises (every method that writes):
        OSError: the disk is full or fails. Everything synced before stays readable.
    """

    def __init__(self, path: Path, profile: str, library: str) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        self._size = 0
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: dict[int, int] = {}
        self._span = (0, 0)
        self._begin()
        self._append(MAGIC + _bytes(Header(profile, library)))
        on_disk(path.parent)

    def _begin(self) -> None:
        self._builder = RecordBuilder()
        self._index: dict[int, MessageIndex] = {}
        self._first = self._last = 0

    def _append(self, data: bytes) -> int:
        """Append ``data`` and return its position; after an error the file has its previous length."""
        start = self._size
        view = memoryview(data)
        try:
            while view:
                view = view[os.write(self._file, view) :]
        except OSError:
            os.ftruncate(self._file, start)
            os.lseek(self._file, start, os.SEEK_SET)
            raise
        self._size += len(data)
        return start

    def channel(self, topic: str, kind: str, definition: str) -> int:
        """A topic of ROS 2 messages; its number."""
        schema = Schema(id=len(self._schemas) + 1, data=definition.encode(), encoding="ros2msg", name=kind)
        number = len(self._channels) + 1
        channel = Channel(number, topic, "cdr", {}, schema.id)
        self._append(_bytes(schema) + _bytes(channel))
        self._schemas.append(schema)
        self._channels.append(channel)
        return number

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write metadata."""
        record = _bytes(Metadata(name=name, metadata=dict(values)))
        self._metadata.append(MetadataIndex(self._append(record), len(record), name))

    def message(self, channel: int, sequence: int, log_ns: int, publish_ns: int, data: bytes) -> None:
        """Buffer a message for the next :meth:`sync`."""
        if channel not in self._index:
            self._index[channel] = MessageIndex(channel, [])
        self._first = min(self._first, log_ns) if self._first else log_ns
        self._last = max(self._last, log_ns)
        self._index[channel].records.append((log_ns, self._builder.count))
        Message(channel, log_ns, data, publish_ns, sequence & 0xFFFFFFFF).write(self._builder)

    def sync(self) -> None:
        """Write the buffered messages, and wait until they are on the disk."""
        if self._index:
            records: bytes = self._builder.end()  # type: ignore[no-untyped-call]
            packed = zstandard.compress(records)
            chunk = Chunk("zstd", packed, self._last, self._first, zlib.crc32(records), len(records))
            body = _bytes(chunk)
            offsets, indices = {}, b""
            for number, index in self._index.items():
                offsets[number] = self._size + len(body) + len(indices)
                indices += _bytes(index)
            place = self._append(body + indices)
            self._chunks.append(
                ChunkIndex(len(body), place, "zstd", len(packed), self._last, len(indices), offsets, self._first, len(records))
            )
            for number, index in self._index.items():
                self._counts[number] = self._counts.get(number, 0) + len(index.records)
            self._span = (min(self._span[0] or self._first, self._first), max(self._span[1], self._last))
            self._begin()
        os.fsync(self._file)

    def finish(self) -> None:
        """Sync, and write the summary and the end."""
        self.sync()
        end = _bytes(DataEnd(0))
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=self._span[1],
            message_start_time=self._span[0],
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        records: list[McapRecord] = [*self._schemas, *self._channels, statistics, *self._chunks, *self._metadata]
        summary = b"".join(_bytes(record) for record in records)
        start = self._size + len(end)
        footer = _bytes(Footer(summary_start=start, summary_offset_start=0, summary_crc=0))
        # The checksum covers the summary and the footer up to itself.
        checksum = zlib.crc32(summary + footer[:-4])
        self._append(end + summary + footer[:-4] + checksum.to_bytes(4, "little") + MAGIC)
        os.fsync(self._file)

    def close(self) -> None:
        os.close(self._file)


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
