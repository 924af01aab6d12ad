"""JSON: lists of records, ``{"entries": [{"timestamp": 0.01, "position": 0.2}, …]}``; every such list is one stream.

A recipe names the reader (``reader = "json"``), because most JSON files beside logs are not logs.
"""

from __future__ import annotations

import json as json_module
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sysid.errors import InputError
from sysid.logs.cells import CellColumn
from sysid.logs.layout import MAX_ELEMENTS
from sysid.logs.limits import Budget
from sysid.logs.reader import LogReader, ReadOptions, Stream
from sysid.logs.table import Table, is_time, table_stream

#: Character before a value → memory of the objects after it [B].
_OBJECT_BYTES = {b",": 72, b"[": 72, b"{": 256}


class JsonReader(LogReader):
    """Numbers, truth values and dates are fields; of inner records by dots (``motor.speed``), of lists by index (``q[2]``)."""

    name = "json"
    clocks = ("time",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        budget = options.budget_of(path, "a JSON file")
        lists = {name: records for name, records in _lists(path, _document(path, budget)).items() if options.wants(name)}
        if not lists:
            raise InputError(path, "no list of records", "a list of objects with numbers, by itself or under a key")
        budget.check_topics(path, len(lists), "lists of records")
        return tuple(_stream(path, name, records, options, budget) for name, records in lists.items())


def _document(path: Path, budget: Budget) -> Any:
    data = path.read_bytes()
    # Brackets and commas in texts count, too: an upper bound on the number of values, before any is allocated.
    needed = len(data) + sum(size * data.count(mark) for mark, size in _OBJECT_BYTES.items())
    if needed > budget.memory:
        found, expected = f"values that take {needed / 2**20:.0f} MiB", f"at most {budget.memory / 2**20:.0f} MiB"
        raise InputError(path, found, expected, "Export it in parts.")
    try:
        return json_module.loads(data)
    except (ValueError, RecursionError) as error:  # damaged text, unknown encoding, nested without end
        reason = " ".join(str(error).split())
        raise InputError(path, f"not readable as JSON ({reason})", "a JSON file with a list of records") from None


def _lists(path: Path, document: Any) -> dict[str, list[dict[str, Any]]]:
    """Name → records: the document itself under the file's stem, or every list of objects that it holds."""
    found = document if isinstance(document, dict) else {path.stem: document}
    return {
        name: value
        for name, value in found.items()
        if isinstance(value, list) and value and all(isinstance(record, dict) for record in value)
    }


def _stream(path: Path, name: str, records: list[dict[str, Any]], options: ReadOptions, budget: Budget) -> Stream:
    where = f"{path}: {name}"
    columns: dict[str, dict[int, Any]] = {}
    for row, record in enumerate(records):
        for field, value in _values(record, budget.depth):
            if field not in columns:
                budget.check_columns(where, len(columns) + 1, "fields")
                budget.check_numbers(where, (len(columns) + 1) * len(records))
                columns[field] = {}
            columns[field][row] = value
    if options.fields is not None:
        options = replace(options, columns=options.fields.get(name))
    tables = [_column(f"{where}: {field}", field, values, len(records), options, budget) for field, values in columns.items()]
    table = table_stream(path, Table.joined(tables), options, units_in_headers=False)
    return replace(table, name=name)


def _column(where: str, field: str, values: Mapping[int, Any], rows: int, options: ReadOptions, budget: Budget) -> Table:
    """One field of all records: numbers, or stamps and numbers in text; others are missing."""
    texts = {row: value for row, value in values.items() if isinstance(value, str)}
    if texts:
        cells = CellColumn(field, where, budget, options.decimal or ".", options.decimal is not None, rows)
        cells.take(pd.Series(values, dtype=object).reindex(range(rows)).map(_text, na_action="ignore"))
        return cells.table()
    if is_time(field, options) and len(values) == rows and all(type(v) is int and abs(v) < 2**63 for v in values.values()):
        return Table([(field, np.array(list(values.values()), dtype=np.int64))])
    numbers = np.full(rows, np.nan)
    numbers[list(values)] = [_float(value) for value in values.values()]
    return Table([(field, numbers)])


def _text(value: Any) -> str:
    return value if isinstance(value, str) else repr(_float(value))


def _values(record: Mapping[str, Any], depth: int, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Every number and text of a record with its path; null is a missing value."""
    for key, value in record.items():
        name = f"{prefix}{key}"
        if isinstance(value, str | bool | int | float):
            yield name, value
        elif isinstance(value, Mapping) and depth > 1:
            yield from _values(value, depth - 1, f"{name}.")
        elif isinstance(value, list) and len(value) <= MAX_ELEMENTS:
            for index, element in enumerate(value):
                if isinstance(element, str | bool | int | float):
                    yield f"{name}[{index}]", element


def _float(value: float) -> float:
    """As float64; a whole number beyond its range is infinite."""
    try:
        return float(value)
    except OverflowError:
        return float("inf") if value > 0 else float("-inf")
