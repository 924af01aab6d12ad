"""JSON: lists of records, ``{"entries": [{"timestamp": 0.01, "position": 0.2}, …]}``; every such list is one stream.

A recipe names the reader (``reader = "json"``), because most JSON files beside logs are not logs.
"""

from __future__ import annotations

import json as json_module
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError
from sysid.logs.layout import MAX_ELEMENTS
from sysid.logs.limits import Budget
from sysid.logs.reader import ReadOptions
from sysid.logs.stream import Stream
from sysid.logs.table import table_stream

#: Character before a value → memory of the objects after it [B].
_OBJECT_BYTES = {b",": 72, b"[": 72, b"{": 256}


@dataclass(frozen=True)
class JsonReader:
    """Numbers and truth values are fields; of nested records by dots (``motor.speed``), of arrays by index (``q[2]``)."""

    name: str = "json"
    suffixes: tuple[str, ...] = ()
    clocks: tuple[str, ...] = ("time",)

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
    columns: dict[str, npt.NDArray[np.float64]] = {}
    for row, record in enumerate(records):
        for field, value in _numbers(record, budget.depth):
            if field not in columns:
                budget.check_columns(f"{path}: {name}", len(columns) + 1, "fields")
                budget.check_numbers(f"{path}: {name}", (len(columns) + 1) * len(records))
                columns[field] = np.full(len(records), np.nan)
            columns[field][row] = value
    table = table_stream(path, list(columns.items()), options, units_in_headers=False)
    return Stream(name, path, table.stamps, table.columns, table.units, table.losses)


def _numbers(record: Mapping[str, Any], depth: int, prefix: str = "") -> Iterator[tuple[str, float]]:
    """Every number of a record with its path; null is a missing value, text is no field."""
    for key, value in record.items():
        name = f"{prefix}{key}"
        if isinstance(value, bool | int | float):
            yield name, _float(value)
        elif isinstance(value, Mapping) and depth > 1:
            yield from _numbers(value, depth - 1, f"{name}.")
        elif isinstance(value, list) and len(value) <= MAX_ELEMENTS:
            for index, element in enumerate(value):
                if isinstance(element, bool | int | float):
                    yield f"{name}[{index}]", _float(element)


def _float(value: float) -> float:
    """As float64; a whole number beyond its range is infinite."""
    try:
        return float(value)
    except OverflowError:
        return float("inf") if value > 0 else float("-inf")
