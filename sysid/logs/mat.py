"""MATLAB ``.mat`` files up to version 7: vectors of equal length become the columns of one stream.

Fields of structures are reached by dots (``log.position``), columns of a matrix by index (``q[2]``). Texts, cells, sparse
matrices, objects, arrays of structures and complex numbers are named only.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping, MutableMapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid import scratch
from sysid.errors import InputError
from sysid.logs.limits import Budget
from sysid.logs.reader import ALL, ReadOptions, Stream
from sysid.logs.table import TIME_NAMES, Table, TableReader, TypedColumns, is_time, is_wanted, table_stream

_WHAT = "a MATLAB file"
#: Classes of variables as SciPy names them, of numbers and others.
_NUMERIC = ("double", "single", "logical", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
_OTHERS = {
    "char": "text", "cell": "a cell array", "object": "an object", "sparse": "a sparse matrix", "function": "a function",
    "opaque": "an object, such as datetime or table",
}  # fmt: skip
_COMPLEX = "complex numbers"


@dataclass(frozen=True)
class MatVariable:
    """Shape of a numeric variable without dimensions of one, and its numbers where it is a field of a structure."""

    shape: tuple[int, ...]
    numbers: npt.NDArray[Any] | None = None

    @property
    def count(self) -> int:
        return math.prod(self.shape)


class MatReader(TableReader):
    """Always used with a recipe, because a MATLAB file does not state which variable is which signal."""

    name = "mat"
    suffixes = (".mat",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        budget = options.budget_of(path, _WHAT, None)
        variables, unread = find_variables(path, budget)
        chosen = _chosen(variables, options)
        rows = _rows(chosen, options)
        if rows is not None:
            others = {name: " × ".join(map(str, v.shape)) for name, v in variables.items() if rows not in v.shape}
            unread |= {name: f"{size} numbers instead of {rows} rows" for name, size in others.items()}
        table = Table(_columns(path, chosen, rows, budget, options, unread), (), unread, tuple(variables))
        return (table_stream(path, table, options, units_in_headers=False),)

    def table(self, path: Path, options: ReadOptions = ALL) -> Table:
        """The vectors of the most frequent length."""
        budget = options.budget_of(path, _WHAT, None)
        vectors = {name: variable for name, variable in find_variables(path, budget)[0].items() if len(variable.shape) == 1}
        usual = _usual_length(vectors)
        same = {name: variable for name, variable in vectors.items() if variable.count == usual}
        return Table([(name, _as_floats(array)) for name, array in read_variables(path, same, budget, {}).items()])


def find_variables(path: Path, budget: Budget) -> tuple[dict[str, MatVariable], dict[str, str]]:
    """Every numeric variable of the file, or ``structure.field``, and what the others are.

    Raises:
        InputError: not a MATLAB file of these versions, or damaged.
    """
    from scipy.io import loadmat, whosmat

    with path.open("rb") as file:
        head = file.read(128)
    if head.startswith((b"\x89HDF", b"MATLAB 7.3")):
        remedy = "Save it again with `save(..., '-v7')`."
        raise InputError(path, "a MATLAB file of version 7.3 (HDF5)", "version 7 or older", remedy)
    found: dict[str, MatVariable] = {}
    others: dict[str, str] = {}
    with _reading(path):
        listed = whosmat(path)
        structures = [name for name, _, kind in listed if kind == "struct"]
        fields = loadmat(path, variable_names=structures) if structures else {}
        for name, shape, kind in listed:
            if kind == "struct":
                _find_fields(name, fields[name], found, others)
            elif kind not in _NUMERIC:
                others[name] = _OTHERS.get(kind, f"a variable of class {kind}")
            elif min(shape, default=0) < 0:
                raise ValueError(f"{name}: a size of {' × '.join(map(str, shape))}")
            elif squeezed := tuple(size for size in shape if size != 1):
                found[name] = MatVariable(squeezed)
    budget.check_columns(path, len(found), "variables")
    return found, others


def _find_fields(name: str, value: Any, found: MutableMapping[str, MatVariable], others: MutableMapping[str, str]) -> None:
    """Note the numbers in a structure, at any depth, and what its other fields are."""
    from scipy.io.matlab import MatlabFunction, MatlabObject, MatlabOpaque
    from scipy.sparse import issparse

    classes = {MatlabObject: "object", MatlabFunction: "function", MatlabOpaque: "opaque"}
    kind = next((kind for made, kind in classes.items() if isinstance(value, made)), "sparse" if issparse(value) else "")
    if kind:
        others[name] = _OTHERS[kind]
    elif value.dtype.names is not None and value.size != 1:
        others[name] = "an array of structures"
    elif value.dtype.names is not None:
        for field in value.dtype.names:
            _find_fields(f"{name}.{field}", value.reshape(-1)[0][field], found, others)
    elif value.dtype.kind not in "biuf":
        others[name] = {"O": _OTHERS["cell"], "c": _COMPLEX}.get(value.dtype.kind, _OTHERS["char"])
    elif value.size != 1:
        found[name] = MatVariable(value.squeeze().shape, value.squeeze())


def read_variables(
    path: Path, variables: Mapping[str, MatVariable], budget: Budget, unread: MutableMapping[str, str]
) -> dict[str, npt.NDArray[Any]]:
    """The numbers of ``variables`` in their stored types; complex ones are noted in ``unread`` instead.

    Raises:
        InputError: more numbers than the budget has, or damage.
    """
    from scipy.io import loadmat

    budget.check_numbers(path, sum(variable.count for variable in variables.values()))
    with _reading(path):
        whole = [name for name, variable in variables.items() if variable.numbers is None]
        arrays = loadmat(path, variable_names=whole) if whole else {}
        found = {name: arrays[name].squeeze() if v.numbers is None else v.numbers for name, v in variables.items()}
    unread.update({name: _COMPLEX for name, array in found.items() if array.dtype.kind == "c"})
    return {name: array for name, array in found.items() if array.dtype.kind != "c"}


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Whatever SciPy raises on a damaged file is an error of the file."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # two variables of one name: the last counts
            yield
    except (InputError, MemoryError):
        raise
    except Exception as error:
        found = f"not readable as a MATLAB file ({type(error).__name__}: {error})"
        raise InputError(path, found, "a .mat file of version 4 to 7", "The file is damaged.") from None


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


def _usual_length(vectors: Mapping[str, MatVariable]) -> int:
    lengths = [variable.count for variable in vectors.values()]
    return max(lengths, key=lambda length: (lengths.count(length), length), default=0)


def _columns(
    path: Path,
    variables: Mapping[str, MatVariable],
    rows: int | None,
    budget: Budget,
    options: ReadOptions,
    unread: MutableMapping[str, str],
) -> TypedColumns:
    """The vectors of the length of the time vector, and the columns of matrices with as many rows; ``unread``: the others."""
    if rows is None:  # table_stream reports the missing time and the names
        return [(name, np.zeros(0)) for name, variable in variables.items() if len(variable.shape) == 1]
    vectors = {name: v for name, v in variables.items() if v.shape == (rows,)}
    matrices = {name: v for name, v in variables.items() if len(v.shape) == 2 and rows in v.shape}
    if options.columns is not None:
        wanted = {name.rpartition("[")[0] for name in options.columns}
        vectors = {name: v for name, v in vectors.items() if is_wanted(name, options, False)}
        matrices = {name: v for name, v in matrices.items() if name in wanted}
    columns: list[tuple[str, npt.NDArray[Any]]] = [
        (name, array if is_time(name, options) else _as_floats(array))
        for name, array in read_variables(path, vectors, budget, unread).items()
    ]
    for name, array in read_variables(path, matrices, budget, unread).items():
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
