"""Errors that a user can cause; every message says where, what was found, what was expected, what to do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


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
