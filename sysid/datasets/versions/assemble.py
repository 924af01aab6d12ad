"""Manifest and tables → the version in memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sysid.datasets.recording import Dataset, Recording, Source
from sysid.datasets.versions.manifest import Manifest, clock_from
from sysid.errors import StoreError
from sysid.machine import machine_from_files

if TYPE_CHECKING:
    import pyarrow as pa


def dataset_of(manifest: Manifest, samples: Mapping[int, pa.Table]) -> Dataset:
    """The version of ``manifest``; ``samples``: number of a part → its table, for every part with recordings.

    Raises:
        StoreError: a recording with missing rows.
    """
    reference = f"{manifest['name']}@{manifest['version']}"
    tables = {number: _rows_of(table) for number, table in samples.items()}
    recordings = tuple(_recording(item, tables[item["part"]], manifest["units"]) for item in manifest["recordings"])
    return Dataset(
        name=manifest["name"],
        version=manifest["version"],
        digest=manifest["digest"],
        machine=machine_from_files(manifest["machine"], f"dataset {reference}"),
        recordings=recordings,
        units=manifest["units"],
        splits=manifest["splits"],
        sources=tuple(Source(**{**item, "losses": tuple(item["losses"])}) for item in manifest["sources"]),
        clocks=tuple(clock_from(item) for item in manifest["clocks"]),
        streams={stream: tuple(signals) for stream, signals in manifest["streams"].items()},
        quality=manifest["quality"],
    )


@dataclass(frozen=True)
class _Rows:
    """Samples in the order of recording and row; ``places``: key of a recording → its first row, last + 1."""

    table: pa.Table
    places: Mapping[Any, tuple[int, int]]


def _rows_of(table: pa.Table) -> _Rows:
    keys = table["recording"].combine_chunks().dictionary_encode()
    numbers = keys.indices.to_numpy()
    rows = table["row"].to_numpy()
    order = np.lexsort((rows, numbers))
    if not np.array_equal(order, np.arange(len(order))):
        table, numbers = table.take(order), numbers[order]
    names = keys.dictionary.to_pylist()
    first = np.searchsorted(numbers, np.arange(len(names)), side="left")
    end = np.searchsorted(numbers, np.arange(len(names)), side="right")
    return _Rows(table, {name: (int(a), int(b)) for name, a, b in zip(names, first, end, strict=True)})


def _recording(item: Mapping[str, Any], rows: _Rows, units: Mapping[str, str]) -> Recording:
    first, end = rows.places.get(item["key"], (0, 0))
    if end - first != item["rows"]:
        found, expected = f"{end - first} rows", f"{item['rows']} rows"
        raise StoreError(f"recording {item['name']}", found, expected, "The table is damaged: ingest the logs again.")
    part: pd.DataFrame = rows.table.slice(first, end - first).select(["time", *item["signals"]]).to_pandas(ignore_metadata=True)
    part.attrs = {"units": {"time": "s", **{signal: units[signal] for signal in item["signals"]}}}
    return Recording(item["name"], part, item["rate_hz"], item["kind"], item["start_ns"])
