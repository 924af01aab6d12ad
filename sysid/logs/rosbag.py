"""ROS bags other than MCAP: ROS 1 ``.bag`` and rosbag2 in sqlite, ``.db3``. Clocks: ``header`` (when measured) and ``log``.

The ``rosbags`` library reads the containers; the messages are decoded as those of MCAP files.
"""

from __future__ import annotations

import bz2
import re
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import InputError
from sysid.logs.limits import FREE, MAX_RATIO, Budget, unpack
from sysid.logs.reader import ReadOptions
from sysid.logs.sqlite_bag import check_pages, check_tables, limited_rows, short, whole_database
from sysid.logs.stream import Stream
from sysid.logs.topics import Topic, check_held, check_topics, finished, make_decoder

_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
#: Size of a batch of messages of a topic, and of all batches together [bytes].
_BATCH, _HELD = 4 * 2**20, 32 * 2**20


@dataclass(frozen=True)
class Ros1Reader:
    """ROS 1 bags of format 2.0."""

    name: str = "rosbag1"
    suffixes: tuple[str, ...] = (".bag",)
    clocks: tuple[str, ...] = ("header", "log")

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
        from rosbags.rosbag1 import Reader, ReaderError
        from rosbags.rosbag1.reader import decompressors

        budget = options.budget_of(path, "a ROS 1 bag", None)
        with path.open("rb") as file:
            magic = file.readline(64)
        if not magic.startswith(b"#ROSBAG V2.0"):
            found = f"starts with {magic[:13]!r}"
            raise InputError(path, found, "'#ROSBAG V2.0'", "Older bags: convert them with `rosbag fix`.")
        bag = _Bag(path, options, budget, "ros1", "ros1msg")
        reader = Reader(path)
        # Any of these means a damaged bag: the library uses assertions, and allocates the length that a word states (up to
        # 4 GiB) before it checks whether the file has as many bytes.
        damage = (
            ReaderError, AssertionError, struct.error, ValueError, KeyError, IndexError, OverflowError, EOFError, OSError,
            MemoryError,
        )  # fmt: skip
        try:
            reader.open()
        except damage as error:
            remedy = "Run `rosbag reindex` on it." if "index" in str(error).lower() else "Record the log again."
            raise InputError(path, f"not readable as a ROS 1 bag ({short(error)})", "a whole bag", remedy) from None
        try:
            unpackers = {decompressors["bz2"]: bz2.BZ2Decompressor, decompressors["lz4"]: LZ4FrameDecompressor}
            for position, chunk in reader.chunks.items():
                if chunk.decompressor in unpackers:
                    reader.chunks[position] = chunk._replace(decompressor=_limited(unpackers[chunk.decompressor], budget))
            connections = bag.define(reader.connections, lambda connection: connection.msgdef.data)
            bag.take((c, stamp, data) for c, stamp, data in reader.messages(connections) if connections)
        except damage as error:
            bag.lose(f"damaged ({short(error)}); the part before it has been read")
        finally:
            reader.close()
        return bag.streams()


@dataclass(frozen=True)
class Rosbag2Reader:
    """rosbag2 in sqlite (``.db3``), each file by itself: ``metadata.yaml`` is not needed.

    Messages that a recorder had not yet moved from its write-ahead log (``.db3-wal``) into the file are read from there.
    """

    name: str = "rosbag2"
    suffixes: tuple[str, ...] = (".db3", ".zstd")
    clocks: tuple[str, ...] = ("header", "log")

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        import apsw
        from rosbags.rosbag2 import Reader, ReaderError

        budget = options.budget_of(path, "a rosbag2 file", None)
        if path.suffix.lower() == ".zstd":
            raise InputError(path, "a file compressed as a whole", "the file itself", f"Unpack it: `zstd -d {path.name}`.")
        bag = _Bag(path, options, budget, "cdr", "ros2msg")
        damage = (ReaderError, apsw.Error, ValueError, KeyError, TypeError, AttributeError, RecursionError)
        with whole_database(path, budget) as database:
            check_pages(path, database)
            try:
                reader = Reader(database)
                with limited_rows(budget):
                    check_tables(path, database)
                    reader.open()
            except damage as error:
                reason = short(error).replace(str(database), path.name)
                raise InputError(path, f"not readable as rosbag2 ({reason})", "an sqlite file that rosbag2 wrote") from None
        try:
            connections = bag.define(reader.connections, _ros2_definition)
            bag.take(_stored(reader.messages(connections), bag) if connections else ())
        except damage as error:
            bag.lose(f"damaged ({short(error)}); the part before it has been read")
        finally:
            reader.close()
        return bag.streams()


