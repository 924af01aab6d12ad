"""ROS bags other than MCAP: ROS 1 ``.bag`` and rosbag2 in sqlite, ``.db3``. Clocks: ``header`` (when measured) and ``log``.

The ``rosbags`` library reads the containers; the messages are decoded as those of MCAP files. Of an sqlite file of unknown
origin all that belongs to it is read, nothing of it is changed, and nothing in it is computed.
"""

from __future__ import annotations

import bz2
import contextlib
import os
import re
import shutil
import struct
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from sysid import scratch
from sysid.errors import InputError, StorageError
from sysid.logs.limits import FREE, MAX_RATIO, Budget, check_file, unpack
from sysid.logs.reader import LogReader, ReadOptions, Stream
from sysid.logs.topics import Topic, check_held, check_topics, finished, make_decoder

#: Tables of an sqlite file that the library reads.
_TABLES = ("topics", "messages", "schema", "message_definitions", "metadata")


def side_files(path: Path) -> tuple[Path, ...]:
    """The write-ahead log beside an sqlite bag, which is a part of it; none beside other logs."""
    log = Path(f"{path.resolve()}-wal")
    return (log,) if log.exists() and log.stat().st_size else ()


@contextlib.contextmanager
def whole_database(path: Path, budget: Budget) -> Iterator[Path]:
    """An sqlite file that holds all messages: ``path``, or a private copy into which its write-ahead log has been moved.

    sqlite merges the log only into a file that it may write, and a file of the user is not changed. The copy can be deleted
    once it is open.

    Raises:
        InputError: a transaction was interrupted, or the log is no file.
        StorageError: the copy has no room.
    """
    import apsw

    _check_journal(path)
    logs = side_files(path)
    if not logs:
        yield path
        return
    for log in logs:
        if log.is_symlink():
            raise InputError(log, "a link", "the write-ahead log of an sqlite file", "Copy the file beside the bag.")
        check_file(log, "the write-ahead log of an sqlite file")
    own = scratch.current()
    with tempfile.TemporaryDirectory(prefix=".bag-", dir=None if own is None else own.folder) as folder:
        copy = Path(folder) / "bag.db3"
        try:
            shutil.copyfile(path, copy)
            for log in logs:
                shutil.copyfile(log, f"{copy}-wal")
            with limited_rows(budget), contextlib.closing(apsw.Connection(str(copy), apsw.SQLITE_OPEN_READWRITE)) as database:
                database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        except apsw.Error as error:
            raise InputError(path, f"not readable as rosbag2 ({short(error)})", "an sqlite file that rosbag2 wrote") from None
        except PermissionError:
            raise
        except OSError as error:
            found = f"no room for a copy of {path.name} with its write-ahead log ({os.strerror(error.errno or 0)})"
            remedy = f'Merge it in its place: sqlite3 {path.name} "PRAGMA wal_checkpoint(TRUNCATE)".'
            raise StorageError(folder, found, f"{path.stat().st_size / 2**20:.0f} MiB", remedy) from None
        yield copy


#: First bytes of the journal of a transaction that can be undone.
_JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")


def _check_journal(path: Path) -> None:
    """Raise where a transaction of an sqlite file was interrupted: its pages are partly those of before, partly those of after.

    Source: SQLite, "Database File Format", 3. The journal may name other files, which sqlite deletes, so it is not rolled back.
    """
    journal = Path(f"{path.resolve()}-journal")
    if not journal.is_file():
        return
    with journal.open("rb") as file:
        if file.read(len(_JOURNAL_MAGIC)) != _JOURNAL_MAGIC:
            return
    remedy = f'Undo it with sqlite, best in a copy of both files: sqlite3 {path.name} "PRAGMA integrity_check".'
    raise InputError(path, f"a transaction that was interrupted ({journal.name})", "a complete sqlite file", remedy)


def check_pages(path: Path, database: Path) -> None:
    """Raise where an sqlite file is shorter than it states: missing pages would be read as zeros.

    Source: SQLite, "Database File Format", 1.3.8 (the size is valid where the counter behind it agrees).
    """
    with database.open("rb") as file:
        head = file.read(100)
    if len(head) < 100 or not head.startswith(b"SQLite format 3\0"):
        return  # reported when it is opened
    page, pages = int.from_bytes(head[16:18], "big"), int.from_bytes(head[28:32], "big")
    size, there = (65536 if page == 1 else page) * pages, database.stat().st_size
    if head[24:28] == head[92:96] and size > there:
        remedy = f"Save what is left: sqlite3 {path.name} .recover | sqlite3 recovered.db3"
        raise InputError(path, f"the file is cut off: {there} of {size} bytes", "a whole sqlite file", remedy)


@contextlib.contextmanager
def limited_rows(budget: Budget) -> Iterator[None]:
    """Limits values of databases that are opened within the context to the size of a chunk."""
    import apsw

    def limit(database: apsw.Connection) -> None:
        database.limit(apsw.SQLITE_LIMIT_LENGTH, budget.chunk)

    apsw.connection_hooks.append(limit)
    try:
        yield
    finally:
        apsw.connection_hooks.remove(limit)


def check_tables(path: Path, file: Path) -> None:
    """Raise where the tables of a bag are computed when they are read: views, virtual tables, generated columns.

    Raises:
        InputError: a table that is not stored.
        apsw.Error: no sqlite file.
    """
    import apsw

    database = apsw.Connection(f"file:{quote(str(file))}?immutable=1", apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI)
    with contextlib.closing(database):
        for name in _TABLES:
            kinds = [
                kind for (kind,) in database.execute("SELECT type FROM pragma_table_list WHERE name = ? COLLATE NOCASE", [name])
            ]
            hidden = [row[1] for row in database.execute("SELECT * FROM pragma_table_xinfo(?)", [name]) if row[6]]
            found = "" if set(kinds) <= {"table"} else f"a {kinds[0]}" if kinds != ["virtual"] else "a virtual table"
            found = found or (f"a generated column {hidden[0]!r}" if hidden else "")
            if found:
                where = f"{path}: table {name!r}"
                raise InputError(where, found, "rows that rosbag2 has stored", "The file is damaged or malicious.")


def short(error: Exception) -> str:
    """The first line of an error of a library."""
    return (str(error).splitlines() or [""])[0][:160] or type(error).__name__


_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
#: Size of a batch of messages of a topic, and of all batches together [bytes].
_BATCH, _HELD = 4 * 2**20, 32 * 2**20


class Ros1Reader(LogReader):
    """ROS 1 bags of format 2.0."""

    name = "rosbag1"
    suffixes = (".bag",)
    clocks = ("header", "log")

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


class Rosbag2Reader(LogReader):
    """rosbag2 in sqlite (``.db3``), each file by itself: ``metadata.yaml`` is not needed.

    Messages that a recorder had not yet moved from its write-ahead log (``.db3-wal``) into the file are read from there.
    """

    name = "rosbag2"
    suffixes = (".db3", ".zstd")
    clocks = ("header", "log")

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
