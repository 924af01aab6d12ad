"""ULog of PX4 (``.ulg``): every topic is a stream, a further instance of it ``topic#1``, stamped in time since boot.

The library that reads the format is an extra (``flight``). Arrays and nested messages are fields ``q[0]``, ``esc[1].rpm``. Only
numbers are read; parameters, texts and information messages are left out. The format states no units.
Source: PX4 documentation, "ULog File Format".
"""

from __future__ import annotations

import contextlib
import io
import os
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError
from sysid.extras import install_remedy
from sysid.logs.limits import Budget
from sysid.logs.reader import LogReader, ReadOptions, Stream
from sysid.names import listed

MAGIC = b"ULog\x01\x12\x35"
_WHAT = "a ULog of PX4"
_TIME = "timestamp"
#: Names in a sentence; the others are counted.
MOST = 5
#: Reads from one place that come no further: a search in what was read before tries each place once, for head and body.
_AGAIN = 8
#: Largest stamp that 64 bits hold [ns].
LARGEST_NS = 2**63 - 1


class UlogReader(LogReader):
    """``boot`` stamps: the ``timestamp`` of each message, microseconds since the autopilot booted."""

    name = "ulog"
    suffixes = (".ulg",)
    clocks = ("boot",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        budget = options.budget_of(path, _WHAT)
        with path.open("rb") as file:
            head = file.read(16)
        if not head.startswith(MAGIC):
            raise InputError(path, f"starts with {head[:7].hex() or 'nothing'}", f"{MAGIC.hex()} as in a ULog")
        log, losses = _parsed(path, budget)
        topics: dict[str, Any] = {}
        untimed = []
        for data in log.data_list:
            name = f"{data.name}#{data.multi_id}" if data.multi_id else data.name
            if _TIME not in data.data or data.data[_TIME].dtype != np.uint64:
                untimed.append(name)
                continue
            topics[name if name not in topics else f"{name} (message {data.msg_id})"] = data
        if untimed:
            losses = (
                *losses,
                f"{path.name}: topics without a timestamp of 64 bits have been left out: {listed(untimed, MOST)}",
            )
        if not topics:
            raise InputError(path, "no messages", "at least one topic with messages", "Record the flight again.")
        budget.check_topics(path, len(topics))
        options.check_streams(path, topics, "topic", "Correct `topic` in the recipe.")
        chosen = {name: data for name, data in topics.items() if options.wants(name)}
        budget.check_numbers(path, sum(len(data.data[_TIME]) * len(data.field_data) for data in chosen.values()))
        losses = (*losses, *(text for name, data in chosen.items() if (text := _without_time(path, name, data))))
        streams = [_stream(path, name, data, losses, options) for name, data in chosen.items()]
        found = tuple(stream for stream in streams if stream is not None)
        if not found:
            raise InputError(path, "no stamps or no numbers", "topics of numbers with their time", "Record the flight again.")
        return found


class _Watched(io.BufferedReader):
    """A file that remembers how far it was read, and what the last reading asked for and got.

    The library may go back by more than it has read of a message that is cut off, and read the same bytes for ever.

    Raises:
        RuntimeError: at more than :data:`_AGAIN` reads from one place since it was read further than before.
    """

    last = (0, 0)
    end = furthest = 0
    again: Counter[int] | None = None

    def read(self, size: int | None = -1) -> bytes:
        data = super().read(size)
        if (place := self.tell()) > self.furthest:
            self.furthest, self.again = place, None
        else:
            self.again = self.again if self.again is not None else Counter()
            self.again[place - len(data)] += 1
            if self.again[place - len(data)] > _AGAIN:
                raise RuntimeError("the same bytes over and over")
        self.last = (size or 0, len(data))
        return data

    def close(self) -> None:
        if not self.closed:
            self.end = self.tell()
        super().close()


def _parsed(path: Path, budget: Budget) -> tuple[Any, tuple[str, ...]]:
    """The library's log, and the losses."""
    try:
        from pyulog import ULog
    except ImportError:
        raise InputError(
            path, "pyulog is not installed", "the extra that reads flight logs", install_remedy("pyulog")
        ) from None
    file = _Watched(io.FileIO(path))
    try:
        with silent():
            with _Watched(io.FileIO(path)) as head:
                _check_formats(path, ULog(head, parse_header_only=True).message_formats, budget)
            log = ULog(file)
    except InputError:
        raise
    except Exception as error:  # the library raises many unrelated types on a damaged file
        raise InputError(path, f"not readable ({type(error).__name__}: {error})", _WHAT, "The file is damaged.") from None
    finally:
        file.close()
    size = path.stat().st_size
    losses = []
    if file.end < size:
        losses.append(f"{path.name}: unreadable after byte {file.end} of {size}")
    elif file.last != (3, 0):
        losses.append(f"{path.name}: the file is cut off within its last message")
    if log.file_corruption:
        losses.append(f"{path.name}: damaged bytes or messages have been left out")
    if log.dropouts:
        lost = [dropout.duration * 1e-3 for dropout in log.dropouts]
        longest = f"for {sum(lost):.3f} s in all and {max(lost):.3f} s at most"
        losses.append(f"{path.name}: the logger dropped messages {len(lost)} time{'s' if len(lost) > 1 else ''}, {longest}")
    return log, tuple(losses)


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Without the remarks of a library, also of its compiled parts, on the console, where the results are printed."""
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere), contextlib.redirect_stderr(nowhere):
        console = os.dup(2)
        try:
            os.dup2(nowhere.fileno(), 2)
            yield
        finally:
            os.dup2(console, 2)
            os.close(console)


def _check_formats(path: Path, formats: Mapping[str, Any], budget: Budget) -> None:
    """Raise where a message contains itself, or has more fields than the budget: the library unfolds nested messages."""
    counted: dict[str, int] = {}

    def fields(name: str, above: tuple[str, ...]) -> int:
        if name in above or len(above) > budget.depth:
            raise InputError(f"{path}: message {name!r}", "contains itself", "nested messages that end", "The file is damaged.")
        if name not in counted:
            own = formats[name].fields if name in formats else ()
            counted[name] = sum(
                max(count, 1) * (fields(kind, (*above, name)) if kind in formats else 1) for kind, count, _ in own
            )
            budget.check_columns(f"{path}: message {name!r}", counted[name], "fields")
        return counted[name]

    for name in formats:
        fields(name, ())


def _timed(data: Any) -> npt.NDArray[np.bool_]:
    """The messages of a topic with a valid time: the autopilot has none at its boot, zero is no time."""
    micros = data.data[_TIME]
    timed: npt.NDArray[np.bool_] = (micros > 0) & (micros <= LARGEST_NS // 1000)
    return timed


def _without_time(path: Path, name: str, data: Any) -> str:
    lost = int(np.count_nonzero(~_timed(data)))
    return f"{path.name}: {name}: {lost} messages without a valid time have been left out" if lost else ""


def _stream(path: Path, name: str, data: Any, losses: tuple[str, ...], options: ReadOptions) -> Stream | None:
    """The numbers of one topic; None where it has none."""
    micros: npt.NDArray[np.uint64] = data.data[_TIME]
    timed = _timed(data)
    texts = {field.field_name for field in data.field_data if field.type_str == "char"}
    fields = [key for key in data.data if key != _TIME and key not in texts]
    wanted = None if options.fields is None else options.fields.get(name)
    with np.errstate(invalid="ignore"):  # a signalling NaN
        columns = {key: data.data[key][timed].astype(np.float64) for key in fields if wanted is None or key in wanted}
    if not timed.any() or not columns:
        return None
    stamps = micros[timed].astype(np.int64) * 1000
    return Stream(name, path, {"boot": stamps}, columns, {}, losses, tuple(fields))
