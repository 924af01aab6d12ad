"""Cache folder of the compiled code.

Numba reuses a cached function even when a step function that it inlined was edited. The cache folder is therefore
named by a hash of all sources of the compiled chain. Imported before anything that compiles.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
import warnings
from pathlib import Path

import numba

_PACKAGE = Path(__file__).parents[1]


def source_digest() -> str:
    """sha256 over the sources of all effects, the plant, and the controller, whose law takes constants from its tuning."""
    digest = hashlib.sha256(numba.__version__.encode())
    for folder in ("effects", "plant", "control"):
        for path in sorted((_PACKAGE / folder).glob("*.py")):
            digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def use_cache_folder() -> Path:
    """Set Numba's cache to a folder for these sources; a temporary one, with a warning, where none can be written."""
    root = Path(os.environ.get("XDG_CACHE_HOME", "") or Path.home() / ".cache")
    folder = root / "sysid" / "numba" / source_digest()[:16]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        writable = os.access(folder, os.W_OK)
    except OSError:
        writable = False
    if not writable:
        folder = Path(tempfile.mkdtemp(prefix="sysid-numba-"))
        warnings.warn(f"{root} cannot be written: compiled code is kept in {folder} for this process only", stacklevel=2)
    numba.config.CACHE_DIR = str(folder)  # type: ignore[attr-defined, unused-ignore]
    return folder


CACHE_FOLDER = use_cache_folder()


def is_compiled() -> bool:
    """Whether an earlier process has compiled for these sources; the first one takes up to a minute more."""
    return any(CACHE_FOLDER.rglob("*.nbi"))
