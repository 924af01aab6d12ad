"""Child Python processes: they do not import modules from the current folder, and they end with their parent.

``python -m``, ``python -c`` and the processes of :mod:`multiprocessing` search the current folder first, so that a ``numpy.py``
beside a user's logs would be executed. ``-P`` (``PYTHONSAFEPATH``, Python 3.11) removes that folder from the path.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

SAFE_PATH = "PYTHONSAFEPATH"
_DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG


def python_command(*words: str) -> list[str]:
    """The command of a Python process."""
    return [sys.executable, "-P", *words]


def child_environment() -> dict[str, str]:
    """This process's environment, with the safe path also for the child's own children."""
    return {**os.environ, SAFE_PATH: "1"}


@contextmanager
def safe_children() -> Iterator[None]:
    """Processes that a library starts inside (:mod:`multiprocessing`) do not import from the current folder."""
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[SAFE_PATH]
        else:
            os.environ[SAFE_PATH] = before


def end_with_parent(parent: int) -> None:
    """In a worker process: it ends with its parent, and only the parent reacts to Ctrl-C, which a terminal sends to both.

    Args:
        parent: process id of the parent, which may have ended already.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def end_children() -> None:
    """Kill the child processes, except those in a session of their own, which are meant to outlive this one."""
    own = os.getsid(0)
    for child in _children():
        with contextlib.suppress(OSError):
            if os.getsid(child) == own:
                os.kill(child, signal.SIGKILL)


def _children() -> list[int]:
    """Process ids of the children of all threads; empty where the system does not list them."""
    found: list[int] = []
    with contextlib.suppress(OSError):
        for task in os.listdir("/proc/self/task"):
            with contextlib.suppress(OSError), open(f"/proc/self/task/{task}/children", encoding="ascii") as file:
                found += map(int, file.read().split())
    return found
