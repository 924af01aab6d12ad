"""Atomic, durable writes of files, and values in the types of JSON."""

from __future__ import annotations

import glob
import json
import math
import os
import platform
import re
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sysid.errors import StorageError, written_to

#: Half of a pair of UTF-16, as Python decodes a byte of a file name that is no UTF-8.
_SURROGATE = re.compile("[\ud800-\udfff]")


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A path beside ``path`` to write to, which replaces ``path`` when the block ends without an error.

    The content is synced before it replaces ``path``: a power cut leaves the old content or the new one.

    Raises:
        StorageError: the disk is full, read-only or fails; the old content is unchanged.
    """
    half = path.with_name(f".{path.name}.{platform.node()}-{os.getpid()}-{uuid.uuid4().hex[:8]}.part")
    try:
        with written_to(half, path):
            yield half
            on_disk(half)
            half.replace(path)
    finally:
        half.unlink(missing_ok=True)


def _remove_leftovers(path: Path) -> None:
    """Remove what writers of ``path`` on this computer left beside it when they were killed."""
    for half in path.parent.glob(f".{glob.escape(path.name)}.{glob.escape(platform.node())}-*-*.part"):
        if not _is_running(int(half.name.rsplit("-", 2)[1])):
            half.unlink(missing_ok=True)


def _is_running(process: int) -> bool:
    if os.name != "posix":  # there, a signal of zero ends a process
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True


def on_disk(path: Path) -> None:
    """Sync a file's content, or the names in a folder, to the disk.

    A rename survives a power cut only after its folder is synced, which only POSIX systems offer.
    """
    if os.name != "posix" and path.is_dir():
        return
    descriptor = os.open(path, os.O_RDONLY if os.name == "posix" else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def make_folder(path: Path) -> None:
    """Make a folder and its missing parents, and sync their names to the disk."""
    absent = [folder for folder in (path, *path.parents) if not folder.exists()]
    for folder in reversed(absent):
        folder.mkdir(exist_ok=True)
        on_disk(folder.parent)


def write_durably(path: Path, content: bytes, what: str, remedy: str) -> None:
    """Replace ``path`` by ``content`` and sync it; a missing folder is made.

    Args:
        what, remedy: for the message.

    Raises:
        StorageError: the disk is full or fails; the old content is unchanged.
    """
    try:
        make_folder(path.parent)
        _remove_leftovers(path)
        with written_whole(path) as half:
            half.write_bytes(content)
        on_disk(path.parent)
    except (OSError, StorageError) as error:
        found = error.found if isinstance(error, StorageError) else error.strerror or str(error)
        raise StorageError(f"{what} {path}", found, f"room for {len(content)} bytes", remedy) from error


def json_text(value: Mapping[str, Any]) -> str:
    """``value`` as indented JSON with a newline at the end; NaN and infinity become null.

    Undecodable bytes of file names (unpaired surrogates) become escapes, since UTF-8 cannot hold them.
    """
    text = json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    return _SURROGATE.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def plain(value: Any) -> Any:
    """``value`` in the types of JSON: NumPy scalars and arrays, paths, tuples and mappings resolved, NaN and infinity None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(item) for item in value]
    if isinstance(value, float):  # before the test for `tolist`: numpy.float64 is a float
        return float(value) if math.isfinite(value) else None
    if isinstance(value, (bool, int, str)) or value is None:
        return value
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    return str(value)
