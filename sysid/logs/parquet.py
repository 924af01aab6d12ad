"""Parquet: a plain table with a time column, headers as in CSV."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sysid.errors import InputError
from sysid.logs.limits import MAX_CELLS
from sysid.logs.reader import ReadOptions
from sysid.logs.stream import Stream
from sysid.logs.table import Columns, check_not_empty, table_stream


@dataclass(frozen=True)
class ParquetReader:
    """Numeric columns alone are read; nulls are missing values."""

    name: str = "parquet"
    suffixes: tuple[str, ...] = (".parquet",)
    clocks: tuple[str, ...] = ("time",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        columns, losses = self.columns(path)
        return (table_stream(path, columns, options, losses),)

    def columns(self, path: Path) -> tuple[Columns, tuple[str, ...]]:
        """Name → numbers of the numeric columns, in the order of the file."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        check_not_empty(path, "a Parquet file")
        columns = []
        try:
            with pq.ParquetFile(path) as file:
                cells = file.metadata.num_rows * file.metadata.num_columns
                if cells > MAX_CELLS:  # a few bytes can say so
                    raise InputError(path, f"{cells} cells", f"at most {MAX_CELLS}", "Export it in parts.")
            table = pq.read_table(path)
            for index, name in enumerate(table.column_names):
                kind = table.schema.field(index).type
                if pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind):
                    columns.append((name, table.column(index).cast(pa.float64()).to_numpy().astype(np.float64)))
        except (pa.ArrowException, OSError, ValueError, KeyError) as error:  # also names that are no text
            raise InputError(path, f"not readable as Parquet ({error})", "a Parquet file") from None
        return columns, ()
