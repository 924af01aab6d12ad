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
from sysid.logs.reader import ReadOptions
from sysid.logs.stream import Stream
from sysid.logs.table import TIME_NAMES, check_not_empty, table_stream


@dataclass(frozen=True)
class MatReader:
    """Always used with a recipe: a MATLAB file does not say which variable is which signal."""

    name: str = "mat"
    suffixes: tuple[str, ...] = (".mat",)
    clocks: tuple[str, ...] = ("time",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        from scipy.io import loadmat
        from scipy.io.matlab import MatReadError

        check_not_empty(path, "a MATLAB file")
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
        columns = list(_columns(arrays, options).items())
        return (table_stream(path, columns, options, units_in_headers=False),)


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
