"""The files of a workspace in a folder: a lock keeps writers apart, a hard link publishes."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import shutil
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from stat import S_ISREG
from typing import BinaryIO

from sysid.datasets.versions.files import TakenError, explained
from sysid.errors import StoreError
from sysid.files import make_folder, on_disk, write_through

#: How long a writer waits for another one [s].
LOCK_WAIT_S = 300.0
_NO_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)


@dataclass(frozen=True)
class LocalFiles:
    """A folder on this machine."""

    root: Path
    locks: bool = True

    def uri(self, path: str) -> str:
        return str((self.root / path).resolve())

    def names(self, folder: str) -> list[str]:
        place = self.root / folder
        return sorted(entry.name for entry in place.iterdir() if entry.is_file()) if place.is_dir() else []

    def folders(self, folder: str) -> list[str]:
        place = self.root / folder
        return sorted(entry.name for entry in place.iterdir() if entry.is_dir()) if place.is_dir() else []

    def read(self, path: str) -> bytes:
        return (self.root / path).read_bytes()

    def address(self, path: str) -> tuple[int, str]:
        with (self.root / path).open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
            return file.tell(), digest

    def create(self, path: str) -> BinaryIO:
        final = self.root / path
        make_folder(final.parent)
        return final.open("xb")

    def settle(self, folder: str) -> None:
        for place, _, names in os.walk(self.root / folder):
            for name in names:
                on_disk(Path(place) / name)
            on_disk(Path(place))
        on_disk((self.root / folder).parent)

    def publish(self, path: str, text: str) -> None:
        final = self.root / path
        make_folder(final.parent)
        draft = final.parent / f".{final.name}.{uuid.uuid4().hex}"
        try:
            write_through(draft, text.encode("utf-8"))
            _move_new(draft, final)
        except FileExistsError:
            raise TakenError(final, "another writer has just published this version", remedy="Run the command again.") from None
        finally:
            draft.unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # it is published; a power cut could take it back whole, nothing worse
            on_disk(final.parent)

    def claimed(self, folder: str) -> list[str]:
        return self.names(folder)

    def rename(self, path: str, to: str) -> None:
        (self.root / path).replace(self.root / to)
        on_disk((self.root / to).parent)

    def weight(self, folder: str) -> tuple[int, float]:
        states = [entry.stat() for entry in (self.root / folder, *(self.root / folder).rglob("*"))]
        size = sum(state.st_size for state in states if S_ISREG(state.st_mode))
        return size, time.time() - max(state.st_mtime for state in states)

    def remove(self, path: str) -> None:
        place = self.root / path
        if place.is_dir():
            shutil.rmtree(place)
        else:
            place.unlink(missing_ok=True)

    @contextmanager
    def lock(self, folder: str) -> Iterator[None]:
        from filelock import FileLock, Timeout

        place = self.root / folder
        with explained(place, "nothing was changed"):
            make_folder(place)
            lock = FileLock(place / ".lock", timeout=LOCK_WAIT_S)
            try:
                lock.acquire()
            except Timeout:
                remedy = "Wait for it, or end it."
                raise StoreError(place, f"locked by another process for {LOCK_WAIT_S:g} s", remedy=remedy) from None
        try:
            yield
        finally:
            lock.release()


def _move_new(draft: Path, final: Path) -> None:
    """``draft`` becomes ``final`` in one step, or FileExistsError."""
    try:
        os.link(draft, final)  # unlike a rename it fails where another writer was first
    except OSError as error:
        if error.errno not in _NO_LINKS:
            raise
        if final.exists():  # a file system without hard links: the lock alone keeps writers apart
            raise FileExistsError(final) from None
        draft.replace(final)
