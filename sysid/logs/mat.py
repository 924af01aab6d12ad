"""MATLAB ``.mat`` files up to version 7: vectors of equal length become the columns of one stream.

Fields of structures are reached by dots (``log.position``), columns of a matrix by index (``q[2]``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid import scratch
from sysid.errors import InputError
from sysid.logs.limits import Budget
from sysid.logs.mat_file import MatError, MatVariable, find_variables, read_variables
from sysid.logs.reader import ALL, ReadOptions, Stream
from sysid.logs.table import TIME_NAMES, Columns, Table, TypedColumns, is_time, is_wanted, table_stream

_WHAT = "a MATLAB file"


@dataclass(frozen=True)
class MatReader:
    """Always used with a recipe, because a MATLAB file does not state which variable is which signal."""

    name: str = "mat"
    suffixes: tuple[str, ...] = (".mat",)
    clocks: tuple[str, ...] = ("time",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        budget = options.budget_of(path, _WHAT, None)
        variables, unread = _variables(path, budget)
        chosen = _chosen(variables, options)
        rows = _rows(chosen, options)
        if rows is not None:
            unread |= {
                name: f"{_size(v)} numbers instead of {rows} rows" for name, v in variables.items() if rows not in v.shape
            }
        table = Table(_columns(path, chosen, rows, budget, options), (), unread)
        known = () if options.columns is None else tuple(variables)
        return (table_stream(path, table, options, units_in_headers=False, known=known),)

    def columns(self, path: Path, options: ReadOptions = ALL) -> tuple[Columns, tuple[str, ...]]:
        """Variable → numbers of the vectors of the most frequent length, and no losses."""
        budget = options.budget_of(path, _WHAT, None)
        vectors = {name: variable for name, variable in _variables(path, budget)[0].items() if len(variable.shape) == 1}
        usual = _usual_length(vectors)
        same = {name: variable for name, variable in vectors.items() if variable.count == usual}
        return [(name, _as_floats(array)) for name, array in _read(path, same, budget).items()], ()


def _variables(path: Path, budget: Budget) -> tuple[dict[str, MatVariable], dict[str, str]]:
    """Every numeric variable of the file by its path, and what the others are.

    Raises:
        InputError: not a MATLAB file of these versions, or variables that unpack to more than the budget.
    """
    with path.open("rb") as file:
        head = file.read(128)
    if head.startswith((b"\x89HDF", b"MATLAB 7.3")):
        remedy = "Save it again with `save(..., '-v7')`."
        raise InputError(path, "a MATLAB file of version 7.3 (HDF5)", "version 7 or older", remedy)
    try:
        return find_variables(path, budget)
    except MatError as error:
        raise _unreadable(path, error) from None


def _read(path: Path, variables: Mapping[str, MatVariable], budget: Budget) -> dict[str, npt.NDArray[Any]]:
    budget.check_numbers(path, sum(variable.count for variable in variables.values()))
    try:
        return read_variables(path, variables)
    except MatError as error:
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: MatError) -> InputError:
    return InputError(path, f"not readable as a MATLAB file ({error})", "a .mat file of version 4 to 7")


def _chosen(variables: Mapping[str, MatVariable], options: ReadOptions) -> dict[str, MatVariable]:
    """The variables that are wanted, as a whole or a column (``q[2]``), and those that may be the time."""
    if options.columns is None:
        return dict(variables)
    names = {*options.columns, *(name.rpartition("[")[0] for name in options.columns)}
    wanted = {name: variable for name, variable in variables.items() if name in names or is_wanted(name, options, False)}
    if options.rate_hz is not None and options.time is None:  # the number of rows follows from all of them
        return {**variables, **wanted}
    return wanted


def _rows(variables: Mapping[str, MatVariable], options: ReadOptions) -> int | None:
    """Number of rows of the table; None without a time vector."""
    vectors = {name: variable for name, variable in variables.items() if len(variable.shape) == 1}
    if options.rate_hz is not None and options.time is None:
        return _usual_length(vectors)
    time = options.time if options.time is not None else next((name for name in TIME_NAMES if name in vectors), None)
    return vectors[time].count if time in vectors else None


def _size(variable: MatVariable) -> str:
    return " × ".join(map(str, variable.shape))


def _usual_length(vectors: Mapping[str, MatVariable]) -> int:
    lengths = [variable.count for variable in vectors.values()]
    return max(lengths, key=lambda length: (lengths.count(length), length), default=0)


def _columns(
    path: Path, variables: Mapping[str, MatVariable], rows: int | None, budget: Budget, options: ReadOptions
) -> TypedColumns:
    """The vectors of the length of the time vector, and the columns of matrices with as many rows."""
    if rows is None:  # table_stream reports the missing time and the names
        return [(name, np.zeros(0)) for name, variable in variables.items() if len(variable.shape) == 1]
    vectors = {name: v for name, v in variables.items() if v.shape == (rows,)}
    matrices = {name: v for name, v in variables.items() if len(v.shape) == 2 and rows in v.shape}
    if options.columns is not None:
        wanted = {name.rpartition("[")[0] for name in options.columns}
        vectors = {name: v for name, v in vectors.items() if is_wanted(name, options, False)}
        matrices = {name: v for name, v in matrices.items() if name in wanted}
    columns: list[tuple[str, npt.NDArray[Any]]] = [
        (name, array if is_time(name, options) else _as_floats(array)) for name, array in _read(path, vectors, budget).items()
    ]
    for name, variable in matrices.items():
        array = _read(path, {name: variable}, budget)[name]
        table = array if array.shape[0] == rows else array.T
        budget.check_columns(f"{path}: {name}", table.shape[1])
        elements = [(f"{name}[{i}]", table[:, i]) for i in range(table.shape[1])]
        columns += [(label, _as_floats(values, copy=True)) for label, values in elements if is_wanted(label, options, False)]
    return columns


def _as_floats(values: npt.NDArray[Any], copy: bool = False) -> npt.NDArray[np.float64]:
    if values.dtype == np.float64 and not copy:
        return values
    floats: npt.NDArray[np.float64] = scratch.computed(len(values), lambda first, last: values[first:last])
    return floats
