"""The list of log formats. A new format is one more entry here; nothing is found by import magic."""

from __future__ import annotations

from pathlib import Path

from sysid.errors import InputError, SettingsError, nearest
from sysid.logs.csv import CsvReader
from sysid.logs.mat import MatReader
from sysid.logs.mcap import McapReader
from sysid.logs.motive import MotiveReader
from sysid.logs.parquet import ParquetReader
from sysid.logs.reader import LogReader
from sysid.logs.rosbag import Ros1Reader, Rosbag2Reader

READERS: tuple[LogReader, ...] = (
    McapReader(),
    Ros1Reader(),
    Rosbag2Reader(),
    CsvReader(),
    MotiveReader(),
    ParquetReader(),
    MatReader(),
)


def reader_named(name: str, where: object) -> LogReader:
    """The reader called ``name``; raises :class:`SettingsError` for an unknown one."""
    for reader in READERS:
        if reader.name == name:
            return reader
    raise SettingsError(where, f"unknown reader {name!r}", nearest(name, [reader.name for reader in READERS]))


def reader_for(path: Path) -> LogReader:
    """The first reader that takes the suffix of ``path``; raises :class:`InputError` where none does."""
    for reader in READERS:
        if path.suffix.lower() in reader.suffixes:
            return reader
    suffixes = sorted({suffix for reader in READERS for suffix in reader.suffixes})
    raise InputError(path, f"no reader for {path.suffix or 'a file without suffix'!r}", f"one of {', '.join(suffixes)}")


def is_log(path: Path) -> bool:
    """Whether some reader takes the suffix of ``path``."""
    return path.is_file() and any(path.suffix.lower() in reader.suffixes for reader in READERS)
