"""Parquet: a plain table with a time column, headers as in CSV."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

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
                # Texts are not even unpacked: they may be as large as they like.
                table = file.read([field.name for field in file.schema_arrow if _is_number(field.type)])
            for name, values in zip(table.column_names, table.columns, strict=True):
                columns.append((name, values.cast(pa.float64()).to_numpy().astype(np.float64)))
        except (pa.ArrowException, OSError, ValueError, KeyError) as error:  # also names that are no text
            raise InputError(path, f"not readable as Parquet ({error})", "a Parquet file") from None
        return columns, ()


def _is_number(kind: Any) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind))
