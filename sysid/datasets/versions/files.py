"""The file operations of the store: in a local folder a lock separates writers and a hard link publishes; in an object store,
which has no locks, a number is claimed before it is published.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import io
import os
import re
import tempfile
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, cast

from sysid.errors import StorageError, StoreError
from sysid.root import Kind as EntryKind
from sysid.root import Root

#: State of the store after a failed write, for the message of :func:`explained`.
UNCHANGED = "no version was made, existing ones are complete"


class TakenError(StoreError):
    """The file to be published exists: another writer was first."""


class OvertakenError(StoreError):
    """Another version was stored after the newest one was read for an append."""


def scratch_folder(workspace: str | Path) -> Path:
    """Folder of scratch files for ``workspace``: the workspace itself if local, so that they are on the same disk."""
    return Path(tempfile.gettempdir()) if "://" in str(workspace) else Path(workspace)


@contextmanager
def working_on(workspace: str | Path) -> Iterator[None]:
    """Large arrays lie in scratch files of ``workspace``; one thread, since for thousands of small systems more are slower."""
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    from sysid.scratch import scratch_in

    with threadpool_limits(limits=1), scratch_in(scratch_folder(workspace)):
        yield


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


class Listing:
    """Names in a folder, sorted; none where there is no such folder."""

    def entries(self, folder: str) -> dict[str, EntryKind]:
        """Name → kind of the entries."""
        raise NotImplementedError

    def names(self, folder: str) -> list[str]:
        """Of the files."""
        return [name for name, kind in self.entries(folder).items() if kind == "file"]

    def folders(self, folder: str) -> list[str]:
        """Of the folders."""
        return [name for name, kind in self.entries(folder).items() if kind == "folder"]

    def links(self, folder: str) -> list[str]:
        """Of the links: neither files nor folders, and never followed."""
        return [name for name, kind in self.entries(folder).items() if kind == "link"]


@dataclass(frozen=True)
class LocalFiles(Root, Listing):
    """A folder on this machine. Paths use ``/``; a link below the folder is refused with a StoreError.

    :class:`ObjectFiles` has the same operations.
    """

    #: Whether :meth:`lock` excludes writers of other processes.
    locks: ClassVar[bool] = True

    def uri(self, path: str) -> str:
        self.path(path)
        return str(self.folder.resolve() / path)

    def address(self, path: str) -> tuple[int, str]:
        """Size [bytes] and sha256 of a file."""
        with self.open(path) as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]
            return file.tell(), digest

    @contextmanager
    def replaced(self, path: str) -> Iterator[BinaryIO]:
        """A file to write bytes to, which appears at ``path`` when the block ends; an earlier one there is replaced."""
        folder, _, name = path.rpartition("/")
        draft = f"{folder}/.{name}.{uuid.uuid4().hex[:8]}.part"
        try:
            with self.create(draft) as file:
                yield file
            self.rename(draft, path)
        finally:
            self.remove(draft)

    def publish(self, path: str, text: str) -> None:
        """Write a new file atomically.

        Raises:
            TakenError: it exists, or another writer has claimed it.
        """
        folder, _, name = path.rpartition("/")
        draft = f"{folder}/.{name}.{uuid.uuid4().hex}"
        try:
            self.write_new(draft, text.encode("utf-8"))
            _move_new(self, draft, path)
        except FileExistsError:
            found = "another writer has just published this version"
            raise TakenError(self.folder / path, found, remedy="Run the command again.") from None
        finally:
            self.remove(draft)
        with contextlib.suppress(OSError):  # it is published; without sync a power cut could only undo it as a whole
            self.sync(folder)

    def claimed(self, folder: str) -> list[str]:
        """Names in ``folder`` that a writer has claimed, published or not."""
        return self.names(folder)

    @contextmanager
    def lock(self, folder: str, state: str = "nothing was changed") -> Iterator[None]:
        """One writer at a time; ``state``: as of :func:`explained`."""
        from filelock import FileLock, Timeout

        place = self.folder / folder
        with explained(place, state):
            self.make(folder)
            lock = FileLock(self.path(f"{folder}/{_LOCK}"), timeout=LOCK_WAIT_S)
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
        """Remove what :meth:`lock` left in a folder; called within it."""
        self.remove(f"{folder}/{_LOCK}")

    def is_locked(self, folder: str) -> bool:
        """Whether a writer is at work in ``folder``; without locks this is unknown, and False."""
        from filelock import FileLock, Timeout

        if self.kind(f"{folder}/{_LOCK}") != "file":
            return False
        lock = FileLock(self.path(f"{folder}/{_LOCK}"), timeout=0.0)
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


@dataclass(frozen=True)
class ObjectFiles(Listing):
    """An object store, in which a put is atomic.

    The claim of a number is the first commit of a Delta table, which the object store accepts from one writer only (put if
    absent, also on S3). The number of a writer that dies between claim and publication is never used.
    """

    url: str
    locks: ClassVar[bool] = False

    def _at(self, path: str) -> tuple[Any, str]:
        """The file system and ``path`` in it; links are refused in a folder that is used as object store (``file:///``)."""
        from pyarrow.fs import FileSystem

        system, root = FileSystem.from_uri(self.url)
        root = str(root).rstrip("/")
        if self._in_folder and Path(root).is_dir():
            Root(Path(root)).path(path)
        return system, f"{root}/{path}"

    @contextmanager
    def _answering(self) -> Iterator[None]:
        """Errors of a store that does not answer a read; FileNotFoundError stays what it is.

        Raises:
            StorageError: it cannot be reached, or refuses the request.
        """
        try:
            yield
        except FileNotFoundError:
            raise
        except OSError as error:
            remedy = (
                "Nothing was changed. Check address and credentials (AWS_ENDPOINT_URL, AWS_ACCESS_KEY_ID, …), then call again."
            )
            raise StorageError(
                self.url, f"does not answer ({_cause(error)})", "an object store that can be read", remedy
            ) from None

    @property
    def _in_folder(self) -> bool:
        return self.url.startswith("file:")

    def uri(self, path: str) -> str:
        return f"{self.url}/{path}"

    def entries(self, folder: str) -> dict[str, EntryKind]:
        from pyarrow.fs import FileSelector

        with self._answering():
            system, place = self._at(folder)
            selector = FileSelector(place, allow_not_found=True)
            try:
                entries = system.get_file_info(selector)
            except FileNotFoundError:  # another writer made the folder between two checks of Arrow
                entries = system.get_file_info(selector)
        kinds: dict[str, EntryKind] = {"File": "file", "Directory": "folder"}
        found = {entry.base_name: kinds[entry.type.name] for entry in entries if entry.type.name in kinds}
        if self._in_folder:  # in which there may be links
            found |= Root(Path(place)).entries("")
        return dict(sorted(found.items()))

    def read(self, path: str) -> bytes:
        with self._answering():
            system, place = self._at(path)
            with system.open_input_stream(place) as file:
                return bytes(file.read())

    def open(self, path: str) -> BinaryIO:
        return io.BytesIO(self.read(path))

    def identity(self, path: str) -> None:
        """None: asking for the state of a file takes as long as its content."""

    def address(self, path: str) -> tuple[int, str]:
        system, place = self._at(path)
        digest, size = hashlib.sha256(), 0
        with system.open_input_stream(place) as file:
            while block := file.read(1 << 22):
                digest.update(block)
                size += len(block)
        return size, digest.hexdigest()

    def create(self, path: str) -> BinaryIO:
        system, place = self._at(path)
        system.create_dir(place.rpartition("/")[0], recursive=True)
        return cast("BinaryIO", system.open_output_stream(place))

    @contextmanager
    def replaced(self, path: str) -> Iterator[BinaryIO]:
        with self.create(path) as file:  # a put is atomic
            yield file

    def settle(self, folder: str) -> None:
        """Nothing to do: a put has reached the store when it returns."""

    def publish(self, path: str, text: str) -> None:
        folder, _, name = path.rpartition("/")
        taken = TakenError(self.uri(path), "another writer has just published this version", remedy="Run the command again.")
        if name in self.names(folder) or not self._claim(_claim_of(path)):
            raise taken
        draft = f"{folder}/.{name}.{uuid.uuid4().hex}"
        with self.create(draft) as file:
            file.write(text.encode("utf-8"))
        system, place = self._at(path)
        system.move(self._at(draft)[1], place)

    def _claim(self, folder: str) -> bool:
        """Whether this writer is the first: Delta accepts the first commit of a table from one writer only."""
        import pyarrow as pa
        from deltalake import DeltaTable, Schema
        from deltalake.exceptions import DeltaError

        token = uuid.uuid4().hex
        empty = Schema.from_arrow(pa.schema([pa.field("claim", pa.string())]))
        # The error means that the table exists; if it was made at the same moment, ours became its second commit.
        with contextlib.suppress(DeltaError):
            DeltaTable.create(self.uri(folder), empty, mode="error", description=token)
        return token.encode() in self.read(f"{folder}/_delta_log/{0:020d}.json")

    def claimed(self, folder: str) -> list[str]:
        parent, _, name = folder.rpartition("/")
        return sorted({*self.names(folder), *self.folders(f"{parent}/claims/{name}")})

    def rename(self, path: str, to: str) -> None:
        system, place = self._at(path)
        system.copy_file(place, self._at(to)[1])
        system.delete_file(place)

    def weight(self, folder: str) -> tuple[int, float]:
        from pyarrow.fs import FileSelector

        system, place = self._at(folder)
        entries = system.get_file_info(FileSelector(place, recursive=True))
        last = max((entry.mtime.timestamp() for entry in entries if entry.mtime), default=0.0)
        return sum(entry.size or 0 for entry in entries), time.time() - last

    def remove(self, path: str) -> None:
        system, place = self._at(path)
        kind = system.get_file_info(place).type.name
        if kind == "Directory":
            system.delete_dir(place)
        elif kind == "File":
            system.delete_file(place)

    @contextmanager
    def lock(self, folder: str, state: str = "") -> Iterator[None]:
        """Does nothing: numbers are claimed instead, and vacuum keeps young tables."""
        yield

    def unlock(self, folder: str) -> None:
        """Nothing to do."""

    def is_locked(self, folder: str) -> bool:
        return False


def _cause(error: OSError) -> str:
    """The last part of a message of Arrow, which begins with the operation."""
    text = str(error).splitlines()[0] if str(error) else type(error).__name__
    return text.rpartition("Details: ")[2] or text


def _claim_of(path: str) -> str:
    """``datasets/a/versions/000001.json`` → ``datasets/a/claims/versions/000001.json``."""
    parent, _, name = path.rpartition("/")
    above, _, folder = parent.rpartition("/")
    return f"{above}/claims/{folder}/{name}"


Files = LocalFiles | ObjectFiles
