"""Tasks of the tests: module-level, so that other processes can import them."""

from __future__ import annotations

import os
import resource
import signal
import time
from pathlib import Path

from sysid.errors import InputError
from sysid.progress import Progress


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


def reported(value: float, progress: Progress) -> float:
    """Reports half of its work, and waits until that was seen."""
    progress(0.5, f"half of {value:g}")
    time.sleep(0.6)
    return value


def endless(folder: str, value: float, progress: Progress) -> float:
    """Writes its process id, and does not end."""
    (Path(folder) / f"{value:g}.pid").write_text(str(os.getpid()))
    time.sleep(3600.0)
    return value


def starved(value: float) -> float:
    """Needs more memory than its process may have."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (2**32, before[1]))
    try:
        return value + len(bytearray(2**33))
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def stored(folder: str, value: float) -> float:
    """Takes a while, and stores its result; a stored one is used. Every computation leaves a line in ``computed``."""
    result = Path(folder) / f"{value:g}.result"
    if result.exists():
        return float(result.read_text())
    with (Path(folder) / "computed").open("a") as file:
        file.write(f"{value:g}\n")
    time.sleep(0.5)
    half = result.with_suffix(f".{os.getpid()}")
    half.write_text(str(2.0 * value))
    half.replace(result)
    return 2.0 * value


def recordings_of(location: str, reference: str) -> list[str]:
    """The names of the recordings of a dataset in a workspace."""
    from sysid.workspace import open_workspace

    return [recording.name for recording in open_workspace(location).dataset(reference).recordings]


def slow(seconds: float) -> float:
    time.sleep(seconds)
    return seconds
