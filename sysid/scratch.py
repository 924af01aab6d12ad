"""Large arrays in scratch files that are mapped into memory, so that a log may be larger than the memory of the machine.

What does not fit into the first :data:`FREE` bytes lies in a file without a name. Its pages are page cache: where memory is
short the operating system writes them to the disk and takes them back, which it cannot do with the memory of a process. The
file vanishes with the process, however that ends, and the room of an array is given back when the array goes.

Without :func:`scratch_in` around the caller every function here makes plain arrays in memory.
"""

from __future__ import annotations

import contextlib
import errno
import mmap
import os
import tempfile
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from sysid.errors import StorageError

Values = npt.NDArray[Any]

#: Bytes of arrays that stay in memory altogether, and the size from which an array counts at all.
FREE, SMALLEST = 32 * 2**20, 2**16
#: Bytes of a file that are mapped at a time; a larger array has a mapping of its own.
SEGMENT = 64 * 2**20
#: Bytes of arrays that are gone whose room is kept for the next ones: new pages cost more than the work on them.
IDLE = 512 * 2**20
#: Values that are worked on at a time.
PIECE = 2**16
#: Sizes in files are multiples of this, a multiple of the page size.
_ROUND = 2**16
#: File systems that cannot reserve room for a file: arrays stay in memory.
_UNABLE = (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS, errno.ENODEV)


class ScratchSegment:
    """A stretch of a scratch file in memory.

    Args:
        file: the file's descriptor.
        start: of the stretch [B], a multiple of the page size.
        length: of the stretch [B].
    """

    def __init__(self, file: int, start: int, length: int) -> None:
        self.start, self.length, self.used = start, length, 0
        self._process = os.getpid()
        self._map = mmap.mmap(file, length, offset=start)
        self.address = int(np.frombuffer(self._map, np.uint8).__array_interface__["data"][0])

    def array(self, offset: int, count: int, kind: npt.DTypeLike, idle: Idle | None = None) -> Values:
        """``count`` values from ``offset`` [B] of the segment on; when the array goes its room is ``idle``, else given back."""
        values = np.ndarray(count, kind, self._map, offset)
        if count:
            weakref.finalize(values, self._gone, offset, _whole_pages(values.nbytes), idle).atexit = False
        return values

    def _gone(self, offset: int, size: int, idle: Idle | None) -> None:
        if os.getpid() != self._process:  # a forked process may have the same array, which is still in use here
            return
        if idle is None or not idle.keep(self, offset, size):
            self.give_back(offset, size)

    def give_back(self, offset: int, size: int) -> None:
        """Give the room of an array back to the disk."""
        with contextlib.suppress(OSError, ValueError):  # a file system without holes: with the file
            self._map.madvise(mmap.MADV_REMOVE, offset, min(size, self.length - offset))

    def leave(self) -> None:
        """Take its pages out of the process; they stay in the page cache."""
        self._map.madvise(mmap.MADV_DONTNEED)

    def share(self, shared: bool) -> None:
        """Whether a process that is forked now has the segment as well."""
        self._map.madvise(mmap.MADV_DOFORK if shared else mmap.MADV_DONTFORK)


class Idle:
    """Rooms of arrays that are gone, to be used again for arrays of the same size."""

    def __init__(self) -> None:
        self.total = 0
        self.closed = False
        self._rooms: dict[int, list[tuple[ScratchSegment, int]]] = {}

    def keep(self, segment: ScratchSegment, offset: int, size: int) -> bool:
        """Whether the room is kept."""
        if self.closed or self.total + size > IDLE:
            return False
        self.total += size
        self._rooms.setdefault(size, []).append((segment, offset))
        return True

    def take(self, size: int) -> tuple[ScratchSegment, int] | None:
        """A room of this size: its segment and where it lies in it."""
        rooms = self._rooms.get(size)
        if not rooms:
            return None
        self.total -= size
        return rooms.pop()

    def close(self) -> None:
        """Give all back, and keep none from now on."""
        self.closed = True
        for size, rooms in self._rooms.items():
            for segment, offset in rooms:
                segment.give_back(offset, size)
        self._rooms.clear()


