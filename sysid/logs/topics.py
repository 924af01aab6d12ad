"""Shared by the readers of bags (MCAP, rosbag2, ROS 1): messages of a topic → a stream with its clocks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError, nearest
from sysid.logs.layout import Bytes
from sysid.logs.limits import Budget
from sysid.logs.messages import ColumnDecoder, RowDecoder, parse_json, protobuf_parser
from sysid.logs.reader import ReadOptions, Stream
from sysid.logs.rosmsg import parse_definition, parse_idl
from sysid.logs.topic_columns import GrowingArray, TopicColumns

#: Number of messages of each topic of which ``preview`` reads the values; of later ones it reads only the stamps.
PREVIEW = 20_000
_MAX_SCHEMA = 2**20


class Decoder(Protocol):
    """Messages of one topic → columns."""

    @property
    def columns(self) -> TopicColumns: ...

    @property
    def reason(self) -> str:
        """Why the first unreadable message cannot be read."""
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
    text = schema.decode("utf-8", errors="replace")
    match message_encoding, schema_encoding:
        case "ros1", "ros1msg":
            definition = parse_definition(kind, text, where, ros1=True)
            return ColumnDecoder(definition, wanted, preview, packed=True, cells=cells)
        case "cdr", "ros2msg":
            return ColumnDecoder(parse_definition(kind, text, where), wanted, preview, cells=cells)
        case "cdr", "ros2idl" | "omgidl":
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
        """Number of stamps and values kept."""
        return self.log.found + self.publish.found + self.decoder.columns.held

    def stream(self, path: Path, losses: Iterable[str]) -> Stream:
        """The stream. Clocks: ``header`` where a stamp is set in the messages, ``log``, ``publish`` where the file has it."""
        found = self.decoder.columns
        stamps: dict[str, npt.NDArray[np.int64]] = {}
        header = found.header_stamps()
        if header is not None:
            stamps["header"] = header
        stamps["log"] = self.log.whole(found.total)
        if self.publish.found:
            stamps["publish"] = self.publish.whole(found.total)
        columns = found.release()
        losses = [*losses, *(f"{path.name}: {self.name}: {loss}" for loss in found.labels.losses)]
        if found.bad:
            readable = found.readable()
            stamps = {clock: values[readable] for clock, values in stamps.items()}
            for name in columns:  # one at a time, because two copies of the table may not fit into memory
                columns[name] = columns[name][readable[: len(columns[name])]]
            count = len(found.bad)
            losses.append(
                f"{path.name}: {self.name}: {count} messages do not follow their schema (the first: {self.decoder.reason})"
            )
        unset = _unset(stamps["header"]) if "header" in stamps else ""
        if unset:
            del stamps["header"]
            losses.append(f"{path.name}: {self.name}: header.stamp is {unset}: they have no clock 'header'")
        if found.crowded:
            losses.append(f"{path.name}: {self.name}: has too many fields to read them all; {len(columns)} have been read")
        return Stream(self.name, path, stamps, columns, {}, tuple(losses), tuple(found.fields), self.kind)


def _unset(stamps: npt.NDArray[np.int64]) -> str:
    """Why the header stamps of a topic are no clock: a publisher does not set them, or not yet; empty where they are one.

    A stamp of zero is not set where the others begin later than they last: a simulation or a boot may begin at zero.
    """
    if len(stamps) and (stamps == stamps[0]).all() and (len(stamps) > 1 or not stamps[0]):
        return f"{stamps[0] * 1e-9:g} in all {len(stamps)} messages"
    others = stamps[stamps != 0]
    if len(others) == len(stamps) or int(others.min()) <= int(others.max()) - int(others.min()):
        return ""
    return f"not set in {len(stamps) - len(others)} of {len(stamps)} messages"


def check_held(path: Path, topics: Iterable[Topic], budget: Budget) -> None:
    """Raise where more values are kept than the budget allows."""
    for topic in topics:
        budget.check_rows(f"{path}: {topic.name}", topic.decoder.columns.total)
    budget.check_numbers(path, sum(topic.held for topic in topics))


def finished(
    topics: Iterable[Topic], known: Iterable[str], options: ReadOptions, path: Path, losses: list[str]
) -> tuple[Stream, ...]:
    """The streams of a bag; the losses of topics without a readable message go to the others.

    Raises:
        InputError: a wanted topic is missing or unreadable, a wanted field is not the same thing in every message, or no
            message could be read.
    """
    check_topics(options, known, path, losses)
    topics = list(topics)
    for topic in topics:
        for wanted in sorted((options.fields or {}).get(topic.name, ())):
            topic.decoder.columns.labels.check(wanted, topic.decoder.columns.fields, f"{path}: {topic.name}")
    streams = tuple(topic.stream(path, losses) for topic in topics if topic.decoder.columns.total)
    readable = tuple(stream for stream in streams if len(stream))
    unreadable = tuple(dict.fromkeys(loss for stream in streams if not len(stream) for loss in stream.losses))
    named = [stream.name for stream in streams if not len(stream) and stream.name in (options.streams or ())]
    if options.part and not unreadable:
        return readable
    if not readable or named:
        where = f"{path}: {named[0]}" if named and readable else path
        lost = [*unreadable, *losses]
        raise InputError(where, lost[0] if lost else "no messages", "at least one readable message", "Record the log again.")
    return tuple(replace(stream, losses=tuple(dict.fromkeys((*stream.losses, *unreadable)))) for stream in readable)


def check_topics(options: ReadOptions, known: Iterable[str], path: Path, losses: Iterable[str] = ()) -> None:
    """Raise where a wanted topic is not among the known ones; the error names the first loss."""
    names = set(known)
    for topic in sorted(options.streams or ()):
        if topic not in names and not options.part:
            lost = next((f" ({loss})" for loss in losses), "")
            raise InputError(path, f"no topic {topic!r}{lost}", nearest(topic, names), "Correct `topic` in the recipe.")
