"""Python processes that this one starts: they import what this one would, never what lies in the current folder.

``python -m`` and ``python -c`` look for modules in the current folder first, and so do the processes of :mod:`multiprocessing`
before they take the path of their parent. A ``numpy.py`` beside somebody's logs would run. ``-P`` (``PYTHONSAFEPATH``,
Python 3.11) takes that folder out.
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
    """The environment of a Python process: this one's, and what keeps its own children safe too."""
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
