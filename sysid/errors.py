"""Errors that a user can cause; every message says where, what was found, what was expected, what to do.

Those of the disk: which file, what the system says, and what the user can do.
"""

from __future__ import annotations

import difflib
import errno
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path


class SysidError(Exception):
    """Base class of all errors that the toolkit raises on purpose.

    Args:
        where: file, line, key or object with the problem.
        found: what was found there.
        expected: what was expected (may be empty).
        remedy: what the user can do (may be empty).
    """

    def __init__(self, where: object, found: str, expected: str = "", remedy: str = "") -> None:
        self.where = str(where)
        self.found = found
        self.expected = expected
        self.remedy = remedy
        message = f"{self.where}: {found}"
        if expected:
            message += f"; expected {expected}"
        if remedy:
            message += f". {remedy}"
        super().__init__(message)

    def __reduce__(self) -> tuple[type[SysidError], tuple[str, str, str, str]]:
        """Keeps all fields when the error is passed between processes."""
        return type(self), (self.where, self.found, self.expected, self.remedy)


class InputError(SysidError):
    """A file of the user cannot be used as it is."""


class SettingsError(SysidError):
    """A key, value or name in a TOML file or on the command line is wrong."""


class UnknownDriveError(SettingsError):
    """A robot's file does not state how a joint is commanded: ``--kind`` does, or logs show it."""


class AlignmentError(SysidError):
    """Two clocks cannot be aligned from what was recorded."""


class StoreError(SysidError):
    """A dataset or model version is missing, damaged or in use."""


class StorageError(StoreError):
    """The disk or object store of the workspace failed (full, read-only, unreachable); not a mistake of the user."""


class ExcitationError(SysidError):
    """The data do not contain what a fit needs."""


def nearest(name: str, valid: Iterable[str]) -> str:
    """The valid names as text, the nearest one to ``name`` suggested first."""
    valid = sorted(valid)
    close = difflib.get_close_matches(name, valid, n=1)
    listed = ", ".join(valid) if valid else "none"
    return f"{close[0]!r}? (valid: {listed})" if close else f"one of: {listed}"


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
