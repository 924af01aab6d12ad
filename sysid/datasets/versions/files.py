"""The few file operations that the store needs, on a local folder and on an object store alike."""

from __future__ import annotations

import errno
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from sysid.errors import StorageError, StoreError


class TakenError(StoreError):
    """The file to be published is there already: another writer was first."""


class OvertakenError(StoreError):
    """Another version was stored since the newest one was read, which was to be added to."""


class Files(Protocol):
    """Paths are relative to the workspace and use ``/``; a link below it is refused with a StoreError."""

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

    def links(self, folder: str) -> list[str]:
        """Names of the links in ``folder``, sorted: neither files nor folders, and never followed."""
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


def scratch_folder(workspace: str | Path) -> Path:
    """Where scratch files lie while something is made for ``workspace``: beside it where it is local, on the same disk."""
    return Path(tempfile.gettempdir()) if "://" in str(workspace) else Path(workspace)


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
