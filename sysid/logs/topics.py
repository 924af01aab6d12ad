"""Topics of a bag: what MCAP, rosbag2 and ROS 1 readers share. Messages of a topic → a stream with its clocks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError, nearest
from sysid.logs.cdr import ColumnDecoder
from sysid.logs.growing import GrowingArray
from sysid.logs.layout import Bytes
from sysid.logs.limits import Budget
from sysid.logs.pieces import Pieces
from sysid.logs.reader import ReadOptions
from sysid.logs.rosmsg import parse_definition, parse_idl
from sysid.logs.rows import RowDecoder, parse_json, protobuf_parser
from sysid.logs.stream import Stream

#: With ``preview`` the values of so many messages a topic are read, and only the stamps of those after them.
PREVIEW = 20_000
_MAX_SCHEMA = 2**20


class Decoder(Protocol):
    """Messages of one topic → columns."""

    @property
    def pieces(self) -> Pieces: ...

    @property
    def reason(self) -> str:
        """Why the first unreadable message is so."""
        ...

    def add(self, buffer: Bytes, starts: npt.NDArray[np.int64], sizes: npt.NDArray[np.int64]) -> None: ...


def make_decoder(
    topic: str,
    kind: str,
    message_encoding: str,
    schema_encoding: str,
    schema: bytes,
    options: ReadOptions,
    where: str,
    budget: Budget,
) -> Decoder:
    """A decoder for messages of type ``kind``.

    Raises:
        InputError: an encoding that is not supported, or a schema that is too long or cannot be read.
    """
    if len(schema) > _MAX_SCHEMA:
        expected = f"at most {_MAX_SCHEMA // 2**20} MiB"
        raise InputError(where, f"a schema of {len(schema) / 2**20:.0f} MiB", expected, "The file is damaged.")
    cells = budget.numbers
    wanted = None if options.fields is None else frozenset(options.fields.get(topic, ()))
    preview = PREVIEW if options.preview else None
    match message_encoding, schema_encoding:
        case "ros1", "ros1msg":
            text = schema.decode("utf-8", errors="replace")
            return ColumnDecoder(parse_definition(kind, text, where), wanted, preview, packed=True, cells=cells)
        case "cdr", "ros2msg":
            text = schema.decode("utf-8", errors="replace")
            return ColumnDecoder(parse_definition(kind, text, where), wanted, preview, cells=cells)
        case "cdr", "ros2idl" | "omgidl":
            text = schema.decode("utf-8", errors="replace")
            return ColumnDecoder(parse_idl(kind, text, where), wanted, preview, cells=cells)
        case "json", "jsonschema" | "":
            return RowDecoder(parse_json, wanted, preview, cells)
        case "protobuf", "protobuf":
            return RowDecoder(protobuf_parser(kind, schema, where), wanted, preview, cells)
    raise InputError(
        where,
        f"messages in {message_encoding!r} with a schema in {schema_encoding!r}",
        "'cdr' with 'ros2msg' or 'ros2idl' (ROS 2), 'ros1' with 'ros1msg', 'json', or 'protobuf'",
    )


@dataclass
class Topic:
    """One topic while it is read."""

    name: str
    kind: str
    decoder: Decoder
    log: GrowingArray = field(default_factory=lambda: GrowingArray(0, np.dtype(np.int64)))
    publish: GrowingArray = field(default_factory=lambda: GrowingArray(0, np.dtype(np.int64)))

    @property
    def held(self) -> int:
        """Stamps and values that have been kept."""
        return self.log.found + self.publish.found + self.decoder.pieces.held

    def expect(self, count: int) -> None:
        """The file says that it has so many more messages of this topic."""
        pieces = self.decoder.pieces
        pieces.stated += count
        self.log.expected = self.publish.expected = pieces.stated

    def stream(self, path: Path, losses: Iterable[str]) -> Stream:
        """What was read. Clocks: ``header`` where the messages carry a stamp, ``log``, ``publish`` where the file has it."""
        pieces = self.decoder.pieces
        stamps: dict[str, npt.NDArray[np.int64]] = {}
        header = pieces.header_stamps()
        if header is not None:
            stamps["header"] = header
        stamps["log"] = self.log.whole(pieces.total)
        if self.publish.found:
            stamps["publish"] = self.publish.whole(pieces.total)
        columns = pieces.columns()
        losses = list(losses)
        if pieces.bad:
            readable = pieces.readable()
            stamps = {clock: values[readable] for clock, values in stamps.items()}
            for name in columns:  # one at a time: twice the table may be more than there is room for
                columns[name] = columns[name][readable[: len(columns[name])]]
            count = len(pieces.bad)
            losses.append(
                f"{path.name}: {self.name}: {count} messages do not follow their schema (the first: {self.decoder.reason})"
            )
        if pieces.crowded:
            losses.append(f"{path.name}: {self.name}: has too many fields to read them all; {len(columns)} have been read")
        return Stream(self.name, path, stamps, columns, {}, tuple(losses), tuple(pieces.fields), self.kind)


def check_held(path: Path, topics: Iterable[Topic], budget: Budget) -> None:
    """Raise where messages have given more numbers than may be kept."""
    for topic in topics:
        budget.check_rows(f"{path}: {topic.name}", topic.decoder.pieces.total)
    budget.check_numbers(path, sum(topic.held for topic in topics))


def finished(
    topics: Iterable[Topic], known: Iterable[str], options: ReadOptions, path: Path, losses: list[str]
) -> tuple[Stream, ...]:
    """The streams of a bag that has been read; what a topic without a single readable message lost stands with the others.

    Raises:
        InputError: a wanted topic is not there, or no message of it, or of any, could be read.
    """
    check_topics(options, known, path, losses)
    streams = tuple(topic.stream(path, losses) for topic in topics if topic.decoder.pieces.total)
    readable = tuple(stream for stream in streams if len(stream))
    unreadable = tuple(dict.fromkeys(loss for stream in streams if not len(stream) for loss in stream.losses))
    named = [stream.name for stream in streams if not len(stream) and stream.name in (options.streams or ())]
    if not readable or named:
        where = f"{path}: {named[0]}" if named and readable else path
        lost = [*unreadable, *losses]
        raise InputError(where, lost[0] if lost else "no messages", "at least one readable message", "Record the log again.")
    return tuple(replace(stream, losses=tuple(dict.fromkeys((*stream.losses, *unreadable)))) for stream in readable)


def check_topics(options: ReadOptions, known: Iterable[str], path: Path, losses: Iterable[str] = ()) -> None:
    """Raise where a wanted topic is not among the known ones."""
    names = set(known)
    for topic in sorted(options.streams or ()):
        if topic not in names:
            lost = next((f" ({loss})" for loss in losses), "")
            raise InputError(path, f"no topic {topic!r}{lost}", nearest(topic, names), "Correct `topic` in the recipe.")
