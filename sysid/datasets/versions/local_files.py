"""The files of a workspace in a local folder: a lock separates writers, a hard link publishes."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from sysid.datasets.versions.files import TakenError, explained
from sysid.errors import StoreError
from sysid.root import Root

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
