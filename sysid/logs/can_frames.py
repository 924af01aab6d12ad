"""CAN log files → frames, grouped by bus and identifier.

Formats: Vector BLF and ASC, PEAK TRC, SocketCAN candump; python-can reads them. Of a BLF file the unpacked sizes of containers
and the sizes of objects are checked first: a file is a header and objects; those of type 10 are containers that hold the logged
objects, zlib-packed, one after the other and across their borders. Every object begins with ``LOBJ``, the size of its header,
its version, its own size and its type.

Source: python-can, ``can.io.blf``, which follows Vector's description of the format.
"""

from __future__ import annotations

import io
import re
import struct
import zlib
from array import array
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError
from sysid.logs.limits import Budget, cut_blf
from sysid.logs.table import CUT_ROW, to_ns

if TYPE_CHECKING:
    from can import Message


#: Headers of an object (signature, header size and version, size, type) and of a container (method, unpacked size).
_OBJECT, _CONTAINER = struct.Struct("<4sHHLL"), struct.Struct("<H6xL4x")
_CONTAINER_TYPE, _ZLIB = 10, 2
#: Smallest frame (its object header), and largest object (frames, texts, settings) [bytes].
_SMALLEST, _LARGEST = 32, 16 * 2**20


def most_frames(path: Path, budget: Budget) -> int:
    """Upper bound of the number of frames in the file.

    Raises:
        InputError: no BLF file, a container that unpacks to more than its budget, an object of invalid size.
    """
    total, rest = 0, b""
    size_of_file = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(8)
        if head[:4] != b"LOGG" or len(head) < 8:
            raise InputError(path, f"starts with {head[:4].hex() or 'nothing'}", "the magic bytes 'LOGG' of a BLF log")
        file.seek(int.from_bytes(head[4:8], "little"))
        while len(base := file.read(_OBJECT.size)) == _OBJECT.size:
            signature, _, _, size, kind = _OBJECT.unpack(base)
            body = file.read(max(min(size, size_of_file) - _OBJECT.size, 0))
            file.read(size % 4)
            if signature != b"LOBJ" or kind != _CONTAINER_TYPE or len(body) < _CONTAINER.size:
                continue
            data = _unpacked(path, body, budget)
            total += len(data)
            budget.check_unpacked(path, total)
            rest = _without_objects(path, rest + data)
    return total // _SMALLEST


def _unpacked(path: Path, body: bytes, budget: Budget) -> bytes:
    method, _ = _CONTAINER.unpack_from(body)
    packed = body[_CONTAINER.size :]
    if method != _ZLIB:
        return packed
    unpacker = zlib.decompressobj()
    try:
        data = unpacker.decompress(packed, budget.chunk + 1)
    except zlib.error:
        return b""  # reported when the frames are read
    reason = budget.too_large(len(packed), len(data))
    if reason:
        raise InputError(path, f"a container that {reason}", "a log", "The file is damaged or malicious.")
    return data


def _without_objects(path: Path, data: bytes) -> bytes:
    """The rest behind the last whole object: the beginning of one that continues in the next container."""
    position = 0
    while True:
        start = data.find(b"LOBJ", position, position + 8)
        if start < 0 or start + _OBJECT.size > len(data):
            return data[position:] if len(data) - position < _LARGEST else b""
        size = int.from_bytes(data[start + 8 : start + 12], "little")
        if not _OBJECT.size <= size <= _LARGEST:
            expected = f"{_OBJECT.size} to {_LARGEST}"
            raise InputError(path, f"an object of {size} bytes", expected, "The file is damaged.")
        if start + size > len(data):
            return data[position:]
        position = start + size


#: Bus, identifier, whether it has 29 bits.
Address = tuple[str, int, bool]
_LARGEST_STANDARD = 0x7FF


@dataclass(frozen=True)
class Frames:
    """The data frames of one identifier on one bus.

    Args:
        stamps: time of logging, int64 nanoseconds (n,).
        data: payload, padded with zeros to the longest, (n, width) uint8.
        lengths: bytes of each payload (n,).
    """

    stamps: npt.NDArray[np.int64]
    data: npt.NDArray[np.uint8]
    lengths: npt.NDArray[np.int64]


@dataclass
class FrameLog:
    """Content of a file: data frames by address, the numbers of error and remote frames, and losses."""

    frames: dict[Address, Frames] = field(default_factory=dict)
    errors: int = 0
    remotes: int = 0
    losses: list[str] = field(default_factory=list)


@dataclass
class _Collected:
    seconds: array[float] = field(default_factory=lambda: array("d"))
    lengths: array[int] = field(default_factory=lambda: array("L"))
    payloads: bytearray = field(default_factory=bytearray)

    def frames(self, start_ns: int, where: str, budget: Budget) -> Frames:
        lengths = np.array(self.lengths, dtype=np.int64)
        width = int(lengths.max(initial=0))
        budget.check_numbers(where, len(lengths) * width)
        data = np.zeros((len(lengths), width), np.uint8)
        data[np.arange(width) < lengths[:, None]] = np.frombuffer(self.payloads, np.uint8)
        stamps = to_ns(np.array(self.seconds), 1.0, where) + start_ns
        return Frames(stamps, data, lengths)


