"""The file operations of the store, on a local folder or an object store."""

from __future__ import annotations

import errno
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from sysid.errors import StorageError, StoreError

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