class Scratch:
    """Arrays of one process, in memory or in one scratch file.

    Args:
        folder: where the file is made when it is needed; it or a folder above it is there.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = next((place for place in (folder, *folder.absolute().parents) if place.is_dir()), folder)
        self._file: IO[bytes] | None = None
        self._end = 0
        self._held = 0
        self._segment: ScratchSegment | None = None
        self._idle = Idle()
        self._segments: weakref.WeakSet[ScratchSegment] = weakref.WeakSet()

    @property
    def file(self) -> IO[bytes] | None:
        """The scratch file, made at the first call; None where none can be made: arrays then stay in memory."""
        if self._file is None:
            with contextlib.suppress(OSError):  # what is to be stored there fails as well, and says why
                self._file = tempfile.TemporaryFile(prefix=".scratch-", dir=self.folder, buffering=0)  # noqa: SIM115
        return self._file

    def empty(self, count: int, kind: npt.DTypeLike) -> Values:
        """An array (count,) whose values are to be written.

        Raises:
            StorageError: the disk is full.
            MemoryError: the limit of the process is reached.
        """
        size = count * np.dtype(kind).itemsize
        if size < SMALLEST:
            return np.empty(count, kind)
        if self._held + size > FREE:
            mapped = self._mapped(count, np.dtype(kind))
            if mapped is not None:
                return mapped
        values = np.empty(count, kind)
        self._held += size
        weakref.finalize(values, self._free, size).atexit = False
        return values

    def close(self) -> None:
        """No more arrays; those there are stay, and their file with them."""
        self._idle.close()
        if self._file is not None:
            self._file.close()

    def place(self, values: Values) -> int | None:
        """Where in the file the array lies [B]; None where it is in memory, or not in one piece."""
        address = int(values.__array_interface__["data"][0])
        if values.ndim != 1 or not values.flags.c_contiguous or not len(values):
            return None
        for segment in self._segments:
            if segment.address <= address < segment.address + segment.length:
                return segment.start + address - segment.address
        return None

    def adopt(self, segment: ScratchSegment) -> None:
        """Treat a segment of another process's file as one of this scratch."""
        self._segments.add(segment)

    def leave(self) -> None:
        """Take all mapped arrays out of the process; what is used again is mapped again."""
        for segment in tuple(self._segments):
            segment.leave()

    @contextmanager
    def unshared(self) -> Iterator[None]:
        """A process that is forked within, and ends within, has none of the arrays in files: it could change them here."""
        segments = tuple(self._segments)
        for segment in segments:
            segment.share(False)
        try:
            yield
        finally:
            for segment in segments:
                segment.share(True)

    def _free(self, size: int) -> None:
        self._held -= size

    def _mapped(self, count: int, kind: np.dtype[Any]) -> Values | None:
        size = _whole_pages(count * kind.itemsize)
        file = self.file
        if file is None:
            return None
        room = self._idle.take(size)
        if room is not None:
            return room[0].array(room[1], count, kind, self._idle)
        segment = self._segment
        try:
            if segment is None or segment.used + size > segment.length:
                # Mappings grow with what there is already: each takes a descriptor.
                length = _whole_pages(max(SEGMENT, size, self._end // 8)) if size < SEGMENT // 2 else size
                os.ftruncate(file.fileno(), self._end + length)
                segment = ScratchSegment(file.fileno(), self._end, length)
                self._end += length
                self._segments.add(segment)
                if size < SEGMENT // 2:
                    self._segment = segment
            # Reserved before it is written: a page without room on the disk would end the process.
            os.posix_fallocate(file.fileno(), segment.start + segment.used, size)
        except OSError as error:
            if error.errno == errno.ENOMEM:
                raise MemoryError from None
            if error.errno in _UNABLE:
                return None
            found = f"no room for scratch files ({os.strerror(error.errno or errno.EIO)}); nothing was stored"
            expected = f"{size / 2**20:.0f} MiB more, about three times the numbers of the logs in all"
            raise StorageError(self.folder, found, expected, "Make room on the disk and run the command again.") from None
        segment.used += size
        return segment.array(segment.used - size, count, kind, self._idle)


_current: ContextVar[Scratch | None] = ContextVar("scratch", default=None)


@contextmanager
def scratch_in(folder: Path) -> Iterator[Scratch]:
    """Large arrays that are made within lie in a scratch file in ``folder``, for as long as they are used, also after it."""
    scratch = Scratch(folder)
    with contextlib.closing(scratch), used(scratch):
        yield scratch


@contextmanager
def used(scratch: Scratch) -> Iterator[None]:
    """Large arrays that are made within belong to ``scratch``."""
    token = _current.set(scratch)
    try:
        yield
    finally:
        _current.reset(token)


def current() -> Scratch | None:
    """The scratch of the caller."""
    return _current.get()


def empty(count: int, kind: npt.DTypeLike = np.float64) -> Values:
    """An array (count,) whose values are to be written.

    Raises:
        StorageError: the disk of the scratch file is full.
    """
    scratch = _current.get()
    return np.empty(count, kind) if scratch is None else scratch.empty(count, kind)


def filled(count: int, value: float, kind: npt.DTypeLike = np.float64) -> Values:
    """An array (count,) of one value."""
    values = empty(count, kind)
    values.fill(value)
    return values


def pieces(count: int) -> Iterator[tuple[int, int]]:
    """(first, last + 1) of each piece of ``count`` values."""
    return ((first, min(first + PIECE, count)) for first in range(0, count, PIECE))


def computed(count: int, piece: Callable[[int, int], Values], kind: npt.DTypeLike = np.float64) -> Values:
    """An array (count,) that is computed some thousand values at a time, so that nothing between takes memory.

    Args:
        piece: (first, last + 1) → the values of these places.
    """
    values = empty(count, kind)
    for first, last in pieces(count):
        values[first:last] = piece(first, last)
    return values


def chosen(values: Values, mask: npt.NDArray[np.bool_]) -> Values:
    """``values[mask]``; the array itself, not a copy, where all are chosen."""
    count = int(np.count_nonzero(mask))
    if count == len(values):
        return values
    result, done = empty(count, values.dtype), 0
    for first, last in pieces(len(values)):
        some = values[first:last][mask[first:last]]
        result[done : done + len(some)] = some
        done += len(some)
    return result


def leave() -> None:
    """Take mapped arrays out of the process: page cache is then all that they are. What is used again is mapped again."""
    scratch = _current.get()
    if scratch is not None:
        scratch.leave()


def _whole_pages(size: int) -> int:
    """Rounded up, so that arrays that differ by a few values take each other's room."""
    return -(-size // _ROUND) * _ROUND
