"""A log is read in a process of its own (:mod:`sysid.confined`), with the memory and processor time of its budget."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from sysid.confined import confined
from sysid.logs.reader import LogReader, ReadOptions
from sysid.logs.stream import Stream


def read_confined(reader: LogReader, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
    """``reader.read(path, options)`` in a process of its own.

    Raises:
        InputError: as of the reader; it took more than its budget, or crashed.
    """
    limits = options.budget_of(path, "a log file", None).limits
    return confined(
        lambda report: reader.read(path, replace(options, progress=report)), path, limits, (Stream,), options.progress
    )