def read_frames(path: Path, budget: Budget) -> FrameLog:
    """All data frames of a BLF, ASC, TRC (PEAK) or candump file, of a damaged file those before the damage.

    Raises:
        InputError: not such a file, or nothing in it can be read.
    """
    suffix = path.suffix.lower()
    if suffix not in _OPENERS:
        raise InputError(path, f"suffix {path.suffix!r}", f"a CAN log with one of {', '.join(sorted(_OPENERS))}")
    return _OPENERS[suffix](path, budget)


def _read_blf(path: Path, budget: Budget) -> FrameLog:
    from can import BLFReader

    limit = most_frames(path, budget)
    with _opened(path, BLFReader) as reader:
        # Stamps count from the start of the measurement; the start is added as an integer to keep nanoseconds.
        start_ns = round(reader.start_timestamp * 1e3) * 1_000_000
        if not abs(start_ns) < 2**62:  # to_ns holds the stamps themselves within 64 bits
            remedy = "The file is damaged."
            raise InputError(path, f"a start {reader.start_timestamp:.3g} s from 1970", "a date of this century", remedy)
        reader.start_timestamp = 0.0
        log = _collect(path, reader, budget, start_ns, limit)
        log.losses += cut_blf(path)
        return log


def _read_asc(path: Path, budget: Budget) -> FrameLog:
    from can import ASCReader

    with path.open(encoding="utf-8", errors="replace") as file:
        for _, line in zip(range(20), file, strict=False):
            words = line.lower().split()
            if words[:1] == ["base"] and words[-1] == "relative":
                raise InputError(
                    path, "stamps relative to the event before", "absolute stamps", "Save the log again: `timestamps absolute`."
                )
    # The file's date has no time zone, so stamps are counted from the start of the measurement.
    with _opened(path, ASCReader, text=True) as reader:
        log = _collect(path, reader, budget)
        if not log.frames and not log.errors and not log.remotes and reader.date is None:
            raise InputError(path, "neither a date line nor a frame", "a Vector ASC log")
        return log


def _read_trc(path: Path, budget: Budget) -> FrameLog:
    from can import TRCReader

    with path.open("rb") as file:
        head = file.read(64).lstrip()
    if not head.startswith(b";"):
        raise InputError(path, f"starts with {head[:16].decode('latin-1')!r}", "';' as in a PEAK trace", "Is it a marker file?")
    with _opened(path, TRCReader, text=True) as reader:
        return _collect(path, reader, budget)


def _read_candump(path: Path, budget: Budget) -> FrameLog:
    from can import CanutilsLogReader

    with _opened(path, CanutilsLogReader, text=True) as reader:
        return _collect(path, reader, budget)


_OPENERS: dict[str, Callable[[Path, Budget], FrameLog]] = {
    ".blf": _read_blf,
    ".asc": _read_asc,
    ".trc": _read_trc,
    ".log": _read_candump,
}


#: A PEAK trace ends without a line end; its last byte is cut where a single digit follows a byte or the number of bytes.
_CUT_BYTE = re.compile(r"\s[0-9A-F]{1,2}\s+[0-9A-F]$", re.IGNORECASE)


class _WholeLines(io.TextIOWrapper):
    """Lines up to the last whole one."""

    cut = False

    def __next__(self) -> str:  # type: ignore[override]  # as the base class itself does
        line = super().__next__()
        if line.endswith(("\n", "\r")) or (str(self.name).lower().endswith(".trc") and _CUT_BYTE.search(line) is None):
            return line
        self.cut = True
        raise StopIteration


def _opened(path: Path, reader: Callable[..., Any], text: bool = False) -> Any:
    """``reader`` on the opened file, as a context manager that closes it."""
    file: Any = path.open("rb")
    if text:
        file = _WholeLines(file, encoding="utf-8", errors="replace")
    try:
        return reader(file)
    except Exception as error:  # the library raises many unrelated types, one even a bare Exception
        file.close()
        raise InputError(path, _words(error), f"a {path.suffix[1:].upper()} log") from None


def _collect(path: Path, messages: Iterable[Message], budget: Budget, start_ns: int = 0, limit: int | None = None) -> FrameLog:
    """Group ``messages``, of which a file of this size can have at most ``limit``."""
    groups: dict[Address, _Collected] = {}
    log = FrameLog()
    count = 0
    iterator = iter(messages)
    while True:
        try:
            message = next(iterator, None)
        except Exception as error:
            if not count:
                raise InputError(path, _words(error), f"a {path.suffix[1:].upper()} log") from None
            log.losses.append(f"{path.name}: unreadable after {count} frames ({_words(error)})")
            break
        if message is None:
            break
        count += 1
        budget.check_rows(path, count)
        if limit is not None and count > limit:
            raise InputError(path, f"more than {limit} frames", "no more than fit into the file", "The file is damaged.")
        if message.is_error_frame:
            log.errors += 1
        elif message.is_remote_frame:
            log.remotes += 1
        else:
            identifier = message.arbitration_id
            address = (str(message.channel), identifier, message.is_extended_id or identifier > _LARGEST_STANDARD)
            group = groups.get(address)
            if group is None:
                budget.check_topics(path, len(groups) + 1, "identifiers")
                group = groups[address] = _Collected()
            group.seconds.append(message.timestamp)
            group.lengths.append(len(message.data))
            group.payloads += message.data
    if isinstance(file := getattr(messages, "file", None), _WholeLines) and file.cut:
        log.losses.append(f"{path.name}: {CUT_ROW}")
    log.frames = {address: group.frames(start_ns, str(path), budget) for address, group in groups.items()}
    return log


def _words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
