"""Limits of reading one log file, and detection of files that are cut between two records.

A damaged or hostile file must not fill the memory or take hours, so every size that it states is checked before it is used. A
cut is found by the length that the head or other parts of the file state.
"""

from __future__ import annotations

import os
import stat
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from sysid.confined import Limits
from sysid.errors import InputError

#: Memory for a small file; for a larger one a multiple of its size, up to the memory of the machine.
FREE_MEMORY, MEMORY_RATIO = 512 * 2**20, 64
#: Processor time for a small file [s], and for each further byte.
FREE_SECONDS, SECONDS_A_BYTE = 15.0, 20e-6
#: Unpacked size of one chunk, container or variable: of a small file, as a multiple of the file, and at most.
FREE_CHUNK, CHUNK_RATIO, MAX_CHUNK = 64 * 2**20, 100, 512 * 2**20
#: Packed data that grow by more than this factor beyond :data:`FREE` are a decompression bomb.
MAX_RATIO, FREE = 1000, 16 * 2**20
#: Largest text export.
MAX_TEXT = 4 * 2**30
#: Columns of a table or fields of a topic; topics, bodies, markers or messages of a file; levels of nested objects.
MAX_COLUMNS, MAX_TOPICS, MAX_DEPTH = 16_384, 4096, 32
#: The header line of a table.
MAX_LINE = 4 * 2**20

_KINDS = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
    stat.S_IFDIR: "a folder",
}


@dataclass(frozen=True)
class Budget:
    """Limits of reading one file.

    Args:
        memory: held at once in addition to the interpreter and its libraries [B].
        seconds: processor time [s].
        chunk: unpacked size of one chunk, container or variable [B].
        unpacked: unpacked size of all of them [B].
        rows: samples of one stream.
        columns: of a table; fields of a topic.
        topics: topics, bodies, markers or messages of the file.
        depth: levels of nested objects.
    """

    memory: int
    seconds: float
    chunk: int
    unpacked: int
    rows: int
    columns: int = MAX_COLUMNS
    topics: int = MAX_TOPICS
    depth: int = MAX_DEPTH

    @classmethod
    def of(cls, size: int) -> Budget:
        """For a file of ``size`` bytes."""
        unpacked = max(FREE_MEMORY, MEMORY_RATIO * size)
        of_machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        memory = min(unpacked, max(FREE_MEMORY, of_machine))
        chunk = min(max(FREE_CHUNK, CHUNK_RATIO * size), MAX_CHUNK)
        return cls(memory, FREE_SECONDS + SECONDS_A_BYTE * size, chunk, unpacked, memory // 16)

    @property
    def numbers(self) -> int:
        """Values of 8 bytes that may be kept: half of the memory, as the other half is needed to process them."""
        return self.memory // 16

    def check_columns(self, where: object, count: int, what: str = "columns") -> None:
        """Raise where a table has too many columns."""
        self._check(where, count, self.columns, what, "Export fewer columns.")

    def check_topics(self, where: object, count: int, what: str = "topics") -> None:
        """Raise where a file has too many topics, bodies, markers or messages."""
        self._check(where, count, self.topics, what, "Name those that are needed in the recipe, or export fewer.")

    def check_rows(self, where: object, count: int) -> None:
        """Raise where a stream has too many samples."""
        self._check(where, count, self.rows, "rows", "Export it in parts.")

    def check_numbers(self, where: object, count: int) -> None:
        """Raise where more values would be kept than fit into memory."""
        remedy = "Name fewer signals in the recipe, or export it in parts."
        self._check(where, count, self.numbers, "numbers", remedy)

    def check_unpacked(self, where: object, total: int) -> None:
        """Raise where the unpacked parts of a file are too large in total."""
        if total > self.unpacked:
            found = f"data that unpack to more than {self.unpacked / 2**20:.0f} MiB"
            expected = f"at most {FREE_MEMORY / 2**20:.0f} MiB or {MEMORY_RATIO} times the size of the file"
            raise InputError(where, found, expected, "The file is damaged or malicious.")

    def too_large(self, packed: int, unpacked: int, at_once: bool = True) -> str:
        """Why ``packed`` bytes may not be unpacked to ``unpacked`` bytes (``at_once``: as one chunk); empty where they may."""
        if at_once and unpacked > MAX_CHUNK:
            return f"unpacks to {unpacked / 2**20:.0f} MiB, more than {MAX_CHUNK / 2**20:.0f} MiB"
        if unpacked > max(FREE, packed * MAX_RATIO):
            return f"{packed} bytes unpack to {unpacked}, more than {MAX_RATIO} times as many"
        if at_once and unpacked > self.chunk:
            return f"unpacks to {unpacked / 2**20:.0f} MiB, more than {self.chunk / 2**20:.0f} MiB"
        return ""

    @property
    def limits(self) -> Limits:
        """Of the process that reads the file."""
        return Limits(self.memory, self.seconds)

    @staticmethod
    def _check(where: object, count: int, limit: int, what: str, remedy: str) -> None:
        if count > limit:
            raise InputError(where, f"{count} {what}", f"at most {limit} {what}", remedy)


def check_file(path: Path, what: str, limit: int | None = None) -> int:
    """The size of the file ``path`` [B].

    Raises:
        InputError: missing, a pipe, a device or a folder, without bytes, or more than ``limit`` bytes.
    """
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(path, "no such file", what, "Check the path.") from None
    except OSError as error:  # a name that is too long, a link to itself
        raise InputError(path, str(error.strerror or "cannot be opened").lower(), what, "Check the path.") from None
    if not stat.S_ISREG(status.st_mode):
        found = _KINDS.get(stat.S_IFMT(status.st_mode), "no file")
        raise InputError(path, found, what, "Copy the log into a file.")
    if status.st_size == 0:
        raise InputError(path, "the file is empty", what, "Export the log again.")
    if limit is not None and status.st_size > limit:
        found, expected = f"{status.st_size / 2**30:.1f} GiB", f"at most {limit / 2**30:g} GiB for {what}"
        raise InputError(path, found, expected, "Export it in parts.")
    return status.st_size


def unpack(packed: bytes | memoryview, compression: str, size: int, budget: Budget, cut_off: bool = False) -> bytes:
    """The ``size`` bytes that were compressed with zstd or lz4 (frames); fewer where the data are cut off.

    Raises:
        ValueError: the data are damaged, larger than stated, or larger than allowed.
    """
    reason = budget.too_large(len(packed), size)
    if reason:
        raise ValueError(reason)
    if compression == "zstd":
        return _unzstd(packed, size, cut_off)
    if compression == "lz4":
        return _unlz4(packed, size, cut_off)
    raise ValueError(f"compressed with {compression!r}; zstd, lz4 or none can be read")


def _unzstd(packed: bytes | memoryview, size: int, cut_off: bool) -> bytes:
    import zstandard

    pieces: list[bytes] = []
    left = size + 1
    try:
        stated = zstandard.frame_content_size(packed)
        if stated == size and not cut_off:
            return zstandard.ZstdDecompressor().decompress(packed)
        # The size is not stated, or contradicts: at most the allowed size is unpacked.
        with zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True) as reader:
            while left > 0 and (piece := reader.read(min(left, 2**20))):
                pieces.append(piece)
                left -= len(piece)
    except zstandard.ZstdError as error:
        if not cut_off:
            raise ValueError(str(error)) from None
    return _checked(b"".join(pieces), size, cut_off)


