"""MCAP files: topics → streams with the clocks ``header``, ``log`` and ``publish``. ROS 2 (CDR), JSON and protobuf messages."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sysid.errors import InputError
from sysid.logs.layout import Bytes
from sysid.logs.limits import Budget
from sysid.logs.mcap_file import CHANNEL, HEAD, MESSAGE_HEAD, RECORD, SCHEMA, STATISTICS, McapBlock, McapFile
from sysid.logs.reader import ReadOptions
from sysid.logs.stream import Stream
from sysid.logs.topics import Topic, check_held, finished, make_decoder

_COUNT = np.dtype([("channel", "<u2"), ("messages", "<u8")])


@dataclass(frozen=True)
class McapReader:
    """The default clock is ``header`` (time of measurement), for messages with ``header.stamp`` or ``stamp``."""

    name: str = "mcap"
    suffixes: tuple[str, ...] = (".mcap",)
    clocks: tuple[str, ...] = ("header", "log", "publish")

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
        """Parse a schema or channel record that is not yet known, or the statistics."""
        reader = _Fields(body)
        if opcode == STATISTICS:
            self._expect(body)
            return
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

    def _expect(self, body: bytes) -> None:
        """Channel numbers and message counts, from byte 46 on, limited to what fits into the file."""
        counts = np.frombuffer(body[46 : len(body) - (len(body) - 46) % 10], _COUNT) if len(body) > 46 else ()
        most = self.path.stat().st_size // (RECORD + MESSAGE_HEAD)
        for number, count in counts:
            if int(number) in self.channels:
                self.channels[int(number)].expect(min(int(count), most))

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
