"""The file operations of the store, on a local folder or an object store; and those of a local folder, where a lock separates
writers and a hard link publishes.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import re
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from sysid.errors import StorageError, StoreError
from sysid.root import Root

#: State of the store after a failed write, for the message of :func:`explained`.
UNCHANGED = "no version was made, existing ones are complete"


class TakenError(StoreError):
    """The file to be published exists: another writer was first."""


class OvertakenError(StoreError):
    """Another version was stored after the newest one was read for an append."""


class Files(Protocol):
    """Paths are relative to the workspace and use ``/``; a link below it is refused with a StoreError."""

    @property
    def locks(self) -> bool:
        """Whether :meth:`lock` excludes writers of other processes."""
        ...

    def uri(self, path: str) -> str: ...

    def names(self, folder: str) -> list[str]:
        """Names of the files in ``folder``, sorted; empty where there is none."""
        ...

    def folders(self, folder: str) -> list[str]:
        """Names of the folders in ``folder``, sorted."""
        ...

    def links(self, folder: str) -> list[str]:
        """Names of the links in ``folder``, sorted: neither files nor folders, and never followed."""
        ...

    def read(self, path: str) -> bytes: ...

    def open(self, path: str) -> BinaryIO:
        """A file to read bytes from, without those that are not asked for where the store has them at hand."""
        ...

    def identity(self, path: str) -> tuple[int, ...] | None:
        """Numbers that change with every change of a file; None where the store has none that are quicker than its content."""
        ...

    def address(self, path: str) -> tuple[int, str]:
        """Size [bytes] and sha256 of a file."""
        ...

    def create(self, path: str) -> BinaryIO:
        """A new file to write bytes to; its folder is made."""
        ...

    def replaced(self, path: str) -> AbstractContextManager[BinaryIO]:
        """A file to write bytes to, which appears at ``path`` when the block ends; an earlier one there is replaced."""
        ...

    def settle(self, folder: str) -> None:
        """Return when the files written to ``folder`` survive a power cut."""
        ...

    def publish(self, path: str, text: str) -> None:
        """Write a new file atomically.

        Raises:
            TakenError: it exists, or another writer has claimed it.
        """
        ...

    def claimed(self, folder: str) -> list[str]:
        """Names in ``folder`` that a writer has claimed, published or not."""
        ...

    def rename(self, path: str, to: str) -> None:
        """Rename a file; a process that is killed meanwhile leaves the old one, the new one, or both."""
        ...

    def weight(self, folder: str) -> tuple[int, float]:
        """Size of ``folder`` [bytes], and seconds since its last write."""
        ...

    def remove(self, path: str) -> None:
        """Remove a file, or a folder with its content, if it exists."""
        ...

    def lock(self, folder: str) -> Any:
        """A context for one writer at a time."""
        ...

    def unlock(self, folder: str) -> None:
        """Remove what :meth:`lock` left in a folder; called within it."""
        ...

    def is_locked(self, folder: str) -> bool:
        """Whether a writer is at work in ``folder``; without locks this is unknown, and False."""
        ...


def scratch_folder(workspace: str | Path) -> Path:
    """Folder of scratch files for ``workspace``: the workspace itself if local, so that they are on the same disk."""
    return Path(tempfile.gettempdir()) if "://" in str(workspace) else Path(workspace)


@contextmanager
def explained(where: object, state: str) -> Iterator[None]:
    """Errors of disks, object stores and Delta as a :class:`StorageError`.

    Args:
        state: of the store after the error, for the message.
    """
    import pyarrow as pa
    from deltalake.exceptions import DeltaError

    try:
        yield
    except (OSError, DeltaError, pa.ArrowException) as error:
        number = error.errno if isinstance(error, OSError) else None
        stated = re.search(r"os error (\d+)|errno (\d+)", str(error))
        if number is None and stated:
            number = int(stated[1] or stated[2])
        found = os.strerror(number) if number else str(error).splitlines()[0]
        remedy = {
            errno.ENOSPC: "Make room on the disk and run the command again.",
            errno.EDQUOT: "Make room in your quota and run the command again.",
            errno.EROFS: "Versions that are there can be read; to write, name a workspace that may be written.",
            errno.EACCES: "Versions that are there can be read; to write, name a workspace that may be written.",
        }.get(number or 0, "Mend that and run the command again.")
        raise StorageError(where, f"cannot be written ({found}); {state}", remedy=remedy) from None


#: How long a writer waits for another one [s].
LOCK_WAIT_S = 300.0
_LOCK = ".lock"
_NO_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)


@dataclass(frozen=True)
class LocalFiles:
    """A folder on this machine; links below it are refused (:mod:`sysid.root`)."""

    root: Path
    locks: bool = True

    @property
    def below(self) -> Root:
        return Root(self.root)

    def uri(self, path: str) -> str:
        self.below.path(path)
        return str(self.root.resolve() / path)

    def names(self, folder: str) -> list[str]:
        return [name for name, kind in self.below.entries(folder).items() if kind == "file"]

    def folders(self, folder: str) -> list[str]:
        return [name for name, kind in self.below.entries(folder).items() if kind == "folder"]

    def links(self, folder: str) -> list[str]:
        return [name for name, kind in self.below.entries(folder).items() if kind == "link"]

    def read(self, path: str) -> bytes:
        return self.below.read(path)

    def open(self, path: str) -> BinaryIO:
        return self.below.open(path)

    def identity(self, path: str) -> tuple[int, ...] | None:
        return self.below.identity(path)

    def address(self, path: str) -> tuple[int, str]:
        with self.open(path) as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]
            return file.tell(), digest

    def create(self, path: str) -> BinaryIO:
        return self.below.create(path)

    @contextmanager
    def replaced(self, path: str) -> Iterator[BinaryIO]:
        folder, _, name = path.rpartition("/")
        draft = f"{folder}/.{name}.{uuid.uuid4().hex[:8]}.part"
        try:
            with self.create(draft) as file:
                yield file
            self.below.rename(draft, path)
        finally:
            self.below.remove(draft)

    def settle(self, folder: str) -> None:
        self.below.settle(folder)

    def publish(self, path: str, text: str) -> None:
        folder, _, name = path.rpartition("/")
        draft = f"{folder}/.{name}.{uuid.uuid4().hex}"
        try:
            self.below.write_new(draft, text.encode("utf-8"))
            _move_new(self.below, draft, path)
        except FileExistsError:
            found = "another writer has just published this version"
            raise TakenError(self.root / path, found, remedy="Run the command again.") from None
        finally:
            self.below.remove(draft)
        with contextlib.suppress(OSError):  # it is published; without sync a power cut could only undo it as a whole
            self.below.sync(folder)

    def claimed(self, folder: str) -> list[str]:
        return self.names(folder)

    def rename(self, path: str, to: str) -> None:
        self.below.rename(path, to)

    def weight(self, folder: str) -> tuple[int, float]:
        return self.below.weight(folder)

    def remove(self, path: str) -> None:
        self.below.remove(path)

    @contextmanager
    def lock(self, folder: str) -> Iterator[None]:
        from filelock import FileLock, Timeout

        place = self.root / folder
        with explained(place, "nothing was changed"):
            lock = FileLock(self.below.output(f"{folder}/{_LOCK}"), timeout=LOCK_WAIT_S)
            try:
                lock.acquire()
            except Timeout:
                remedy = "Wait for it, or end it."
                raise StoreError(place, f"locked by another process for {LOCK_WAIT_S:g} s", remedy=remedy) from None
        try:
            yield
        finally:
            lock.release()

    def unlock(self, folder: str) -> None:
        self.below.remove(f"{folder}/{_LOCK}")

    def is_locked(self, folder: str) -> bool:
        from filelock import FileLock, Timeout

        if self.below.kind(f"{folder}/{_LOCK}") != "file":
            return False
        lock = FileLock(self.below.path(f"{folder}/{_LOCK}"), timeout=0.0)
        try:
            lock.acquire()
        except Timeout:
            return True
        lock.release()
        return False


def _move_new(root: Root, draft: str, final: str) -> None:
    """Rename ``draft`` to ``final`` atomically; FileExistsError if that exists."""
    try:
        root.link(draft, final)  # unlike a rename it fails if ``final`` exists
    except OSError as error:
        if error.errno not in _NO_LINKS:
            raise
        if root.kind(final) is not None:  # a file system without hard links: only the lock separates writers
            raise FileExistsError(final) from None
        root.rename(draft, final)
