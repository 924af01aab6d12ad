"""The few file operations that the store needs, on a local folder and on an object store alike."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import re
import shutil
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from stat import S_ISREG
from typing import Any, BinaryIO, Protocol, cast

from sysid.errors import StorageError, StoreError

#: How long a writer waits for another one [s].
LOCK_WAIT_S = 300.0
_NO_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)


class TakenError(StoreError):
    """The file to be published is there already: another writer was first."""


class Files(Protocol):
    """Paths are relative to the workspace and use ``/``."""

    @property
    def locks(self) -> bool:
        """Whether :meth:`lock` keeps writers of other processes apart; else every writer has to expect others."""
        ...

    def uri(self, path: str) -> str: ...

    def names(self, folder: str) -> list[str]:
        """Names of the files in ``folder``, sorted; empty where there is none."""
        ...

    def folders(self, folder: str) -> list[str]:
        """Names of the folders in ``folder``, sorted."""
        ...

    def read(self, path: str) -> bytes: ...

    def address(self, path: str) -> tuple[int, str]:
        """Size [bytes] and sha256 of a file."""
        ...

    def create(self, path: str) -> BinaryIO:
        """A new file to write bytes to; its folder is made."""
        ...

    def settle(self, folder: str) -> None:
        """Return when what was written to ``folder`` survives a power cut."""
        ...

    def publish(self, path: str, text: str) -> None:
        """Write a file that did not exist: whole, or not at all.

        Raises:
            TakenError: it exists, or another writer has claimed it.
        """
        ...

    def claimed(self, folder: str) -> list[str]:
        """Names in ``folder`` that a writer has claimed, published or not."""
        ...

    def rename(self, path: str, to: str) -> None:
        """Give a file another name; a process killed on the way leaves the old one, the new one, or both."""
        ...

    def weight(self, folder: str) -> tuple[int, float]:
        """Bytes below ``folder``, and seconds since the last of them was written."""
        ...

    def remove(self, path: str) -> None:
        """Remove a file, or a folder with all it holds, if it is there."""
        ...

    def lock(self, folder: str) -> Any:
        """A context that one writer at a time can enter."""
        ...


def open_files(workspace: str | Path) -> Files:
    """Files of a local workspace, or of an object store where ``workspace`` is a URL."""
    if "://" not in str(workspace):
        return LocalFiles(Path(workspace))
    return ObjectFiles(str(workspace).rstrip("/"))


@contextmanager
def explained(where: object, state: str) -> Iterator[None]:
    """What disks, object stores and Delta refuse, as a :class:`StorageError` that says how the store stands.

    Args:
        state: what is left of the work, for the message.
    """
    import pyarrow as pa
    from deltalake.exceptions import DeltaError

    try:
        yield
    except (OSError, DeltaError, pa.ArrowException) as error:
        number = error.errno if isinstance(error, OSError) else None
        told = re.search(r"os error (\d+)|errno (\d+)", str(error))
        if number is None and told:
            number = int(told[1] or told[2])
        found = os.strerror(number) if number else str(error).splitlines()[0]
        remedy = {
            errno.ENOSPC: "Make room on the disk and run the command again.",
            errno.EDQUOT: "Make room in your quota and run the command again.",
            errno.EROFS: "Versions that are there can be read; to write, name a workspace that may be written.",
            errno.EACCES: "Versions that are there can be read; to write, name a workspace that may be written.",
        }.get(number or 0, "Mend that and run the command again.")
        raise StorageError(where, f"cannot be written ({found}); {state}", remedy=remedy) from None


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
        final.parent.mkdir(parents=True, exist_ok=True)
        return final.open("xb")

    def settle(self, folder: str) -> None:
        for place, _, names in os.walk(self.root / folder):
            for name in names:
                _sync(Path(place) / name)
            _sync(Path(place))
        _sync((self.root / folder).parent)

    def publish(self, path: str, text: str) -> None:
        final = self.root / path
        final.parent.mkdir(parents=True, exist_ok=True)
        draft = final.parent / f".{final.name}.{uuid.uuid4().hex}"
        try:
            with draft.open("w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            _move_new(draft, final)
        except FileExistsError:
            raise TakenError(final, "another writer has just published this version", remedy="Run the command again.") from None
        finally:
            draft.unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # it is published; a power cut could take it back whole, nothing worse
            _sync(final.parent)

    def claimed(self, folder: str) -> list[str]:
        return self.names(folder)

    def rename(self, path: str, to: str) -> None:
        (self.root / path).replace(self.root / to)
        _sync((self.root / to).parent)

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
            place.mkdir(parents=True, exist_ok=True)
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


def _sync(path: Path) -> None:
    """Reach the disk: a file's content, or the names in a folder."""
    if os.name != "posix" and path.is_dir():
        return
    descriptor = os.open(path, os.O_RDONLY if os.name == "posix" else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@dataclass(frozen=True)
class ObjectFiles:
    """An object store. A put is atomic there, and nothing is locked: a number is claimed before it is published.

    The claim is the first commit of a Delta table of its own, which the object store accepts from one writer only (put if
    absent, also on S3). A writer that dies between claim and publication leaves a number that is never used.
    """

    url: str
    locks: bool = False

    def _open(self) -> tuple[Any, str]:
        from pyarrow.fs import FileSystem

        system, root = FileSystem.from_uri(self.url)
        return system, str(root).rstrip("/")

    def uri(self, path: str) -> str:
        return f"{self.url}/{path}"

    def _entries(self, folder: str, kind: str) -> list[str]:
        from pyarrow.fs import FileSelector

        system, root = self._open()
        selector = FileSelector(f"{root}/{folder}", allow_not_found=True)
        return sorted(entry.base_name for entry in system.get_file_info(selector) if entry.type.name == kind)

    def names(self, folder: str) -> list[str]:
        return self._entries(folder, "File")

    def folders(self, folder: str) -> list[str]:
        return self._entries(folder, "Directory")

    def read(self, path: str) -> bytes:
        system, root = self._open()
        with system.open_input_stream(f"{root}/{path}") as file:
            return bytes(file.read())

    def address(self, path: str) -> tuple[int, str]:
        system, root = self._open()
        digest, size = hashlib.sha256(), 0
        with system.open_input_stream(f"{root}/{path}") as file:
            while block := file.read(1 << 22):
                digest.update(block)
                size += len(block)
        return size, digest.hexdigest()

    def create(self, path: str) -> BinaryIO:
        system, root = self._open()
        system.create_dir(f"{root}/{path}".rpartition("/")[0], recursive=True)
        return cast("BinaryIO", system.open_output_stream(f"{root}/{path}"))

    def settle(self, folder: str) -> None:
        """A put has reached the store when it returns."""

    def publish(self, path: str, text: str) -> None:
        folder, _, name = path.rpartition("/")
        taken = TakenError(self.uri(path), "another writer has just published this version", remedy="Run the command again.")
        if name in self.names(folder) or not self._claim(_claim_of(path)):
            raise taken
        draft = f"{folder}/.{name}.{uuid.uuid4().hex}"
        with self.create(draft) as file:
            file.write(text.encode("utf-8"))
        system, root = self._open()
        system.move(f"{root}/{draft}", f"{root}/{path}")

    def _claim(self, folder: str) -> bool:
        """Whether this writer is the first; Delta's first commit of a table is written by one writer alone."""
        import pyarrow as pa
        from deltalake import DeltaTable, Schema
        from deltalake.exceptions import DeltaError

        token = uuid.uuid4().hex
        empty = Schema.from_arrow(pa.schema([pa.field("claim", pa.string())]))
        # That the table is there says the error; where it was made at the same moment, ours became its second commit.
        with contextlib.suppress(DeltaError):
            DeltaTable.create(self.uri(folder), empty, mode="error", description=token)
        return token.encode() in self.read(f"{folder}/_delta_log/{0:020d}.json")

    def claimed(self, folder: str) -> list[str]:
        parent, _, name = folder.rpartition("/")
        return sorted({*self.names(folder), *self.folders(f"{parent}/claims/{name}")})

    def rename(self, path: str, to: str) -> None:
        system, root = self._open()
        system.copy_file(f"{root}/{path}", f"{root}/{to}")
        system.delete_file(f"{root}/{path}")

    def weight(self, folder: str) -> tuple[int, float]:
        from pyarrow.fs import FileSelector

        system, root = self._open()
        entries = system.get_file_info(FileSelector(f"{root}/{folder}", recursive=True))
        last = max((entry.mtime.timestamp() for entry in entries if entry.mtime), default=0.0)
        return sum(entry.size or 0 for entry in entries), time.time() - last

    def remove(self, path: str) -> None:
        system, root = self._open()
        kind = system.get_file_info(f"{root}/{path}").type.name
        if kind == "Directory":
            system.delete_dir(f"{root}/{path}")
        elif kind == "File":
            system.delete_file(f"{root}/{path}")

    @contextmanager
    def lock(self, folder: str) -> Iterator[None]:
        """Nothing: numbers are claimed instead, and vacuum leaves what is young."""
        yield


def _claim_of(path: str) -> str:
    """``datasets/a/versions/000001.json`` → ``datasets/a/claims/versions/000001.json``."""
    parent, _, name = path.rpartition("/")
    above, _, folder = parent.rpartition("/")
    return f"{above}/claims/{folder}/{name}"
