"""A lock for each line, which the operating system releases when the process ends."""

from __future__ import annotations

import hashlib
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from sysid.errors import InputError

if TYPE_CHECKING:
    from filelock import BaseFileLock


def lock_channel(interface: str, channel: str, where: str) -> BaseFileLock:
    """Lock a line until the lock is released. Links to one device (``/dev/serial/by-id``) are one line.

    Raises:
        InputError: another process holds it, or the lock cannot be made.
    """
    from filelock import FileLock, Timeout

    # A device in /dev is locked by its path, whatever driver of python-can uses it.
    line = os.path.realpath(channel.partition("@")[0]) if "/" in channel else f"{interface}:{channel}"
    lock = FileLock(_folder() / f"sysid-line-{hashlib.sha256(line.encode()).hexdigest()[:16]}.lock", mode=0o666)
    place = f"{where}: {channel or interface}"
    try:
        lock.acquire(timeout=0.0)
    except Timeout:
        expected = "one runner on a line"
        raise InputError(place, "another runner has this line", expected, "End it first: both would send commands.") from None
    except OSError as error:
        raise InputError(place, f"{lock.lock_file}: {error.strerror}", "a lock file that can be written") from None
    return lock


def _folder() -> Path:
    """A folder that is the same for all users of this computer, independent of TMPDIR, if there is one."""
    for folder in (Path("/run/lock"), Path("/tmp")):
        if folder.is_dir() and os.access(folder, os.W_OK):
            return folder
    return Path(tempfile.gettempdir())
