"""Errors of the disk: which file, what the system says, and what the user can do."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sysid.errors import StorageError, SysidError

_AGAIN = "and run the command again."
#: Number of the error → what to do.
REMEDIES = {
    errno.ENOSPC: f"Make room on the disk {_AGAIN}",
    errno.EDQUOT: f"Make room in your quota {_AGAIN}",
    errno.EFBIG: f"Raise the limit of the size of a file (ulimit -f unlimited) {_AGAIN}",
    errno.EACCES: f"Change its permissions, or name another file or folder, {_AGAIN}",
    errno.EPERM: f"Change its permissions, or name another file or folder, {_AGAIN}",
    errno.EROFS: f"Name a file or folder on a disk that can be written {_AGAIN}",
    errno.EIO: f"Check the disk {_AGAIN}",
    errno.EMFILE: f"Raise the limit of open files (ulimit -n 4096) {_AGAIN}",
}
#: Bytes of a trial.
_TRIAL = 2**16


def storage_error(error: OSError, path: object = None) -> StorageError:
    """The error with its file and what to do about it.

    Args:
        path: of the file where the error does not name one.
    """
    where = error.filename if path is None else path
    found = error.strerror or str(error)
    return StorageError("disk" if where is None else where, found, remedy=REMEDIES.get(error.errno or 0, ""))


@contextmanager
def written_to(half: Path, path: Path) -> Iterator[None]:
    """Errors of the disk within as a :class:`StorageError` about ``path``, those that libraries do not name included.

    Args:
        half: the unfinished file, or folder of files, that becomes ``path``.

    Raises:
        StorageError: the disk is full, read-only or fails.
    """
    try:
        yield
    except SysidError:
        raise
    except OSError as error:
        named = None if error.filename is None else Path(os.fsdecode(error.filename))
        if error.errno is None or not (named is None or named == half or half in named.parents):
            raise
        raise storage_error(error, path) from None
    except Exception as error:
        if (refused := _refused(half)) is None:
            raise
        raise storage_error(refused, path) from error


def _refused(half: Path) -> OSError | None:
    """The error of the disk where it takes no more of an unfinished output; None where it does."""
    try:
        files = [path for path in (half, *half.rglob("*")) if path.is_file()]
        trial = max(files, key=lambda path: path.stat().st_size) if files else half / "trial" if half.is_dir() else half
        with trial.open("ab") as file:
            file.write(bytes(_TRIAL))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        return error
    return None