def _unlz4(packed: bytes | memoryview, size: int, cut_off: bool) -> bytes:
    import lz4.frame  # type: ignore[import-untyped]

    try:
        data = bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1))
    except RuntimeError as error:
        raise ValueError(str(error)) from None
    return _checked(data, size, cut_off)


def _checked(data: bytes, size: int, cut_off: bool) -> bytes:
    if len(data) > size:
        raise ValueError(f"more than the {size} bytes that the file states")
    if len(data) < size and not cut_off:
        raise ValueError(f"{len(data)} bytes instead of the {size} that the file states")
    return data


#: Of a BLF file: signature, header size, application and its version, version of the library, size of the file.
_BLF_HEAD = struct.Struct("<4sL8xQ")


def cut_blf(path: Path) -> tuple[str, ...]:
    """A note where a BLF file is shorter than its head states; a recorder that was killed leaves no length there."""
    with path.open("rb") as file:
        head = file.read(_BLF_HEAD.size)
    if len(head) < _BLF_HEAD.size:
        return ()
    _, _, stated = _BLF_HEAD.unpack(head)
    found = path.stat().st_size
    return (f"{path.name}: the file is cut off: {found} of {stated} bytes are there",) if found < stated else ()


def missing_frames(path: Path, stated: str, found: int) -> tuple[str, ...]:
    """A note where there are fewer frames than the head states.

    Args:
        stated: text of the head; empty or no number where it states nothing.
    """
    text = stated.strip()
    if not (text.isascii() and text.isdigit() and len(text) < 16) or int(text) <= found:
        return ()
    return (f"{path.name}: the file is cut off: {found} of {int(text)} frames are there",)


def uneven_sections(path: Path, last_frames: Iterable[tuple[str, float]]) -> tuple[str, ...]:
    """A note where one part of a trial ends before another.

    Args:
        last_frames: name of each part and the number of its last frame.
    """
    ends = list(last_frames)
    latest = max((frame for _, frame in ends), default=0.0)
    return tuple(
        f"{path.name}: the file is cut off: {name} ends at frame {frame:.0f}, other sections at {latest:.0f}"
        for name, frame in ends
        if frame < latest
    )
