"""Tasks of the tests: module-level, so that other processes can import them."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from sysid.errors import InputError


def doubled(value: float) -> float:
    return 2.0 * value


def refused(value: float) -> float:
    if value == 2.0:
        raise InputError("log.csv", "two", "another number", "Remove it.")
    return value


def process_of(value: float) -> int:
    return os.getpid()


def killed_once(folder: str, value: float) -> float:
    """Ends its process at the first call for a value."""
    mark = Path(folder) / str(value)
    if value == 1.0 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return value


def killed(value: float) -> float:
    os.kill(os.getpid(), signal.SIGKILL)
    return value
