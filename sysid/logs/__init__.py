"""Log files → streams: one reader a format, every stream with its own stamps."""

from sysid.logs.reader import LogReader, ReadOptions
from sysid.logs.readers import READERS, reader_for, reader_named
from sysid.logs.stream import Stream

__all__ = ["READERS", "LogReader", "ReadOptions", "Stream", "reader_for", "reader_named"]
