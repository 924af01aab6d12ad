"""Manifest and tables → the version in memory, and as one pandas table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.chunked import Array
from sysid.datasets.recording import Dataset, Recording, Role, Source
from sysid.datasets.versions.manifest import Manifest, clock_from
from sysid.errors import StoreError
from sysid.logs.topic_columns import GrowingArray
from sysid.machine import machine_from_files
from sysid.scratch import leave

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
        wanted[item["part"]][item["key"]] = _Columns(["time", *item["signals"]], item["rows"])
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


#: Largest room for rows that the manifest states, as a multiple of those that were found.
TRUSTED = 32


class _Columns:
    """The columns of one recording while they are read: as long as what was found, whatever the manifest states.

    Args:
        stated: number of rows in the manifest, for which there is room once a part of them was found.
    """

    def __init__(self, names: Sequence[str], stated: int) -> None:
        self.found, self._stated = 0, stated  # number of rows until now, and in all
        self._unordered: list[npt.NDArray[np.int64]] | None = None  # numbers of all rows, once one was not the next
        self._values = {name: GrowingArray(np.nan) for name in names}

    def take(self, rows: npt.NDArray[np.int64], columns: Mapping[str, Array]) -> None:
        """Values at ``rows``."""
        if self._unordered is None and not np.array_equal(rows, np.arange(self.found, self.found + len(rows))):
            self._unordered = [np.arange(self.found)]
        if self._unordered is not None:
            self._unordered.append(rows)
        self.found += len(rows)
        for name, values in self._values.items():
            values.expected = min(self._stated, TRUSTED * self.found)
            values.extend(columns[name])

    def whole(self) -> dict[str, Array] | None:
        """The columns in the order of the rows; None unless every row was there once."""
        columns = {name: values.whole(self.found) for name, values in self._values.items()}
        if self._unordered is None:
            return columns
        rows = np.concatenate(self._unordered)
        order = np.argsort(rows, kind="stable")
        every = np.arange(self.found)
        return {name: values[order] for name, values in columns.items()} if np.array_equal(rows[order], every) else None


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
    values = columns.whole() if columns.found == item["rows"] else None
    if values is None:
        found, expected = f"{columns.found} rows", f"{item['rows']} rows"
        raise StoreError(f"recording {item['name']}", found, expected, "The table is damaged: ingest the logs again.")
    part = pd.DataFrame(values, copy=False)
    part.attrs = {"units": {"time": "s", **{signal: units[signal] for signal in item["signals"]}}}
    return Recording(item["name"], part, item["rate_hz"], item["kind"], item["start_ns"])


def frame_of(dataset: Dataset) -> pd.DataFrame:
    """All recordings of ``dataset``, one below the other.

    Returns:
        Columns ``recording`` and ``role`` (categories; poses have no role), ``time`` [s] since the recording's start, and one
        float64 column a signal, NaN where a recording does not have it. ``attrs``: ``units`` (column → SI unit), ``dataset``
        (``name@version``) and ``digest``.
    """
    names = [recording.name for recording in dataset.recordings]
    numbers = np.repeat(np.arange(len(names)), [len(recording) for recording in dataset.recordings])
    codes = np.array([get_args(Role).index(dataset.splits[name]) if name in dataset.splits else -1 for name in names])
    table = pd.concat([recording.table for recording in dataset.recordings], ignore_index=True)
    columns: dict[str, object] = {
        "recording": pd.Categorical.from_codes(numbers, dtype=pd.CategoricalDtype(names)),
        "role": pd.Categorical.from_codes(codes[numbers], dtype=pd.CategoricalDtype(list(get_args(Role)))),
    }
    frame = pd.concat([pd.DataFrame(columns), table], axis=1)
    units = {column: unit for column, unit in dataset.units.items() if column in frame.columns}
    frame.attrs = {"units": units, "dataset": dataset.reference, "digest": dataset.digest}
    return frame
