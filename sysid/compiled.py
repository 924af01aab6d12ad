"""Numba decorators of the plant, its effects and recurrent networks, and the folder of the compiled code.

Functions in a loop are compiled without reference counting (Numba's ``_nrt=False``), which would take longer than the
mathematics. Such a function reads and writes its arguments and allocates no arrays. It is intermediate code until a kernel
contains it: machine code of every function by itself, which is never called, took a third of the compilation.

Numba reuses a cached function even when a step function that it inlined was edited. The folder of the cache is therefore
named by a hash of all sources of the compiled chain, and for functions of another folder of those beside them. Cached code is
a pickle: this is the only module that imports Numba.
"""

from __future__ import annotations

import functools
import gc
import hashlib
import os
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, Flags

from sysid.location import cache_home

_PACKAGE = Path(__file__).parent
#: Of which the published types lack options.
_njit: Any = numba.njit


def source_digest(beside: Path | None = None) -> str:
    """sha256 over the sources of all effects and the plant, and over how they are compiled.

    Args:
        beside: a folder with more sources, such as that of a controller, whose law takes constants from its tuning.
    """
    digest = hashlib.sha256(numba.__version__.encode() + Path(__file__).read_bytes())
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


class _Locator(_CacheLocator):
    """Finds compiled code by the sources that it was compiled from, in whichever working copy or installation they lie."""

    def __init__(self, function: Any, file: str) -> None:
        own = Path(file).parent
        chain = own in (_PACKAGE / "effects", _PACKAGE / "plant")
        self._folder = cache_folder(None if chain else own) / own.name
        self._lineno, self._py_file = function.__code__.co_firstlineno, file  # Numba's names

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return ""  # the folder is named by all sources

    def get_disambiguator(self) -> str:
        return str(self._lineno)

    @classmethod
    def from_function(cls, function: Any, file: str) -> _Locator | None:
        return cls(function, file) if os.path.exists(file) else None  # a cell of a notebook: as Numba does


class _Kept(CompileResultCacheImpl):
    _locator_classes: Any = (_Locator, *CompileResultCacheImpl._locator_classes)


class _Cache(FunctionCache):
    _impl_class = _Kept


def _cached(**options: Any) -> Callable[[Any], Any]:
    """``numba.njit`` with the cache of :func:`cache_folder`."""

    def decorate(function: Any) -> Any:
        cache: Any = _Cache
        result = _njit(no_cfunc_wrapper=True, pipeline_class=_Compiler, **options)(function)
        if result is not function:  # as it is where NUMBA_DISABLE_JIT is set
            result._cache = cache(function)
        return result

    return decorate


class _Flags(Flags):
    """Options of a compilation, compared by those that are set: Numba compares them for every operator and every template."""

    def __hash__(self) -> int:
        return hash(tuple(self._values))

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, _Flags) and self._values == other._values)


class _Compiler(Compiler):
    """Numba's compiler without what takes long beside the mathematics: comparing its options, and the search for garbage."""

    def compile_extra(self, func: Any) -> Any:
        whole: Any = super()
        options: Any = _Flags
        self.state.flags = options(self.state.flags)
        collects = gc.isenabled()
        gc.disable()  # a million objects stay until the end, and would be visited again and again
        try:
            return whole.compile_extra(func)
        finally:
            if collects:
                gc.enable()


class _PartLibrary(JITCodeLibrary):
    """Intermediate code of a part: optimised and made into machine code in kernels alone, into which it is linked."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0

    @property
    def codegen(self) -> Any:
        """What is told the function's environment, which is nowhere before the function is in a kernel."""
        return self

    def set_env(self, name: str, environment: Any) -> None:
        pass


class _PartCompiler(_Compiler):
    def define_pipelines(self) -> Any:
        whole: Any = super()
        library: Any = _PartLibrary
        self.state.library = library(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        return whole.define_pipelines()


class Part:
    """A function that kernels call; Python runs its source. It has no entry points from outside."""

    def __init__(self, function: Any, **options: Any) -> None:
        bare = {"_nrt": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        self._compiled = _njit(
            error_model="numpy", fastmath={"contract", "arcp"}, pipeline_class=_PartCompiler, **bare, **options
        )(function)
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