@dataclass
class _Bag:
    """State of reading one bag."""

    path: Path
    options: ReadOptions
    budget: Budget
    encoding: str
    schema_encoding: str
    losses: list[str] = field(default_factory=list)
    topics: dict[tuple[str, str], Topic] = field(default_factory=dict)
    names: list[str] = field(default_factory=list)

    def lose(self, text: str) -> None:
        self.losses.append(f"{self.path.name}: {text}")

    def define(self, connections: Iterable[Any], definition: Any) -> list[Any]:
        """Decoders for the wanted topics; returns the connections that can be read."""
        readable = []
        connections = list(connections)
        self.names = [connection.topic for connection in connections]
        check_topics(self.options, self.names, self.path)
        for connection in connections:
            topic, kind = connection.topic, connection.msgtype
            if not self.options.wants(topic):
                continue
            where = f"{self.path}: {topic}"
            self.budget.check_topics(self.path, len(self.topics) + 1)
            try:
                if (topic, kind) not in self.topics:
                    text = definition(connection)
                    encoding = self.schema_encoding
                    if text.lstrip("=\n ").startswith("IDL:"):
                        encoding = "ros2idl"
                    if not text:
                        expected = "a definition in the file, or a message type of ROS 2 itself"
                        raise InputError(where, f"messages of type {kind!r} without definition", expected)
                    decoder = make_decoder(
                        topic, kind, self.encoding, encoding, text.encode(), self.options, where, self.budget
                    )
                    self.topics[topic, kind] = Topic(topic, kind, decoder)
            except InputError as error:
                if self.options.streams is not None:
                    raise
                self.losses.append(str(error))
                continue
            readable.append(connection)
        return readable

    def take(self, messages: Iterable[tuple[Any, int, bytes]]) -> None:
        """Pass messages to their topics in batches, including those before an error."""
        batches: dict[tuple[str, str], _Batch] = {}
        held = 0
        try:
            for connection, stamp, data in messages:
                key = (connection.topic, connection.msgtype)
                batch = batches.setdefault(key, _Batch(self.topics[key]))
                held += batch.add(stamp, data)
                if held > _HELD:
                    for batch in batches.values():
                        batch.flush()
                    held = 0
                    check_held(self.path, self.topics.values(), self.budget)
        finally:
            for batch in batches.values():
                batch.flush()

    def streams(self) -> tuple[Stream, ...]:
        return finished(self.topics.values(), self.names, self.options, self.path, self.losses)


@dataclass
class _Batch:
    topic: Topic
    stamps: list[int] = field(default_factory=list)
    messages: list[bytes] = field(default_factory=list)
    size: int = 0

    def add(self, stamp: int, data: bytes) -> int:
        """Add a message; returns the increase of the memory held [bytes]."""
        before = self.size
        self.stamps.append(stamp)
        self.messages.append(data)
        self.size += len(data) + 64
        if self.size > _BATCH:
            self.flush()
        return self.size - before

    def flush(self) -> None:
        if not self.messages:
            return
        sizes = np.array([len(message) for message in self.messages], dtype=np.int64)
        starts = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
        self.topic.log.extend(np.array(self.stamps, dtype=np.int64))
        self.topic.decoder.add(np.frombuffer(b"".join(self.messages), np.uint8), starts, sizes)
        self.stamps, self.messages, self.size = [], [], 0


def _limited(maker: Any, budget: Budget) -> Any:
    """A decompressor that stops at the limit of a chunk."""

    total = 0

    def decompress(packed: bytes) -> bytes:
        nonlocal total
        most = min(budget.chunk, max(FREE, MAX_RATIO * len(packed)))
        try:
            data: bytes = maker().decompress(packed, max_length=most + 1)
        except RuntimeError as error:  # what the lz4 library raises for damage
            raise ValueError(str(error)) from None
        if len(data) > most:
            raise ValueError(f"a chunk unpacks to more than {most / 2**20:.0f} MiB")
        total += len(data)
        if total > budget.unpacked:
            raise ValueError(f"chunks that unpack to more than {budget.unpacked / 2**20:.0f} MiB")
        return data

    return decompress


#: Largest metadata of a bag [B].
_MAX_METADATA = 2**20


def bag_of(path: Path) -> Path | None:
    """The bag of rosbag2, a folder, of which a file is a part by its ``metadata.yaml``; None where the file is by itself."""
    metadata = path.parent / "metadata.yaml"
    if not metadata.is_file() or metadata.stat().st_size > _MAX_METADATA:
        return None
    text = metadata.read_text("utf-8", errors="replace")
    listed = re.search(rf"(^|[\s/'\",\[-]){re.escape(path.name)}($|[\s'\",\]])", text)
    return path.parent if "rosbag2_bagfile_information" in text and listed else None


def _stored(rows: Iterable[tuple[Any, Any, Any]], bag: _Bag) -> Iterator[tuple[Any, int, bytes]]:
    """Stored messages; rows whose cells have another type (sqlite takes any) are dropped and counted."""
    others = 0
    for connection, stamp, data in rows:
        if isinstance(stamp, int) and isinstance(data, bytes):
            yield connection, stamp, _unpacked(data, bag.budget)
        else:
            others += 1
    if others:
        bag.lose(f"{others} rows without a stamp and a message have been left out")


def _unpacked(data: bytes, budget: Budget) -> bytes:
    """A message, unpacked where the bag compresses messages one by one (CDR never starts with these bytes)."""
    if not data.startswith(_ZSTD_MAGIC):
        return data
    import zstandard

    return unpack(data, "zstd", zstandard.frame_content_size(data), budget)


def _ros2_definition(connection: Any) -> str:
    """The definition in the file; for older files without one, that of the types of ROS 2 itself."""
    from rosbags.typesys import Stores, get_typestore

    if connection.msgdef.data:
        return str(connection.msgdef.data)
    store = get_typestore(Stores.LATEST)
    if connection.msgtype not in store.fielddefs:
        return ""
    return str(store.generate_msgdef(connection.msgtype, ros_version=2)[0])
