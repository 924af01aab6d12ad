"""Parquet: a plain table with a time column, headers as in CSV."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sysid.errors import InputError
from sysid.logs.reader import ReadOptions
from sysid.logs.stream import Stream
from sysid.logs.table import check_not_empty, table_stream


@dataclass(frozen=True)
class ParquetReader:
    """Numeric columns alone are read; nulls are missing values."""

    name: str = "parquet"
    suffixes: tuple[str, ...] = (".parquet",)
    clocks: tuple[str, ...] = ("time",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        import pyarrow as pa
        import pyarrow.parquet as pq

        check_not_empty(path, "a Parquet file")
        try:
            table = pq.read_table(path)
        except (pa.ArrowInvalid, OSError) as error:
            raise InputError(path, f"not readable as Parquet ({error})", "a Parquet file") from None
        columns = []
        for name in table.column_names:
            kind = table.schema.field(name).type
            if pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind):
                columns.append((name, table.column(name).cast(pa.float64()).to_numpy().astype(np.float64)))
        return (table_stream(path, columns, options),)
