"""Compilation of the inner loops, kept between processes.

Numba reuses a cached function even when a function that it inlined has been edited since. The folder of the cache is therefore
named by a hash of every source of the simulated test bench.
"""

from __future__ import annotations

import functools
import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


@functools.cache
def cache_folder() -> Path | None:
    """The folder for these sources; None where none can be written, and every process compiles for itself."""
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    root = Path(os.environ.get("XDG_CACHE_HOME", "") or Path.home() / ".cache")
    folder = root / "sysid" / "numba-bench" / digest.hexdigest()[:16]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


def compiled(function: F) -> F:
    """``numba.njit`` with the cache of :func:`cache_folder`; the setting of other packages is restored."""
    folder = cache_folder()
    before = numba.config.CACHE_DIR  # type: ignore[attr-defined, unused-ignore]
    numba.config.CACHE_DIR = str(folder or "")  # type: ignore[attr-defined, unused-ignore]
    try:
        result: Any = numba.njit(cache=folder is not None)(function)
    finally:
        numba.config.CACHE_DIR = before  # type: ignore[attr-defined, unused-ignore]
    return cast("F", result)
