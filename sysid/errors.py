"""Errors a user can cause. Every message says where, what was found, what was expected, what to do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class SysidError(Exception):
    """Root of all errors that the toolkit raises on purpose.

    Args:
        where: file, line, key or object the problem was met in.
        found: what stands there.
        expected: what should stand there (may be empty).
        remedy: what the user can do about it (may be empty).
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
        """So that it comes back whole from another process."""
        return type(self), (self.where, self.found, self.expected, self.remedy)


class InputError(SysidError):
    """A file that a user brought cannot be used as it is."""


class SettingsError(SysidError):
    """A key, value or name in a TOML file or on the command line is wrong."""


class AlignmentError(SysidError):
    """Two clocks cannot be aligned from what was recorded."""


class StoreError(SysidError):
    """A dataset or model version is missing, damaged or in use."""


class StorageError(StoreError):
    """The disk or object store under the workspace failed: full, read-only, out of reach. No mistake of the user."""


class ExcitationError(SysidError):
    """The data do not contain what a fit needs."""


def nearest(name: str, valid: Iterable[str]) -> str:
    """The valid names as text, the nearest one to ``name`` suggested first."""
    valid = sorted(valid)
    close = difflib.get_close_matches(name, valid, n=1)
    listed = ", ".join(valid) if valid else "none"
    return f"{close[0]!r}? (valid: {listed})" if close else f"one of: {listed}"
