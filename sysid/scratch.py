"""Large arrays in memory-mapped scratch files, so that a log may be larger than the computer's memory.

Arrays beyond the first :data:`FREE` bytes are stored in an unnamed file. Its pages are page cache, which the operating system
can write to the disk and reclaim when memory is short. The file disappears with the process, and the space of an array is
released with the array. Outside of :func:`scratch_in` every function here returns plain arrays in memory.
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

#: Total bytes of arrays that stay in memory, and the size from which an array is counted.
FREE, SMALLEST = 32 * 2**20, 2**16
#: Bytes of a mapping; a larger array has its own.
SEGMENT = 64 * 2**20
#: Largest total size of the free list [bytes]: new pages cost more than the computation on them.
MAX_FREE_LIST = 512 * 2**20
#: Values of a block of computation.
PIECE = 2**16
#: Blocks after which pages are unmapped: 16 MiB of an array.
MAPPED_PIECES = 32
#: Granularity of sizes in files [bytes], a multiple of the page size.
_ROUND = 2**16
#: Errors of file systems that cannot reserve space: arrays stay in memory.
_UNABLE = (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS, errno.ENODEV)


class ScratchSegment:
    """A mapped section of a scratch file.

    Args:
        file: the file's descriptor.
        start: offset in the file [B], a multiple of the page size.
        length: size [B].
    """

    def __init__(self, file: int, start: int, length: int) -> None:
        self.start, self.length, self.used, self.adopted = start, length, 0, False
        self._process = os.getpid()
        self._map = mmap.mmap(file, length, offset=start)
        self.address = int(np.frombuffer(self._map, np.uint8).__array_interface__["data"][0])

    def array(self, offset: int, count: int, kind: npt.DTypeLike, free: FreeList | None = None) -> Values:
        """``count`` values from ``offset`` [B] of the segment on; afterwards their space goes to ``free``, or to the disk."""
        values = np.ndarray(count, kind, self._map, offset)
        if count:
            weakref.finalize(values, self._release, offset, _whole_pages(values.nbytes), free).atexit = False
        return values

    def _release(self, offset: int, size: int, free: FreeList | None) -> None:
        if os.getpid() != self._process:  # in a forked process: the parent still uses the array
            return
        if free is None or not free.add(self, offset, size):
            self.punch_hole(offset, size)

    def punch_hole(self, offset: int, size: int) -> None:
        """Return the space of an array to the disk."""
        with contextlib.suppress(OSError, ValueError):  # a file system without holes
            self._map.madvise(mmap.MADV_REMOVE, offset, min(size, self.length - offset))

    def leave(self) -> None:
        """Unmap its pages from the process; they stay in the page cache."""
        self._map.madvise(mmap.MADV_DONTNEED)

    def share(self, shared: bool) -> None:
        """Whether processes forked from now on inherit the segment."""
        self._map.madvise(mmap.MADV_DOFORK if shared else mmap.MADV_DONTFORK)


class FreeList:
    """Free blocks of the scratch file, reused for arrays of the same size."""

    def __init__(self) -> None:
        self.total = 0
        self.closed = False
        self._blocks: dict[int, list[tuple[ScratchSegment, int]]] = {}

    def add(self, segment: ScratchSegment, offset: int, size: int) -> bool:
        """Keep a block; False if the list is full or closed."""
        if self.closed or self.total + size > MAX_FREE_LIST:
            return False
        self.total += size
        self._blocks.setdefault(size, []).append((segment, offset))
        return True

    def take(self, size: int) -> tuple[ScratchSegment, int] | None:
        """A block of this size: its segment and offset."""
        blocks = self._blocks.get(size)
        if not blocks:
            return None
        self.total -= size
        return blocks.pop()

    def close(self) -> None:
        """Return all blocks to the disk, and keep none from now on."""
        self.closed = True
        for size, blocks in self._blocks.items():
            for segment, offset in blocks:
                segment.punch_hole(offset, size)
        self._blocks.clear()


class Scratch:
    """Arrays of one process, in memory or in one scratch file.

    Args:
        folder: of the file, which is created on demand; the folder or one of its parents exists.
        required: a full disk is an error; else arrays then stay in memory.
    """

    def __init__(self, folder: Path, required: bool = True) -> None:
        self.required = required
        self.folder = next((place for place in (folder, *folder.absolute().parents) if place.is_dir()), folder)
        self._file: IO[bytes] | None = None
        self._end = 0
        self._held = 0
        self._segment: ScratchSegment | None = None
        self._free_blocks = FreeList()
        self._segments: weakref.WeakSet[ScratchSegment] = weakref.WeakSet()

    @property
    def file(self) -> IO[bytes] | None:
        """The scratch file, created at the first call; None if that fails: arrays then stay in memory."""
        if self._file is None:
            with contextlib.suppress(OSError):  # later writes to this folder fail with their own message
                self._file = tempfile.TemporaryFile(prefix=".scratch-", dir=self.folder, buffering=0)  # noqa: SIM115
        return self._file

    def empty(self, count: int, kind: npt.DTypeLike) -> Values:
        """An uninitialised array (count,).

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
        """Create no more arrays; existing ones keep their file."""
        self._free_blocks.close()
        if self._file is not None:
            self._file.close()

    def place(self, values: Values) -> int | None:
        """Offset of the array in the file [B]; None if it is in memory, or not contiguous."""
        segment, address = self._segment_of(values), int(values.__array_interface__["data"][0])
        return None if segment is None else segment.start + address - segment.address

    def _segment_of(self, values: Values) -> ScratchSegment | None:
        address = int(values.__array_interface__["data"][0])
        if values.ndim != 1 or not values.flags.c_contiguous or not len(values):
            return None
        inside = (s for s in self._segments if s.address <= address < s.address + s.length)
        return next(inside, None)

    def put(self, values: Values, first: int, some: Values) -> None:
        """``values[first : first + len(some)] = some``, into the file where it can be: new pages of a mapping take longer."""
        segment = self._segment_of(values) if some.nbytes >= SMALLEST else None
        if segment is None or segment.adopted or self._file is None or self._file.closed:
            values[first : first + len(some)] = some
            return
        at = segment.start + int(values[first:].__array_interface__["data"][0]) - segment.address
        left = np.ascontiguousarray(some, values.dtype).view(np.uint8).data
        while left:
            done = os.pwrite(self._file.fileno(), left, at)
            left, at = left[done:], at + done

    def adopt(self, segment: ScratchSegment) -> None:
        """Add a segment of another process's file."""
        segment.adopted = True
        self._segments.add(segment)

    def leave(self) -> None:
        """Unmap the pages of all arrays; pages that are used again are mapped again."""
        for segment in tuple(self._segments):
            segment.leave()

    @contextmanager
    def unshared(self) -> Iterator[None]:
        """Processes that are forked and end within do not inherit the mapped arrays, so that they cannot change them."""
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
        block = self._free_blocks.take(size)
        if block is not None:
            return block[0].array(block[1], count, kind, self._free_blocks)
        segment = self._segment
        try:
            if segment is None or segment.used + size > segment.length:
                # Mappings grow with the file, because each takes a descriptor.
                length = _whole_pages(max(SEGMENT, size, self._end // 8)) if size < SEGMENT // 2 else size
                os.ftruncate(file.fileno(), self._end + length)
                segment = ScratchSegment(file.fileno(), self._end, length)
                self._end += length
                self._segments.add(segment)
                if size < SEGMENT // 2:
                    self._segment = segment
            # Reserved before writing: a page without space on the disk would kill the process.
            os.posix_fallocate(file.fileno(), segment.start + segment.used, size)
        except OSError as error:
            if error.errno == errno.ENOMEM:
                raise MemoryError from None
            if error.errno in _UNABLE or not self.required:
                return None
            found = f"no room for scratch files ({os.strerror(error.errno or errno.EIO)}); nothing was stored"
            expected = f"{size / 2**20:.0f} MiB more, about three times the numbers of the logs in all"
            raise StorageError(self.folder, found, expected, "Make room on the disk and run the command again.") from None
        segment.used += size
        return segment.array(segment.used - size, count, kind, self._free_blocks)


_current: ContextVar[Scratch | None] = ContextVar("scratch", default=None)


@contextmanager
def scratch_in(folder: Path, required: bool = True) -> Iterator[Scratch]:
    """Large arrays created within are stored in a scratch file in ``folder`` for their lifetime, also after the block.

    Args:
        required: see :class:`Scratch`.
    """
    scratch = Scratch(folder, required)
    with contextlib.closing(scratch), used(scratch):
        yield scratch


@contextmanager
def used(scratch: Scratch) -> Iterator[None]:
    """Large arrays created within belong to ``scratch``."""
    token = _current.set(scratch)
    try:
        yield
    finally:
        _current.reset(token)


def current() -> Scratch | None:
    """The scratch of the caller."""
    return _current.get()


def empty(count: int, kind: npt.DTypeLike = np.float64) -> Values:
    """An uninitialised array (count,).

    Raises:
        StorageError: the disk of the scratch file is full.
    """
    scratch = _current.get()
    return np.empty(count, kind) if scratch is None else scratch.empty(count, kind)


def put(values: Values, first: int, some: Values) -> None:
    """``values[first : first + len(some)] = some`` of an array of :func:`empty` that is written for the first time."""
    scratch = _current.get()
    if scratch is None:
        values[first : first + len(some)] = some
    else:
        scratch.put(values, first, some)


def filled(count: int, value: float, kind: npt.DTypeLike = np.float64) -> Values:
    """An array (count,) of one value."""
    block = np.full(min(count, PIECE), value, kind)
    return computed(count, lambda first, last: block[: last - first], kind)


def pieces(count: int) -> Iterator[tuple[int, int]]:
    """(first, last + 1) of each block of ``count`` values; the pages of those before are unmapped from time to time."""
    for first in range(0, count, PIECE):
        yield first, min(first + PIECE, count)
        if (first // PIECE + 1) % MAPPED_PIECES == 0:
            leave()


def computed(count: int, piece: Callable[[int, int], Values], kind: npt.DTypeLike = np.float64) -> Values:
    """An array (count,) that is computed block by block, so that intermediate results stay small.

    Args:
        piece: (first, last + 1) → the values at these indices.
    """
    values = empty(count, kind)
    for first, last in pieces(count):
        put(values, first, piece(first, last))
    return values


def chosen(values: Values, mask: npt.NDArray[np.bool_]) -> Values:
    """``values[mask]``; the array itself, not a copy, if all are selected."""
    count = int(np.count_nonzero(mask))
    if count == len(values):
        return values
    result, done = empty(count, values.dtype), 0
    for first, last in pieces(len(values)):
        some = values[first:last][mask[first:last]]
        put(result, done, some)
        done += len(some)
    return result


def leave() -> None:
    """Unmap the pages of the caller's scratch arrays; pages that are used again are mapped again."""
    scratch = _current.get()
    if scratch is not None:
        scratch.leave()


def _whole_pages(size: int) -> int:
    """``size`` rounded up, so that arrays of similar size share free blocks."""
    return -(-size // _ROUND) * _ROUND
