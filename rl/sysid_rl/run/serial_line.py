"""A device of this computer as a line: its path, the lock between runners, and other programs that have it open.

Each byte that a serial device receives goes to one reader. A second program that reads it takes parts of frames, or whole ones.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import stat
import tempfile
import threading
from pathlib import Path
from typing import TYPE_CHECKING

from sysid.errors import InputError

if TYPE_CHECKING:
    from filelock import BaseFileLock

#: Time between two searches for other programs during a run [s].
SEARCH_S = 1.0
#: Most programs that are named.
MOST = 3
_PROCESSES = Path("/proc")
#: Major numbers of the runner's end of pseudo-terminals (Linux, Documentation/admin-guide/devices.txt).
PSEUDO_TERMINALS = range(136, 144)


def split_channel(channel: str) -> tuple[str, int | None]:
    """Path of a device and its baud rate, from ``PATH`` or ``PATH@115200``. Links are resolved: they are one line."""
    path, at, rate = channel.rpartition("@")
    if not at or not rate.isdecimal() or os.path.exists(channel):
        path, rate = channel, ""
    return os.path.realpath(path) if "/" in path else path, int(rate) if rate else None


def device_channel(channel: str) -> str:
    """``channel`` as drivers of python-can take it: they would take an "@" in a path for a baud rate.

    Raises:
        ValueError: the device itself, without links, has one.
    """
    path, rate = split_channel(channel)
    if is_device(channel) and "@" in path:
        raise ValueError(f"drivers take the '@' in {path!r} for a baud rate")
    return path if rate is None else f"{path}@{rate}"


def is_device(channel: str) -> bool:
    """Whether ``channel`` is the path of a device, in contrast to the name of an interface."""
    return "/" in channel


def lock_channel(interface: str, channel: str, where: str) -> BaseFileLock:
    """Lock a line until the lock is released. Links to one device (``/dev/serial/by-id``) are one line.

    Raises:
        InputError: another process holds it, or the lock cannot be made.
    """
    from filelock import FileLock, Timeout

    # A device in /dev is locked by its path, whatever driver of python-can uses it.
    line = split_channel(channel)[0] if is_device(channel) else f"{interface}:{channel}"
    lock = FileLock(_lock_folder() / f"sysid-line-{hashlib.sha256(line.encode()).hexdigest()[:16]}.lock", mode=0o666)
    place = f"{where}: {channel or interface}"
    try:
        lock.acquire(timeout=0.0)
    except Timeout:
        expected = "one runner on a line"
        raise InputError(place, "another runner has this line", expected, "End it first: both would send commands.") from None
    except OSError as error:
        raise InputError(place, f"{lock.lock_file}: {error.strerror}", "a lock file that can be written") from None
    return lock


def _lock_folder() -> Path:
    """A folder that is the same for all users of this computer, independent of TMPDIR, if there is one."""
    for folder in (Path("/run/lock"), Path("/tmp")):
        if folder.is_dir() and os.access(folder, os.W_OK):
            return folder
    return Path(tempfile.gettempdir())


def other_programs(channel: str) -> list[str]:
    """Programs that have the device open, besides this one and the machine's end of a pseudo-terminal, as ``cat (process 12)``;
    at most :data:`MOST`.

    By the processes that this user may look into; none where the system has no ``/proc``.
    """
    try:
        device = os.stat(split_channel(channel)[0])
    except OSError:
        return []
    if not stat.S_ISCHR(device.st_mode):
        return []
    found: list[str] = []
    for process in _PROCESSES.glob("[0-9]*"):
        if int(process.name) == os.getpid() or len(found) == MOST:
            continue
        # A process ends while it is looked at, or belongs to somebody else.
        with contextlib.suppress(OSError):
            if _has_open(process, device.st_rdev):
                found.append(f"{(process / 'comm').read_text('utf-8', 'replace').strip()} (process {process.name})")
    return found


def _has_open(process: Path, device: int) -> bool:
    """Whether a process has the device open, and is not the other end of a pseudo-terminal."""
    held = False
    master = f"tty-index:\t{os.minor(device)}\n" if os.major(device) in PSEUDO_TERMINALS else None
    for handle in (process / "fd").iterdir():
        with contextlib.suppress(OSError):
            target = os.readlink(handle)
            if master and target.endswith("ptmx") and master in (process / "fdinfo" / handle.name).read_text():
                return False
            held = held or (target.startswith("/dev/") and os.stat(handle).st_rdev == device)
    return held


def require_alone(channel: str, where: str) -> None:
    """Raise InputError if another program has the device open."""
    if others := other_programs(channel):
        raise InputError(
            f"{where}: {channel}",
            f"{', '.join(others)} has this line open",
            "the runner alone on its line",
            "End it first: what it reads is missing here.",
        )


def claim(descriptor: int) -> None:
    """Keep other programs from opening the device while this one has it.

    Raises:
        OSError: a program has claimed it.
    """
    try:
        import fcntl
        import termios
    except ImportError:  # Windows opens a port once
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
            raise OSError(error.errno, "another program has claimed this line") from None
    # The machine's end keeps a pseudo-terminal open, which would stay claimed after this process.
    if not os.ttyname(descriptor).startswith("/dev/pts/"):
        with contextlib.suppress(OSError):
            fcntl.ioctl(descriptor, termios.TIOCEXCL)


class OtherReaders:
    """Searches for other programs on a line during a run, in a thread.

    Args:
        channel: of the line; one that is no device has any number of readers.
    """

    def __init__(self, channel: str) -> None:
        self._channel, self._searched_ns = channel, -(1 << 62)
        #: A sentence about those that were found, or "".
        self.text = ""

    def search(self, now_ns: int) -> None:
        """Begin to search, unless that was done within :data:`SEARCH_S`."""
        if not is_device(self._channel) or self.text or now_ns - self._searched_ns < SEARCH_S * 1e9:
            return
        self._searched_ns = now_ns
        threading.Thread(target=self._search, name="other readers", daemon=True).start()

    def _search(self) -> None:
        if others := other_programs(self._channel):
            self.text = f"{', '.join(others)} has the line open too, and takes frames of the machine"
