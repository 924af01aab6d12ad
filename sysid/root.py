"""A folder whose files are opened, written, listed and removed without following links.

Like Go's ``os.Root``, but every link below the root is refused. Each folder on a path is opened relative to the descriptor of
its parent (``openat`` with ``O_NOFOLLOW``), so that no path is exchanged between check and use. The root itself may be
reached through links, because the user named it.

Paths are relative to the root and use ``/``; an absolute path, ``..`` or a null character is refused.
"""

from __future__ import annotations

import errno
import os
import shutil
import stat
import time
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Literal

from sysid.errors import REMEDIES, StoreError, storage_error
from sysid.files import make_folder
from sysid.foreign import shown

Kind = Literal["file", "folder", "link", "other"]

#: Largest length of a name on Linux.
MAX_BYTES = 255
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_REMEDY = "Links inside a workspace are not followed. Move what it leads to here, or mount it (mount --bind)."


@dataclass(frozen=True)
class Root:
    """The files below ``folder``, which is created by the first write."""

    folder: Path

    def kind(self, path: str) -> Kind | None:
        """The kind of entry at ``path``; None if there is none.

        Raises:
            StoreError: a link on the way to it.
        """
        parts = self._parts(path)
        if not parts:
            return "folder" if self.folder.is_dir() else None
        try:
            with self._opened(parts[:-1]) as above:
                return _kind(os.stat(parts[-1], dir_fd=above, follow_symlinks=False).st_mode)
        except (FileNotFoundError, NotADirectoryError):
            return None

    def identity(self, path: str) -> tuple[int, ...]:
        """Numbers that change with every change of a file: device, inode, size, times of content and state [ns].

        Raises:
            StoreError: a link on the way.
            FileNotFoundError: there is none.
        """
        parts = self._parts(path)
        with self._opened(parts[:-1]) as above, self._named(path):
            state = os.stat(parts[-1], dir_fd=above, follow_symlinks=False)
        return (state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns)

    def entries(self, folder: str) -> dict[str, Kind]:
        """Name → kind of the entries in ``folder``, sorted by name; empty if there is no such folder.

        Raises:
            StoreError: ``folder`` is a link, or one is on the way to it.
        """
        try:
            with self._opened(self._parts(folder)) as descriptor, os.scandir(descriptor) as found:
                kinds = dict(_kinds_of(found))
            return dict(sorted(kinds.items()))
        except (FileNotFoundError, NotADirectoryError):
            return {}

    def path(self, path: str) -> Path:
        """``path`` for libraries that need one; neither it nor a folder on the way is a link.

        Raises:
            StoreError: a link.
        """
        if self.kind(path) == "link":
            raise self._refused(path)
        return self.folder / path

    def output(self, path: str) -> Path:
        """:meth:`path` of a file to be written; its folder is created.

        Raises:
            StorageError: the disk takes no folder.
            StoreError: a link.
        """
        try:
            self.make(path.rpartition("/")[0])
        except OSError as error:
            raise (storage_error(error) if error.errno in REMEDIES else error) from None
        return self.path(path)

    def make(self, folder: str) -> Path:
        """Create a folder and its parents, and sync their names to the disk.

        Raises:
            StoreError: a link on the way.
            NotADirectoryError: a file on the way.
        """
        make_folder(self.folder)
        with self._opened(self._parts(folder), make=True):
            return self.folder / folder

    def open(self, path: str) -> BinaryIO:
        """A file to read bytes from.

        Raises:
            StoreError: a link; or a device, pipe or folder.
            FileNotFoundError: there is none.
        """
        parts = self._parts(path)
        with self._opened(parts[:-1]) as above, self._named(path):
            try:
                # O_NONBLOCK: do not wait for the writer of a pipe.
                descriptor = os.open(parts[-1], os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=above)
            except OSError as error:
                raise (self._refused(path) if error.errno == errno.ELOOP else error) from None
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            os.close(descriptor)
            raise StoreError(self.folder / path, "is no regular file", "a file", "Remove it.")
        return os.fdopen(descriptor, "rb")

    def read(self, path: str) -> bytes:
        """All bytes of a file; errors as of :meth:`open`."""
        with self.open(path) as file:
            return file.read()

    def create(self, path: str) -> BinaryIO:
        """A new file to write bytes to; its folder is created.

        Raises:
            StoreError: a link on the way.
            FileExistsError: the path exists, also as a link.
        """
        self.make(path.rpartition("/")[0])
        parts = self._parts(path)
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        with self._opened(parts[:-1]) as above, self._named(path):
            return os.fdopen(os.open(parts[-1], flags, 0o666, dir_fd=above), "wb")

    def write(self, path: str, content: bytes) -> None:
        """Replace ``path`` by ``content`` atomically, and sync it."""
        folder, _, name = path.rpartition("/")
        half = f"{folder}/.{name}.{uuid.uuid4().hex[:8]}.part".lstrip("/")
        try:
            with self._named(path):
                self.write_new(half, content)
                self.rename(half, path)
        finally:
            self.remove(half)

    def write_new(self, path: str, content: bytes) -> None:
        """Create a file and sync it."""
        with self._named(path), self.create(path) as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())

    def rename(self, path: str, to: str) -> None:
        """Rename a file or folder, replacing a file at ``to``, and sync the folder.

        Raises:
            StoreError: a link on the way to either; or ``path`` is one.
        """
        self.path(path)
        source, target = self._parts(path), self._parts(to)
        with self._opened(source[:-1]) as above, self._opened(target[:-1]) as below, self._named(path):
            os.replace(source[-1], target[-1], src_dir_fd=above, dst_dir_fd=below)
            os.fsync(below)

    def link(self, path: str, to: str) -> None:
        """Create a hard link.

        Raises:
            FileExistsError: ``to`` exists.
        """
        self.path(path)
        source, target = self._parts(path), self._parts(to)
        with self._opened(source[:-1]) as above, self._opened(target[:-1]) as below, self._named(to):
            os.link(source[-1], target[-1], src_dir_fd=above, dst_dir_fd=below, follow_symlinks=False)

    def remove(self, path: str) -> None:
        """Remove a file or a folder tree if it exists; links in the tree are removed, not followed.

        Raises:
            StoreError: a link on the way to it, or it is one.
        """
        kind = self.kind(path)
        if kind is None:
            return
        if kind == "link":
            raise self._refused(path)
        parts = self._parts(path)
        with self._opened(parts[:-1]) as above, self._named(path):
            if kind == "folder":
                shutil.rmtree(parts[-1], dir_fd=above)
            else:
                os.unlink(parts[-1], dir_fd=above)

    def settle(self, folder: str) -> None:
        """Sync all files below ``folder``, and its name."""
        with self._opened(self._parts(folder)) as top:
            for _, _, names, descriptor in os.fwalk(".", dir_fd=top, follow_symlinks=False):
                for name in names:
                    if stat.S_ISREG(os.stat(name, dir_fd=descriptor, follow_symlinks=False).st_mode):
                        file = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=descriptor)
                        try:
                            os.fsync(file)
                        finally:
                            os.close(file)
                os.fsync(descriptor)
        self.sync(folder.rpartition("/")[0])

    def sync(self, folder: str) -> None:
        """Sync the names in ``folder``."""
        with self._opened(self._parts(folder)) as descriptor:
            os.fsync(descriptor)

    def weight(self, folder: str) -> tuple[int, float]:
        """Total size of the files below ``folder`` [bytes], and time since the last change in it [s]."""
        size, last = 0, 0.0
        with self._opened(self._parts(folder)) as top:
            for _, _, names, descriptor in os.fwalk(".", dir_fd=top, follow_symlinks=False):
                last = max(last, os.fstat(descriptor).st_mtime)
                for name in names:
                    state = os.stat(name, dir_fd=descriptor, follow_symlinks=False)
                    size += state.st_size if stat.S_ISREG(state.st_mode) else 0
                    last = max(last, state.st_mtime)
        return size, time.time() - last

    def _parts(self, path: str) -> tuple[str, ...]:
        parts = tuple(path.split("/")) if path else ()
        if any(part in ("", ".", "..") or "\0" in part for part in parts):
            raise StoreError(f"workspace {self.folder}", f"path {shown(path)} leaves it", "a path inside it")
        if any(_length(part) > MAX_BYTES for part in parts):
            raise StoreError(f"workspace {self.folder}", f"path {shown(path)}", f"at most {MAX_BYTES} bytes a name")
        return parts

    @contextmanager
    def _opened(self, parts: tuple[str, ...], make: bool = False) -> Iterator[int]:
        """The descriptor of a folder."""
        descriptor = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            for depth, part in enumerate(parts, start=1):
                path = "/".join(parts[:depth])
                with self._named(path):
                    below = self._folder(part, descriptor, path, make)
                os.close(descriptor)
                descriptor = below
            yield descriptor
        finally:
            os.close(descriptor)

    def _folder(self, name: str, above: int, path: str, make: bool) -> int:
        try:
            return os.open(name, _FOLDER, dir_fd=above)
        except FileNotFoundError:
            if not make:
                raise
        except NotADirectoryError:
            if _kind(os.stat(name, dir_fd=above, follow_symlinks=False).st_mode) == "link":
                raise self._refused(path) from None
            raise
        try:
            os.mkdir(name, dir_fd=above)
        except FileExistsError:  # another process was first
            return os.open(name, _FOLDER, dir_fd=above)
        os.fsync(above)
        return os.open(name, _FOLDER, dir_fd=above)

    @contextmanager
    def _named(self, path: str) -> Iterator[None]:
        """System errors with the whole path."""
        try:
            yield
        except OSError as error:
            error.filename = str(self.folder / path)
            raise

    def _refused(self, path: str) -> StoreError:
        return StoreError(self.folder / path, "is a link", "a file or folder of its own", _REMEDY)


def _length(name: str) -> int:
    """Bytes of a name on the disk; above the bound if it cannot be encoded (unpaired surrogate)."""
    try:
        return len(os.fsencode(name))
    except UnicodeEncodeError:
        return MAX_BYTES + 1


def _kinds_of(entries: Iterable[os.DirEntry[str]]) -> Iterator[tuple[str, Kind]]:
    """Name and kind of each entry; one that another process removes meanwhile (a temporary file) is left out."""
    for entry in entries:
        with suppress(FileNotFoundError):
            yield entry.name, _kind(entry.stat(follow_symlinks=False).st_mode)


def _kind(mode: int) -> Kind:
    if stat.S_ISLNK(mode):
        return "link"
    return "file" if stat.S_ISREG(mode) else "folder" if stat.S_ISDIR(mode) else "other"
