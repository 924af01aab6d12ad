"""Dataset versions on disk or in an object store: Delta tables for samples and raw channels, one JSON manifest a version.

A version is visible when its manifest is: data are written first, the manifest last and atomically. Folders::

    datasets/<name>/data/<digest>/samples    Delta table: recording, row, stamp_ns, time, one column a signal
    datasets/<name>/data/<digest>/channels   Delta table: recording, source, domain, signal, stamp_ns, value (own clocks)
    datasets/<name>/versions/<number>.json   manifest: machine, units, splits, sources, clocks, quality, the two tables
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sysid.datasets.channel import Channel
from sysid.datasets.files import Files, open_files
from sysid.datasets.recording import ClockRecord, Dataset, Recording, Source
from sysid.errors import StoreError, nearest
from sysid.machine import machine_from_files

SCHEMA = 1


@dataclass(frozen=True)
class Entry:
    """One line of :meth:`Store.list`."""

    name: str
    version: int
    digest: str
    created: str
    machine: str
    recordings: int
    seconds: float

    @property
    def reference(self) -> str:
        return f"{self.name}@{self.version}"


@dataclass(frozen=True)
class Store:
    """The datasets of one workspace: a folder, or the URL of an object store (``s3://…``, ``gs://…``, ``file:///…``)."""

    workspace: str | Path

    @property
    def _files(self) -> Files:
        return open_files(self.workspace)

    def list(self) -> tuple[Entry, ...]:
        """All versions of all datasets, by name and number."""
        entries = []
        for name in self._files.folders("datasets"):
            for version in self._versions(name):
                entries.append(_entry(self._manifest(name, version)))
        return tuple(entries)

    def load(self, reference: str) -> Dataset:
        """``"name"`` (its newest version) or ``"name@3"``.

        Raises:
            StoreError: no such dataset or version, or its files are damaged.
        """
        manifest = self._find(reference)
        table = self._read_table(manifest, "samples")
        recordings = tuple(
            _recording(number, item, table, manifest["units"]) for number, item in enumerate(manifest["recordings"])
        )
        return Dataset(
            name=manifest["name"],
            version=manifest["version"],
            digest=manifest["digest"],
            machine=machine_from_files(manifest["machine"], f"dataset {reference}"),
            recordings=recordings,
            units=manifest["units"],
            splits=manifest["splits"],
            sources=tuple(Source(**{**item, "losses": tuple(item["losses"])}) for item in manifest["sources"]),
            clocks=tuple(_clock(item) for item in manifest["clocks"]),
            streams={stream: tuple(signals) for stream, signals in manifest.get("streams", {}).items()},
            quality=manifest["quality"],
        )

    def channels(self, reference: str) -> pd.DataFrame:
        """The raw channels of a version, each on its own clock: recording, source, domain, signal, primary, stamp_ns, value."""
        return self._read_table(self._find(reference), "channels")

    def find_digest(self, name: str, digest: str) -> int | None:
        """The version of ``name`` with this content, None where there is none."""
        for version in self._versions(name):
            if self._manifest(name, version)["digest"] == digest:
                return version
        return None

    def save(self, dataset: Dataset, channels: Mapping[str, Sequence[Channel]], recipe: str = "") -> Dataset:
        """Store ``dataset`` as the next version of its name; the same digest again returns the version that is there.

        Args:
            dataset: its ``version`` is ignored.
            channels: recording (before it was cut into blocks) → its raw channels.
            recipe: text of the recipe, kept with the version.
        """
        with self._files.lock(f"datasets/{dataset.name}"):
            known = self.find_digest(dataset.name, dataset.digest)
            if known is not None:
                return self.load(f"{dataset.name}@{known}")
            version = max(self._versions(dataset.name), default=0) + 1
            folder = f"datasets/{dataset.name}/data/{dataset.digest[:16]}"
            # What a killed ingest of the same content left behind was never visible.
            self._files.remove(folder)
            self._write_table(f"{folder}/samples", _samples(dataset))
            self._write_table(f"{folder}/channels", _channel_rows(channels))
            manifest = _to_manifest(dataset, version, folder, recipe)
            text = json.dumps(manifest, indent=1, allow_nan=False)
            self._files.publish(f"datasets/{dataset.name}/versions/{version:06d}.json", text)
        return dataclasses.replace(dataset, version=version)

    def _versions(self, name: str) -> Sequence[int]:
        names = self._files.names(f"datasets/{name}/versions")
        return sorted(int(file[:-5]) for file in names if file.endswith(".json") and file[:-5].isdigit())

    def _find(self, reference: str) -> dict[str, Any]:
        name, _, number = reference.partition("@")
        names = [folder for folder in self._files.folders("datasets") if self._versions(folder)]
        if name not in names:
            raise StoreError(f"workspace {self.workspace}", f"no dataset {name!r}", nearest(name, names), "Run `sysid ingest`.")
        versions = self._versions(name)
        if number and (not number.isdigit() or int(number) not in versions):
            listed = ", ".join(map(str, versions))
            raise StoreError(f"dataset {name}", f"no version {number!r}", f"one of: {listed}")
        return self._manifest(name, int(number) if number else versions[-1])

    def _manifest(self, name: str, version: int) -> dict[str, Any]:
        path = f"datasets/{name}/versions/{version:06d}.json"
        try:
            manifest: dict[str, Any] = json.loads(self._files.read(path))
        except ValueError as error:
            raise StoreError(path, f"damaged ({error})", "a manifest as it was written", "Ingest the logs again.") from None
        if manifest.get("schema") != SCHEMA:
            raise StoreError(path, f"schema {manifest.get('schema')}", f"schema {SCHEMA}", "Use the sysid that wrote it.")
        return manifest

    def _read_table(self, manifest: dict[str, Any], which: str) -> pd.DataFrame:
        from deltalake import DeltaTable
        from deltalake.exceptions import DeltaError, TableNotFoundError

        place = f"{manifest['name']}@{manifest['version']}: {which}"
        try:
            table = DeltaTable(self._files.uri(f"{manifest['folder']}/{which}"), version=0)
            frame: pd.DataFrame = table.to_pyarrow_table().to_pandas(ignore_metadata=True)
        except (TableNotFoundError, DeltaError, OSError) as error:
            raise StoreError(place, f"not readable ({error})", "the table as written", "Ingest the logs again.") from None
        return frame

    def _write_table(self, path: str, frame: pd.DataFrame) -> None:
        import pyarrow as pa
        from deltalake import write_deltalake

        table = pa.Table.from_pandas(frame, preserve_index=False)
        write_deltalake(self._files.uri(path), table, mode="overwrite")


def _samples(dataset: Dataset) -> pd.DataFrame:
    frames = []
    for number, recording in enumerate(dataset.recordings):
        table = recording.table
        stamps = recording.start_ns + np.rint(table["time"].to_numpy(dtype=np.float64) * 1e9).astype(np.int64)
        frame = pd.DataFrame({"recording": np.int32(number), "row": np.arange(len(table), dtype=np.int64), "stamp_ns": stamps})
        frames.append(pd.concat([frame, table.reset_index(drop=True)], axis=1))
    joined = pd.concat(frames, ignore_index=True)
    joined.attrs = {}
    return joined


def _channel_rows(channels: Mapping[str, Sequence[Channel]]) -> pd.DataFrame:
    frames = [
        pd.DataFrame(
            {
                "recording": recording,
                "source": channel.source,
                "domain": channel.domain,
                "signal": channel.signal,
                "primary": channel.primary,
                "stamp_ns": channel.stamps,
                "value": channel.values,  # noqa: PD011
            }
        )
        for recording, parts in channels.items()
        for channel in parts
    ]
    return pd.concat(frames, ignore_index=True)


def _to_manifest(dataset: Dataset, version: int, folder: str, recipe: str) -> dict[str, Any]:
    from datetime import UTC, datetime

    from sysid import __version__

    return {
        "schema": SCHEMA,
        "name": dataset.name,
        "version": version,
        "digest": dataset.digest,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "sysid": __version__,
        "folder": folder,
        "machine_name": dataset.machine.name,
        "machine": dataset.machine.files(),
        "recipe": recipe,
        "recordings": [
            {
                "name": r.name,
                "kind": r.kind,
                "rate_hz": r.rate_hz,
                "start_ns": r.start_ns,
                "rows": len(r),
                "signals": list(r.signals),
            }
            for r in dataset.recordings
        ],
        "units": dict(dataset.units),
        "splits": dict(dataset.splits),
        "sources": [dataclasses.asdict(source) for source in dataset.sources],
        "streams": {stream: list(signals) for stream, signals in dataset.streams.items()},
        "clocks": [_plain(dataclasses.asdict(clock)) for clock in dataset.clocks],
        "quality": _plain(dataset.quality),
    }


def _plain(value: Any) -> Any:
    """Mappings, tuples and NumPy numbers as JSON has them; NaN and infinity as None."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def _clock(item: dict[str, Any]) -> ClockRecord:
    values: dict[str, Any] = {key: float("nan") if value is None else value for key, value in item.items()}
    for key in ("offset_interval95", "skew_interval95"):
        low, high = (float("nan") if end is None else float(end) for end in item[key])
        values[key] = (low, high)
    values["used_signals"] = tuple(item["used_signals"])
    return ClockRecord(**values)


def _recording(number: int, item: dict[str, Any], table: pd.DataFrame, units: dict[str, str]) -> Recording:
    rows = table[table["recording"] == number].sort_values("row")
    if len(rows) != item["rows"]:
        found, expected = f"{len(rows)} rows", f"{item['rows']} rows"
        raise StoreError(f"recording {item['name']}", found, expected, "The table is damaged: ingest the logs again.")
    part = rows[["time", *item["signals"]]].reset_index(drop=True)
    part.attrs = {"units": {"time": "s", **{signal: units[signal] for signal in item["signals"]}}}
    return Recording(item["name"], part, item["rate_hz"], item["kind"], item["start_ns"])


def _entry(manifest: dict[str, Any]) -> Entry:
    motion = [item for item in manifest["recordings"] if item["kind"] == "motion"]
    return Entry(
        name=manifest["name"],
        version=manifest["version"],
        digest=manifest["digest"],
        created=manifest["created"],
        machine=manifest["machine_name"],
        recordings=len(manifest["recordings"]),
        seconds=sum(item["rows"] / item["rate_hz"] for item in motion),
    )
