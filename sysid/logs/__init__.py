"""Log files → streams: one reader a format, every stream with its own stamps."""

from sysid.logs.reader import LogReader, ReadOptions, Stream
from sysid.logs.readers import READERS, reader_for, reader_named

__all__ = ["READERS", "LogReader", "ReadOptions", "Stream", "reader_for", "reader_named"]
