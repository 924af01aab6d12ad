"""Parquet: a plain table with a time column, headers as in CSV; timestamps, durations and times of the day are stamps."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import numpy.typing as npt

from sysid import scratch
from sysid.errors import InputError
from sysid.logs.limits import Budget
from sysid.logs.reader import ALL, ReadOptions, Stream
from sysid.logs.table import Table, TableReader, is_time, is_wanted, table_stream
from sysid.units import split_header

#: Rows of a row group in which an example of a text is sought.
_TRIED = 64


class ParquetReader(TableReader):
    """Numbers of any type, also decimal and in categories; nulls are missing values. Text, lists and records are not read."""

    name = "parquet"
    suffixes = (".parquet",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        return (table_stream(path, self.table(path, options), options),)

    def table(self, path: Path, options: ReadOptions = ALL) -> Table:
        budget = options.budget_of(path, "a Parquet file", None)
        with reading_parquet(path, "a Parquet file") as file:
            budget.check_columns(path, file.metadata.num_columns)
            kinds = {field.name: _kind(field.type) for field in file.schema_arrow}
            headers = tuple(name for name, kind in kinds.items() if kind)
            names = [n for n in headers if is_wanted(n, options) or (options.time is None and kinds[n] == "datetime64[ns]")]
            rows = file.metadata.num_rows  # a few bytes may claim any number
            budget.check_numbers(path, rows * len(names))
            columns = [(name, _values(file, name, kinds[name], rows, options)) for name in names]
            others = [field for field in file.schema_arrow if not kinds[field.name]]
            unread = {split_header(field.name)[0]: _unread(file, field, budget) for field in others}
        return Table(columns, (), unread, headers)


@contextmanager
def reading_parquet(path: Path, expected: str) -> Iterator[Any]:
    """The file, opened; whatever a damaged one causes, also names that are no text, is an error of the file.

    Raises:
        InputError: not readable.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            yield file
    except (pa.ArrowException, OSError, ValueError, KeyError) as error:
        raise InputError(path, f"not readable as Parquet ({error})", expected) from None


def _kind(kind: Any) -> str:
    """The type of NumPy in which a column is read; empty where it has no numbers."""
    from pyarrow import types

    kind = kind.value_type if types.is_dictionary(kind) else kind
    if types.is_timestamp(kind):
        return "datetime64[ns]"
    if types.is_time(kind) or types.is_duration(kind):
        return "timedelta64[ns]"
    if types.is_integer(kind):
        return "int64"
    return "float64" if types.is_floating(kind) or types.is_boolean(kind) or types.is_decimal(kind) else ""


def _values(file: Any, name: str, kind: str, rows: int, options: ReadOptions) -> npt.NDArray[Any]:
    """One column, row group by row group. Integers keep their 64 bits only where they may be the time."""
    import pyarrow as pa

    whole = kind == "int64" and is_time(split_header(name)[0], options)
    kind = kind if kind != "int64" or (whole and not _nulls(file, name)) else "float64"
    values, done = scratch.empty(rows, kind), 0
    for group in range(file.metadata.num_row_groups):
        column = file.read_row_group(group, [name]).column(name)
        if kind in ("int64", "float64"):
            part = column.cast(getattr(pa, kind)(), safe=kind == "int64").to_numpy()
        else:
            steps = pa.timestamp("ns") if kind == "datetime64[ns]" else pa.duration("ns")
            if pa.types.is_time(column.type):
                column = column.cast(pa.time64("ns")).cast(pa.int64())
            part = column.cast(steps).to_numpy()
        values[done : done + len(part)] = part
        done += len(part)
    if done != rows:
        raise ValueError(f"{done} rows instead of {rows}")
    return values


def _nulls(file: Any, name: str) -> bool:
    """Whether a column has a row without a value."""
    groups = range(file.metadata.num_row_groups)
    return any(file.read_row_group(group, [name]).column(name).null_count for group in groups)


def _unread(file: Any, field: Any, budget: Budget) -> str:
    """What a column has instead of numbers, with its first value where that is text."""
    from pyarrow import types

    kind = field.type.value_type if types.is_dictionary(field.type) else field.type
    if not (types.is_string(kind) or types.is_large_string(kind) or types.is_string_view(kind)):
        return f"values of type {field.type}"
    for number in range(file.metadata.num_row_groups):
        group = file.metadata.row_group(number)
        parts = [c for c in map(group.column, range(group.num_columns)) if c.path_in_schema == field.name]
        # Nothing else limits the size of a text; one row at a time, as rows may share a long one.
        if any(budget.too_large(part.total_compressed_size, part.total_uncompressed_size) for part in parts):
            break
        rows = (batch.column(0)[0].as_py() for batch in islice(file.iter_batches(1, [number], [field.name]), _TRIED))
        if (first := next(filter(None, rows), None)) is not None:
            return f"text, for example {first[:80]!r}"
    return "text"
