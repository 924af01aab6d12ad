"""NumPy archives (``.npz``): vectors and matrices of equal length, as MuJoCo's rollouts and time series are saved.

Columns of a matrix are reached by index: ``qpos[2]``; of a rollout, ``state[0]`` is the time and ``state[1]`` … the positions
(MuJoCo 4, ``mjSTATE_FULLPHYSICS``). A time series of ``mujoco.sysid`` names the columns of its ``data`` itself.
"""

from __future__ import annotations

import math
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError
from sysid.logs.limits import Budget
from sysid.logs.reader import ALL, ReadOptions, Stream
from sysid.logs.table import TIME_NAMES, Table, TableReader, TypedColumns, is_time, is_wanted, table_stream
from sysid.parse import parse_json

_WHAT, _MAPPING, _TIMES = "a NumPy archive", "signal_mapping", "times"
#: Longest header of an array, and longest text that names the columns [bytes].
_HEADER, _TEXT = 10_000, 1 << 20
#: Kinds of arrays without numbers.
_NO_NUMBERS = {"U": "text", "S": "text", "O": "pickled objects, which are never loaded", "c": "complex numbers"}


class NpzReader(TableReader):
    """Numbers only: pickled objects are never loaded."""

    name = "npz"
    suffixes = (".npz",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        table = self.table(path, options)
        if (
            options.time is None
            and options.rate_hz is None
            and _TIMES in table.headers
            and not {*TIME_NAMES} & {*table.headers}
        ):
            options = replace(options, time=_TIMES)
        kept = [(name, values) for name, values in table.columns if is_wanted(name, options, False) or values.dtype.kind == "M"]
        return (table_stream(path, replace(table, columns=kept), options, units_in_headers=False),)

    def table(self, path: Path, options: ReadOptions = ALL) -> Table:
        """Every column of the arrays of the most frequent length; others are named only."""
        budget = options.budget_of(path, _WHAT, None)
        try:
            arrays, mapping, unread = _arrays(path, budget)
        except (zipfile.BadZipFile, zlib.error, ArithmeticError, LookupError, TypeError, ValueError, OSError, EOFError,
                RuntimeError) as error:  # fmt: skip  # whatever a damaged archive causes
            raise InputError(path, f"not readable as {_WHAT} ({error})", "arrays of numbers, saved by numpy.savez") from None
        lengths = [len(array) for array in arrays.values()]
        usual = max(lengths, key=lambda length: (lengths.count(length), length), default=0)
        found: list[tuple[str, npt.NDArray[Any]]] = []
        for name, array in arrays.items():
            if len(array) == usual:
                found += _columns_of(name, array, mapping if name == "data" else {}, options)
        budget.check_columns(path, len(found))
        unread |= {name: f"{len(a)} rows instead of {usual}" for name, a in arrays.items() if len(a) != usual}
        return Table(found, (), unread, tuple(name for name, _ in found))


def _arrays(path: Path, budget: Budget) -> tuple[dict[str, npt.NDArray[Any]], Mapping[str, list[int]], dict[str, str]]:
    """Name → array (n,) or (n, k); the columns of ``data`` by name; and what other arrays are, which are not read."""
    mapping: dict[str, list[int]] = {}
    unread: dict[str, str] = {}
    with zipfile.ZipFile(path) as archive:
        members = [info for info in archive.infolist() if info.filename.endswith(".npy")]
        budget.check_columns(path, len(members), "arrays")
        budget.check_unpacked(path, sum(info.file_size for info in members))
        found: dict[str, npt.NDArray[Any]] = {}
        for info in members:
            name = info.filename.removesuffix(".npy")
            large = budget.too_large(info.compress_size, info.file_size, at_once=False)
            if large:
                raise InputError(path, f"{name} {large}", "an archive of its own size")
            with archive.open(info) as file:
                shape, kind = _header(file)
                if any(count < 0 for count in shape):
                    raise ValueError(f"{name} of shape {shape}")
                size = math.prod(shape) * kind.itemsize
                if size > info.file_size:
                    raise ValueError(f"{name} states {size} bytes and has {info.file_size}")
                if name == _MAPPING and kind.kind == "U" and not shape and size <= _TEXT:
                    mapping = _named(file.read(size).decode("utf-32-le"))
                if kind.kind not in "fiubmM":
                    unread[name] = _NO_NUMBERS.get(kind.kind, f"values of type {kind}")
                    continue
                shape = shape[1:] if len(shape) == 3 and shape[0] == 1 else shape
                if len(shape) not in (1, 2) or math.prod(shape) == 0:
                    unread[name] = f"an array of shape {shape}"
                    continue
                budget.check_numbers(path, math.prod(shape))
                found[name] = np.frombuffer(file.read(size), kind).reshape(shape)
    return found, mapping, unread


def _header(file: Any) -> tuple[tuple[int, ...], np.dtype[Any]]:
    version = np.lib.format.read_magic(file)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in readers:
        raise ValueError(f"arrays of format {version}")
    shape, fortran, kind = readers[version](file, max_header_size=_HEADER)
    if fortran and len(shape) > 1:
        raise ValueError("arrays in Fortran order; save them with numpy.ascontiguousarray")
    return shape, kind


def _named(text: str) -> dict[str, list[int]]:
    """Name → columns of ``data``, of a time series: ``{"hinge_qpos": [0, [3]]}``."""
    value = parse_json(text.rstrip("\0").encode("utf-8"))
    if not isinstance(value, dict):
        raise ValueError("the names of its columns are no table")
    pairs = ((str(name), entry[1]) for name, entry in value.items() if isinstance(entry, list) and len(entry) == 2)
    return {name: [int(k) for k in places] for name, places in pairs if isinstance(places, list)}


def _columns_of(name: str, array: npt.NDArray[Any], mapping: Mapping[str, list[int]], options: ReadOptions) -> TypedColumns:
    """The columns of an array by name, else by index; integers keep their 64 bits only where they may be the time."""
    if array.dtype.kind in "mM":
        array = array.astype(f"{array.dtype.kind}8[ns]")
    elif array.dtype.kind not in "iu" or not is_time(name, options):
        array = array.astype(np.float64)
    if array.ndim == 1:
        return [(name, array)]
    names = {k: f"{name}[{k}]" for k in range(array.shape[1])}
    for label, places in mapping.items():
        for i, k in enumerate(places):
            if k in names:
                names[k] = label if len(places) == 1 else f"{label}[{i}]"
    return [(label, array[:, k].copy()) for k, label in names.items()]
