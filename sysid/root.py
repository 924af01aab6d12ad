"""A root: one folder, and files below it that are opened, written, listed and removed without following a link.

As Go's ``os.Root``, stricter in one thing: a link below the root is refused, wherever it leads. Each folder on the way is
opened by the descriptor of the one above it (``openat`` with ``O_NOFOLLOW``), so that what is checked is what is used. The root
itself may be reached through links: whoever runs the command named it.

Paths are relative to the root and use ``/``; an absolute path, ``..`` or a null character is refused.
"""

from __future__ import annotations

import errno
import os
import shutil
import stat
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Literal

from sysid.errors import StoreError
from sysid.files import make_folder
from sysid.foreign import shown

Kind = Literal["file", "folder", "link", "other"]

#: What Linux takes in one name.
MOST_BYTES = 255
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_REMEDY = "Links inside a workspace are not followed. Move what it leads to here, or mount it (mount --bind)."


@dataclass(frozen=True)
class Root:
    """Everything below ``folder``; nothing is made before something is written."""

    folder: Path

    def kind(self, path: str) -> Kind | None:
        """What lies at ``path``; None where nothing does.

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

    def entries(self, folder: str) -> dict[str, Kind]:
        """Name → kind of what lies in ``folder``, by name; empty where there is no such folder.

        Raises:
            StoreError: ``folder`` is a link, or one is on the way to it.
        """
        try:
            with self._opened(self._parts(folder)) as descriptor, os.scandir(descriptor) as found:
                return {entry.name: _kind(entry.stat(follow_symlinks=False).st_mode) for entry in sorted(found, key=_name)}
        except (FileNotFoundError, NotADirectoryError):
            return {}

    def path(self, path: str) -> Path:
        """``path`` for a library that reads or writes by path: neither it nor a folder on the way is a link.

        Raises:
            StoreError: a link.
        """
        if self.kind(path) == "link":
            raise self._refused(path)
        return self.folder / path

    def output(self, path: str) -> Path:
        """:meth:`path` of a file to be written; its folder is made.

        Raises:
            StoreError: a link.
        """
        self.make(path.rpartition("/")[0])
        return self.path(path)

    def make(self, folder: str) -> Path:
        """Make a folder and those above it; each is on the disk, by name, when this returns.

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
                # Not to wait for whoever writes to a pipe.
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
        """A new file to write bytes to; its folder is made.

        Raises:
            StoreError: a link on the way.
            FileExistsError: something is there, a link included.
        """
        self.make(path.rpartition("/")[0])
        parts = self._parts(path)
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        with self._opened(parts[:-1]) as above, self._named(path):
            return os.fdopen(os.open(parts[-1], flags, 0o666, dir_fd=above), "wb")

    def write(self, path: str, content: bytes) -> None:
        """Put ``content`` in the place of ``path``: whole and on the disk, or not at all."""
        folder, _, name = path.rpartition("/")
        half = f"{folder}/.{name}.{uuid.uuid4().hex[:8]}.part".lstrip("/")
        try:
            self.write_new(half, content)
            self.rename(half, path)
        finally:
            self.remove(half)

    def write_new(self, path: str, content: bytes) -> None:
        """A new file that is on the disk when this returns."""
        with self.create(path) as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())

    def rename(self, path: str, to: str) -> None:
        """Give a file or folder another name; a file that has it is replaced. On the disk when this returns.

        Raises:
            StoreError: a link on the way to either; or ``path`` is one.
        """
        self.path(path)
        source, target = self._parts(path), self._parts(to)
        with self._opened(source[:-1]) as above, self._opened(target[:-1]) as below, self._named(path):
            os.replace(source[-1], target[-1], src_dir_fd=above, dst_dir_fd=below)
            os.fsync(below)

    def link(self, path: str, to: str) -> None:
        """A second name for a file (a hard link).

        Raises:
            FileExistsError: ``to`` is there.
        """
        self.path(path)
        source, target = self._parts(path), self._parts(to)
        with self._opened(source[:-1]) as above, self._opened(target[:-1]) as below, self._named(to):
            os.link(source[-1], target[-1], src_dir_fd=above, dst_dir_fd=below, follow_symlinks=False)

    def remove(self, path: str) -> None:
        """Remove a file, or a folder with all it holds, if it is there; links in that folder go, what they lead to stays.

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
        """Return when all that is in ``folder``, and its name, are on the disk."""
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
        """Return when the names in ``folder`` are on the disk."""
        with self._opened(self._parts(folder)) as descriptor:
            os.fsync(descriptor)

    def weight(self, folder: str) -> tuple[int, float]:
        """Bytes of the files below ``folder``, and seconds since the last change in it."""
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
        if any(_length(part) > MOST_BYTES for part in parts):
            raise StoreError(f"workspace {self.folder}", f"path {shown(path)}", f"at most {MOST_BYTES} bytes a name")
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
        """Errors of the system with the whole path."""
        try:
            yield
        except OSError as error:
            error.filename = str(self.folder / path)
            raise

    def _refused(self, path: str) -> StoreError:
        return StoreError(self.folder / path, "is a link", "a file or folder of its own", _REMEDY)


def _length(name: str) -> int:
    """Bytes of a name on the disk; beyond all bounds where it has none (half a surrogate pair)."""
    try:
        return len(os.fsencode(name))
    except UnicodeEncodeError:
        return MOST_BYTES + 1


def _kind(mode: int) -> Kind:
    if stat.S_ISLNK(mode):
        return "link"
    return "file" if stat.S_ISREG(mode) else "folder" if stat.S_ISDIR(mode) else "other"


def _name(entry: os.DirEntry[str]) -> str:
    return entry.name
