"""Parquet: a plain table with a time column, headers as in CSV."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid import scratch
from sysid.errors import InputError
from sysid.logs.reader import ALL, ReadOptions
from sysid.logs.stream import Stream
from sysid.logs.table import Columns, is_wanted, table_stream


@dataclass(frozen=True)
class ParquetReader:
    """Only numeric columns are read; nulls are missing values."""

    name: str = "parquet"
    suffixes: tuple[str, ...] = (".parquet",)
    clocks: tuple[str, ...] = ("time",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        columns, losses = self.columns(path, options)
        known = () if options.columns is None else _headers(path)
        return (table_stream(path, columns, options, losses, known=known),)

    def columns(self, path: Path, options: ReadOptions = ALL) -> tuple[Columns, tuple[str, ...]]:
        """Name → values of the wanted numeric columns, in the order of the file."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        budget = options.budget_of(path, "a Parquet file", None)
        try:
            with pq.ParquetFile(path) as file:
                budget.check_columns(path, file.metadata.num_columns)
                # Texts are not unpacked, because nothing limits their size.
                headers = [field.name for field in file.schema_arrow if _is_number(field.type)]
                names = [header for header in headers if is_wanted(header, options)]
                rows = file.metadata.num_rows  # a few bytes may claim any number
                budget.check_numbers(path, rows * len(names))
                columns = [(name, _numbers(file, name, rows)) for name in names]
        except (pa.ArrowException, OSError, ValueError, KeyError) as error:  # also names that are no text
            raise InputError(path, f"not readable as Parquet ({error})", "a Parquet file") from None
        return columns, ()


def _headers(path: Path) -> tuple[str, ...]:
    import pyarrow.parquet as pq

    return tuple(field.name for field in pq.read_schema(path) if _is_number(field.type))


def _numbers(file: Any, name: str, rows: int) -> npt.NDArray[np.float64]:
    """One column, row group by row group."""
    import pyarrow as pa

    numbers, done = scratch.empty(rows), 0
    for group in range(file.metadata.num_row_groups):
        table = file.read_row_group(group, [name])
        values = table.column(name).cast(pa.float64()).to_numpy()
        numbers[done : done + len(values)] = values
        done += len(values)
    if done != rows:
        raise ValueError(f"{done} rows instead of {rows}")
    return numbers


def _is_number(kind: Any) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind))
