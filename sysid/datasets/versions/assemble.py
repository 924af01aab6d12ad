"""Manifest and tables → the version in memory."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Dataset, Recording, Source
from sysid.datasets.versions.manifest import Manifest, clock_from
from sysid.errors import StoreError
from sysid.machine import machine_from_files
from sysid.scratch import filled, leave

if TYPE_CHECKING:
    import pyarrow as pa


def dataset_of(manifest: Manifest, samples: Mapping[int, Iterable[pa.RecordBatch]]) -> Dataset:
    """The version of ``manifest``.

    Args:
        samples: number of a part → the batches of its table, for every part with recordings: ``recording``, ``row``, ``time``
            and the signals, in any order.

    Raises:
        StoreError: a recording with missing rows.
    """
    wanted: dict[int, dict[Any, _Columns]] = {number: {} for number in samples}
    for item in manifest["recordings"]:
        wanted[item["part"]][item["key"]] = _Columns(item["rows"], ["time", *item["signals"]])
    for number, batches in samples.items():
        for batch in batches:
            _take(batch, wanted[number])
            leave()
    return Dataset(
        name=manifest["name"],
        version=manifest["version"],
        digest=manifest["digest"],
        machine=machine_from_files(manifest["machine"], f"dataset {manifest['name']}@{manifest['version']}"),
        recordings=tuple(
            _recording(item, wanted[item["part"]][item["key"]], manifest["units"]) for item in manifest["recordings"]
        ),
        units=manifest["units"],
        splits=manifest["splits"],
        sources=tuple(Source(**{**item, "losses": tuple(item["losses"])}) for item in manifest["sources"]),
        clocks=tuple(clock_from(item) for item in manifest["clocks"]),
        streams={stream: tuple(signals) for stream, signals in manifest["streams"].items()},
        quality=manifest["quality"],
    )


class _Columns:
    """The columns of one recording, each (rows,), while they are read."""

    def __init__(self, rows: int, names: Sequence[str]) -> None:
        self.values = {name: filled(rows, np.nan) for name in names}
        self.rows, self.found, self._sum = rows, 0, 0

    @property
    def are_complete(self) -> bool:
        """Whether every row was there, once."""
        return self.found == self.rows and self._sum == self.rows * (self.rows - 1) // 2

    def take(self, rows: npt.NDArray[np.int64], columns: Mapping[str, npt.NDArray[np.float64]]) -> None:
        """Values at ``rows``."""
        self.found += len(rows)
        self._sum += int(rows.sum())
        if rows.max() >= self.rows or rows.min() < 0:
            self._sum = -1  # more rows than the manifest states
            return
        first = int(rows[0])
        ordered = np.array_equal(rows, np.arange(first, first + len(rows)))
        for name, values in self.values.items():
            values[slice(first, first + len(rows)) if ordered else rows] = columns[name]


def _take(batch: pa.RecordBatch, wanted: Mapping[Any, _Columns]) -> None:
    """Hand the rows of a batch to their recordings; others are left out."""
    keys = batch["recording"].dictionary_encode()
    numbers, names = keys.indices.to_numpy(), keys.dictionary.to_pylist()
    rows = batch["row"].to_numpy()
    columns = {
        name: batch[name].to_numpy(zero_copy_only=False) for name in batch.schema.names if name not in ("recording", "row")
    }
    edges = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
    for first, last in pairwise(edges):
        own = wanted.get(names[numbers[first]]) if last > first else None
        if own is not None:
            own.take(rows[first:last], {name: values[first:last] for name, values in columns.items()})


def _recording(item: Mapping[str, Any], columns: _Columns, units: Mapping[str, str]) -> Recording:
    if not columns.are_complete:
        found, expected = f"{columns.found} rows", f"{item['rows']} rows"
        raise StoreError(f"recording {item['name']}", found, expected, "The table is damaged: ingest the logs again.")
    part = pd.DataFrame(columns.values, copy=False)
    part.attrs = {"units": {"time": "s", **{signal: units[signal] for signal in item["signals"]}}}
    return Recording(item["name"], part, item["rate_hz"], item["kind"], item["start_ns"])
