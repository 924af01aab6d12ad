"""Child Python processes that do not import modules from the current folder.

``python -m``, ``python -c`` and the processes of :mod:`multiprocessing` search the current folder first, so that a ``numpy.py``
beside a user's logs would be executed. ``-P`` (``PYTHONSAFEPATH``, Python 3.11) removes that folder from the path.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

SAFE_PATH = "PYTHONSAFEPATH"


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
