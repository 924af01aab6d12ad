"""MATLAB ``.mat`` files up to version 7: vectors of equal length become the columns of one stream.

Fields of structures are reached by dots (``log.position``), columns of a matrix by index (``q[2]``).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError
from sysid.logs.limits import check_whole
from sysid.logs.mat_file import MatError, read_arrays
from sysid.logs.reader import ReadOptions
from sysid.logs.stream import Stream
from sysid.logs.table import TIME_NAMES, Columns, table_stream


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
        check_whole(path, "a MATLAB file")
        with path.open("rb") as file:
            head = file.read(128)
        if head.startswith((b"\x89HDF", b"MATLAB 7.3")):
            remedy = "Save it again with `save(..., '-v7')`."
            raise InputError(path, "a MATLAB file of version 7.3 (HDF5)", "version 7 or older", remedy)
        try:
            return read_arrays(path)
        except MatError as error:
            raise InputError(path, f"not readable as a MATLAB file ({error})", "a .mat file of version 4 to 7") from None


def _columns(arrays: dict[str, npt.NDArray[Any]], options: ReadOptions) -> dict[str, npt.NDArray[np.float64]]:
    """The vectors that are as long as the time vector; matrices with that many rows give one column each."""
    vectors = {name: array for name, array in arrays.items() if array.ndim == 1}
    if options.rate_hz is not None and options.time is None:
        lengths = [len(array) for array in vectors.values()]
        return _of_length(arrays, max(lengths, key=lambda n: (lengths.count(n), n), default=0))
    time = options.time if options.time is not None else next((name for name in TIME_NAMES if name in vectors), None)
    if time is None or time not in vectors:
        return {name: array.astype(np.float64) for name, array in vectors.items()}  # table_stream says what is missing
    return _of_length(arrays, len(vectors[time]))


def _of_length(arrays: dict[str, npt.NDArray[Any]], rows: int) -> dict[str, npt.NDArray[np.float64]]:
    """Vectors of ``rows`` elements, and the columns of matrices with so many rows."""
    vectors = {name: array for name, array in arrays.items() if array.ndim == 1}
    columns = {name: array.astype(np.float64) for name, array in vectors.items() if len(array) == rows}
    for name, array in arrays.items():
        if array.ndim == 2 and rows in array.shape:
            table = array if array.shape[0] == rows else array.T
            columns |= {f"{name}[{i}]": table[:, i].astype(np.float64) for i in range(table.shape[1])}
    return columns
