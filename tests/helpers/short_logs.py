"""The shipped logs cut to their first seconds, so that the whole line can be tested on them in little time."""

from __future__ import annotations

import shutil
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import Writer


def shortened(source: Path, target: Path, seconds: dict[str, float]) -> Path:
    """A copy of a dataset folder with these recordings only, each cut to its first seconds.

    Args:
        seconds: recording → how much of its two files is kept [s].
    """
    target.mkdir(parents=True)
    for path in source.glob("*.*"):
        shutil.copyfile(path, target / path.name)
    for recording, length in seconds.items():
        folder = target / "logs" / recording
        folder.mkdir(parents=True)
        cut_mcap(source / "logs" / recording / "machine.mcap", folder / "machine.mcap", length)
        cut_motive(source / "logs" / recording / "mocap.csv", folder / "mocap.csv", length)
    return target


def cut_mcap(source: Path, target: Path, seconds: float) -> None:
    """The messages that were logged in the first seconds, byte for byte."""
    with source.open("rb") as read, target.open("wb") as write:
        reader, writer = make_reader(read), Writer(write)
        header = reader.get_header()
        writer.start(profile=header.profile, library=header.library)
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        begin: int | None = None
        for schema, channel, message in reader.iter_messages():
            begin = message.log_time if begin is None else begin
            if message.log_time - begin > seconds * 1e9:
                break
            assert schema is not None
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id], channel.metadata
                )
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence)
        writer.finish()


def cut_motive(source: Path, target: Path, seconds: float) -> None:
    """The header and the frames of the first seconds."""
    with source.open(encoding="utf-8-sig") as read, target.open("w", encoding="utf-8") as write:
        for line in read:
            frame, _, rest = line.partition(",")
            if frame.isdigit() and float(rest.partition(",")[0]) > seconds:
                break
            write.write(line)
