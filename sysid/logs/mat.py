"""MATLAB ``.mat`` files up to version 7: vectors of equal length become the columns of one stream.

Fields of structures are reached by dots (``log.position``), columns of a matrix by index (``q[2]``).
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError
from sysid.logs.limits import FREE, MAX_RATIO, MAX_TEXT, check_whole
from sysid.logs.reader import ReadOptions
from sysid.logs.stream import Stream
from sysid.logs.table import TIME_NAMES, Columns, table_stream

#: MAT-file type of an element that is packed with zlib ("MAT-File Format", MathWorks).
_PACKED = 15


@dataclass(frozen=True)
class MatReader:
    """Always used with a recipe: a MATLAB file does not say which variable is which signal."""

    name: str = "mat"
    suffixes: tuple[str, ...] = (".mat",)
    clocks: tuple[str, ...] = ("time",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        columns = list(_columns(self._arrays(path), options).items())
        return (table_stream(path, columns, options, units_in_headers=False),)

    def columns(self, path: Path) -> tuple[Columns, tuple[str, ...]]:
        """Variable → numbers: the vectors of the length that most have, and what is left out for another length."""
        vectors = {name: array for name, array in self._arrays(path).items() if array.ndim == 1}
        lengths = [len(array) for array in vectors.values()]
        usual = max(lengths, key=lambda length: (lengths.count(length), length), default=0)
        others = [name for name, array in vectors.items() if len(array) != usual]
        losses = (f"{path.name}: of another length: {', '.join(others)}",) if others else ()
        return [(name, array.astype(np.float64)) for name, array in vectors.items() if len(array) == usual], losses

    def _arrays(self, path: Path) -> dict[str, npt.NDArray[Any]]:
        """Every numeric array of the file by its path.

        Raises:
            InputError: not a MATLAB file of these versions, or variables that unpack to more than is read.
        """
        from scipy.io import loadmat
        from scipy.io.matlab import MatReadError

        check_whole(path, "a MATLAB file")
        _check_unpacked(path)
        try:
            variables = loadmat(path, simplify_cells=True)
        except NotImplementedError:
            raise InputError(
                path, "a MATLAB file of version 7.3 (HDF5)", "version 7 or older", "Save it again with `save(..., '-v7')`."
            ) from None
        except (MatReadError, ValueError, TypeError, EOFError) as error:
            raise InputError(path, f"not readable as a MATLAB file ({error})", "a .mat file of version 5 to 7") from None
        arrays: dict[str, npt.NDArray[Any]] = {}
        for name, value in variables.items():
            if not name.startswith("__"):
                _flatten(name, value, arrays)
        return arrays


def _check_unpacked(path: Path) -> None:
    """Refuse packed variables that unpack to more than is read, before they are unpacked into memory."""
    with path.open("rb") as file:
        head = file.read(128)
        if len(head) < 128 or head[126:128] not in (b"IM", b"MI") or head[124:126] not in (b"\x00\x01", b"\x01\x00"):
            return  # version 4, or no MATLAB file: nothing is packed
        order: Literal["little", "big"] = "little" if head[126:128] == b"IM" else "big"
        total = 0
        while len(tag := file.read(8)) == 8:
            kind, size = int.from_bytes(tag[:4], order), int.from_bytes(tag[4:], order)
            if kind != _PACKED:
                file.seek(size, 1)
                continue
            unpacker, left = zlib.decompressobj(), size
            while left > 0 and (packed := file.read(min(left, 2**16))):
                left -= len(packed)
                while packed:
                    try:
                        total += len(unpacker.decompress(packed, 2**20))
                    except zlib.error:
                        return  # the reader says what is wrong with it
                    packed = unpacker.unconsumed_tail
                    if total > min(MAX_TEXT, max(FREE, path.stat().st_size * MAX_RATIO)):
                        found = f"variables that unpack to more than {total / 2**20:.0f} MiB"
                        raise InputError(path, found, f"at most {MAX_RATIO} times the file's {path.stat().st_size} bytes")


def _flatten(name: str, value: Any, into: dict[str, npt.NDArray[Any]]) -> None:
    if isinstance(value, dict):
        for key, inner in value.items():
            _flatten(f"{name}.{key}", inner, into)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        into[name] = value


def _columns(arrays: dict[str, npt.NDArray[Any]], options: ReadOptions) -> dict[str, npt.NDArray[np.float64]]:
    """The vectors that are as long as the time vector; matrices with that many rows give one column each."""
    vectors = {name: array for name, array in arrays.items() if array.ndim == 1}
    time = options.time if options.time is not None else next((name for name in TIME_NAMES if name in vectors), None)
    if time is None or time not in vectors:
        return {name: array.astype(np.float64) for name, array in vectors.items()}  # table_stream says what is missing
    rows = len(vectors[time])
    columns = {name: array.astype(np.float64) for name, array in vectors.items() if len(array) == rows}
    for name, array in arrays.items():
        if array.ndim == 2 and rows in array.shape:
            table = array if array.shape[0] == rows else array.T
            columns |= {f"{name}[{i}]": table[:, i].astype(np.float64) for i in range(table.shape[1])}
    return columns
