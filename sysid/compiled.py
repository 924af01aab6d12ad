"""Numba decorators of the plant, its effects and recurrent networks, and the folder of the compiled code.

Functions in a loop are compiled without reference counting (Numba's ``_nrt=False``), which would take longer than the
mathematics. Such a function reads and writes its arguments and allocates no arrays.

Numba reuses a cached function even when a step function that it inlined was edited. The folder of the cache is therefore
named by a hash of all sources of the compiled chain, and for functions of another package of those beside them. Cached code is
a pickle: this is the only module that imports Numba.
"""

from __future__ import annotations

import functools
import hashlib
import os
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

from sysid.location import cache_home

_PACKAGE = Path(__file__).parent
#: Of which the published types lack options.
_njit: Any = numba.njit


def source_digest(beside: Path | None = None) -> str:
    """sha256 over the sources of all effects and the plant.

    Args:
        beside: a folder with more sources, such as that of a controller, whose law takes constants from its tuning.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    for folder in (_PACKAGE / "effects", _PACKAGE / "plant", *([] if beside is None else [beside])):
        for path in sorted(folder.glob("*.py")):
            digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


@functools.cache
def cache_folder(beside: Path | None = None) -> Path:
    """The folder for these sources, in ``NUMBA_CACHE_DIR`` if set; a temporary one, and a warning, if it cannot be written.

    Args:
        beside: see :func:`source_digest`.
    """
    root = Path(os.environ.get("NUMBA_CACHE_DIR", "") or cache_home() / "numba")
    folder = root / source_digest(beside)[:16]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        writable = os.access(folder, os.W_OK)
    except OSError:
        writable = False
    if not writable:
        folder = Path(tempfile.mkdtemp(prefix="sysid-numba-"))
        warnings.warn(f"{root} cannot be written: compiled code is kept in {folder} for this process only", stacklevel=2)
    return folder


def is_compiled() -> bool:
    """Whether an earlier process has compiled for these sources; the first one takes up to a minute more."""
    return any(cache_folder().rglob("*.nbi"))


def _cached(**options: Any) -> Callable[[Any], Any]:
    """``numba.njit`` with the cache of :func:`cache_folder`; the setting of other packages is restored."""

    def decorate(function: Any) -> Any:
        config: Any = numba.config
        own = Path(function.__code__.co_filename).parent
        folder = cache_folder(None if own.is_relative_to(_PACKAGE) else own)
        before, config.CACHE_DIR = config.CACHE_DIR, str(folder)
        try:
            return _njit(cache=True, no_cfunc_wrapper=True, **options)(function)
        finally:
            config.CACHE_DIR = before

    return decorate


class Part:
    """A function that kernels call; Python runs its source. Without entry points from outside it compiles in a fourth less."""

    def __init__(self, function: Any, **options: Any) -> None:
        bare = {"_nrt": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        self._compiled = _njit(error_model="numpy", fastmath={"contract", "arcp"}, **bare, **options)(function)
        self._numba_type_ = getattr(self._compiled, "_numba_type_", None)  # none where NUMBA_DISABLE_JIT is set
        self.py_func = function
        functools.update_wrapper(self, function)

    def __call__(self, *values: Any) -> Any:
        return self.py_func(*values)


def inlined(function: Any) -> Any:
    """A function that is called in every step, such as a step of an effect: inlined into its caller."""
    return Part(function, forceinline=True)


def loop(function: Any) -> Any:
    """A loop over samples or lanes, called from a :data:`kernel` that allocates its arrays."""
    return Part(function, nogil=True)


#: Entry point from Python: cached between processes, releases the interpreter lock.
kernel: Any = _cached(nogil=True, error_model="numpy")
#: A kernel whose sums may be reordered (vectorised).
summing: Any = _cached(nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
