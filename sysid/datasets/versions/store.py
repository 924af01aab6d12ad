"""Dataset versions on disk or in an object store: Delta tables for samples and raw channels, one JSON manifest a version.

A version is visible when its manifest is: data are written first, the manifest last and atomically. Folders::

    datasets/<name>/data/<part>/samples              Delta table: recording, row, stamp_ns, time, one column a signal
    datasets/<name>/data/<part>/channels             Delta table: raw channels on their own clocks
    datasets/<name>/versions/<number>.json           manifest: machine, units, splits, sources, clocks, quality, the parts
    datasets/<name>/versions/<number>.removed.json   what stays of a version that vacuum removed

A part is written by one ingest and never changed. An append refers to the parts of the previous version and one more; a version
with other roles refers to the same parts.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import uuid
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from sysid.datasets.channel import Channel
from sysid.datasets.recording import Dataset, Role
from sysid.datasets.versions.assemble import dataset_of, frame_of
from sysid.datasets.versions.files import UNCHANGED, OvertakenError, TakenError, explained
from sysid.datasets.versions.index import VersionIndex, manifest_path, numbers_of
from sysid.datasets.versions.manifest import (
    Manifest,
    PartRecord,
    Superseded,
    appended,
    new_manifest,
    new_part,
    reduced,
    resplit,
    split_digest,
    to_text,
)
from sysid.datasets.versions.tables import PartTables, is_there, read_batches, read_table, write_channels, write_samples
from sysid.errors import StorageError, StoreError, nearest
from sysid.location import default_location
from sysid.progress import Progress, silent
from sysid.progress import part as stretch

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class Store(VersionIndex):
    """The datasets of one workspace: a folder, or the URL of an object store (``s3://…``, ``gs://…``, ``file:///…``)."""

    def load(self, reference: str, recordings: Collection[str] | None = None) -> Dataset:
        """``"name"`` (its newest version) or ``"name@3"``.

        Args:
            recordings: names of the only ones to load; tables without them are not read. By default all.

        Raises:
            StoreError: no such dataset, version or recording, or its files are damaged.
        """
        manifest = self.manifest(reference)
        if recordings is not None:
            manifest = _only(manifest, recordings)
        signals: dict[int, set[str]] = {}
        for item in manifest["recordings"]:
            signals.setdefault(item["part"], {"recording", "row", "time"}).update(item["signals"])
        place = f"{manifest['name']}@{manifest['version']}: samples"
        samples = {k: read_batches(self.files, manifest["parts"][k], "samples", place, own) for k, own in signals.items()}
        try:
            return dataset_of(manifest, samples)
        except (KeyError, ValueError, TypeError, ArithmeticError, NotImplementedError) as error:  # those of Arrow are such, too
            where, found = f"dataset {manifest['name']}@{manifest['version']}", f"{type(error).__name__}: {error}"
            expected = "tables with the columns that the manifest names"
            raise StoreError(where, f"not readable ({found})", expected, "Ingest the logs again.") from None

    def channels(self, reference: str, recordings: Collection[str] | None = None) -> pd.DataFrame:
        """The raw channels, each on its own clock: recording, source, domain, signal, unit, primary, stamp_ns, value.

        Args:
            recordings: names of the only ones, before they were cut into blocks; by default all.
        """
        import pyarrow as pa

        manifest = self.manifest(reference)
        tables = [self._channels(manifest, part, recordings) for part in manifest["parts"]]
        frame: pd.DataFrame = pa.concat_tables(tables, promote_options="permissive").to_pandas(ignore_metadata=True)
        return frame

    def clock_domains(self, reference: str) -> dict[tuple[str, str], str]:
        """(recording before it was cut, source) → the clock domain of its stamps."""
        manifest = self.manifest(reference)
        columns = ("recording", "source", "domain")
        found: dict[tuple[str, str], str] = {}
        for part in manifest["parts"]:
            if part["channels"] is not None:
                rows = part["channels"]["clocks"]
            else:
                place = f"{manifest['name']}@{manifest['version']}: channels"
                table = read_table(self.files, part, "channels", place, columns)
                rows = table.group_by(list(columns)).aggregate([]).to_pylist()
            gone = part.get("superseded", ())
            found |= {(row["recording"], row["source"]): row["domain"] for row in rows if row["recording"] not in gone}
        return found

    def tables(self, reference: str) -> tuple[PartTables, ...]:
        """The Delta tables of a version, for polars, DuckDB, Spark, Dask."""
        manifest = self.manifest(reference)
        return tuple(
            PartTables(
                tuple(item["name"] for item in manifest["recordings"] if item["part"] == number),
                self.files.uri(f"{part['folder']}/samples"),
                self.files.uri(f"{part['folder']}/channels"),
            )
            for number, part in enumerate(manifest["parts"])
        )

    def find_digest(self, name: str, digest: str) -> int | None:
        """The newest version of ``name`` with this content and all its tables; None where there is none."""
        for version in reversed(self.versions(name)):
            with _damage_skipped():
                manifest = self.read_manifest(name, version)
                if manifest["digest"] == digest and self._has_tables(manifest):
                    return version
        return None

    def intact(self, name: str, digest: str, after: int = 0) -> Dataset | None:
        """The newest version of ``name`` with this content that can be read completely; None where there is none.

        Args:
            after: only later versions are read; those of an append can only be later than the version that it extends.
        """
        for version in reversed(self.versions(name)):
            with _damage_skipped():
                if version > after and self.read_manifest(name, version)["digest"] == digest:
                    return self.load(f"{name}@{version}")
        return None

    def save(
        self, dataset: Dataset, channels: Mapping[str, Sequence[Channel]], made: PartRecord, progress: Progress = silent
    ) -> Dataset:
        """Store ``dataset`` as the next version of its name; the same digest again returns the existing version.

        Args:
            dataset: its ``version`` is ignored.
            channels: recording (before it was cut into blocks) → its raw channels.
            made: provenance of the tables, stored with the version.
            progress: called with the share that is written.

        Raises:
            StorageError: the disk is full or read-only; no version is made then.
        """
        with self.new_part(dataset.name, dataset.digest) as folder:
            part = self._written(folder, dataset, channels, made, progress)
            return dataclasses.replace(dataset, version=self.publish(dataset, part))

    def append(
        self,
        base: str,
        addition: Dataset,
        channels: Mapping[str, Sequence[Channel]],
        made: PartRecord,
        newest: bool = False,
        progress: Progress = silent,
        superseded: Superseded | None = None,
    ) -> int:
        """Store the version ``base`` with the recordings of ``addition`` behind its own; no file of ``base`` changes.

        Args:
            base: ``name@version``.
            addition: the new recordings with their units, roles, sources, clocks and streams; the digest of the new version;
                the quality of all recordings.
            channels: of the new recordings.
            newest: ``base`` has to be the newest version.
            progress: called with the share that is written.
            superseded: recordings of ``base`` that the new version does not have.

        Returns:
            The number of the new version, or of an existing one with this content.

        Raises:
            OvertakenError: ``base`` is not the newest version but has to be.
            StoreError: ``base`` was removed.
            StorageError: the disk is full or read-only; no version is made then.
        """
        with self.new_part(addition.name, addition.digest) as folder:
            part = self._written(folder, addition, channels, made, progress)
            return self.publish(addition, part, base, newest, superseded)

    def reduce(self, base: str, digest: str, superseded: Superseded) -> int:
        """Store the newest version ``base`` without some recordings; returns the number. Errors as of :meth:`append`."""
        name = self.manifest(base)["name"]
        with self.files.lock(f"datasets/{name}"), explained(self.workspace, UNCHANGED):
            whole = self._extended(base, newest=True)
            return self._publish(name, digest, lambda number: reduced(whole, number, digest, superseded))

    def _extended(self, base: str, newest: bool) -> Manifest:
        """The manifest that is extended, under the lock of the dataset; arguments and errors as of :meth:`append`."""
        manifest = self._whole(base)
        last = self.versions(manifest["name"])[-1]
        if newest and last != manifest["version"]:
            found = f"{manifest['name']}@{last} was stored in the meantime"
            remedy = "Run the command again to append to it."
            raise OvertakenError(f"dataset {manifest['name']}", found, f"{base} to be the newest version", remedy)
        return manifest

    def resplit(self, reference: str, splits: Mapping[str, Role]) -> Dataset:
        """A version with the same tables and other roles, or an existing one with these roles.

        Raises:
            StorageError: the disk is full or read-only.
        """
        name = self.manifest(reference)["name"]
        with self.files.lock(f"datasets/{name}"), explained(self.workspace, UNCHANGED):
            base = self._whole(reference)
            digest = split_digest(base, splits)
            number = self.find_digest(name, digest)
            if number is None:
                number = self._publish(name, digest, lambda version: resplit(base, splits, digest, version))
        return self.load(f"{name}@{number}")

    def _whole(self, reference: str) -> Manifest:
        """The manifest of a version, after a check that its tables exist."""
        manifest = self.manifest(reference)
        if not self._has_tables(manifest):
            raise StoreError(f"dataset {reference}", "its tables are gone", "the tables as written", "Ingest the logs again.")
        return manifest

    @contextmanager
    def new_part(self, name: str, digest: str) -> Iterator[str]:
        """A new folder for the tables of a part: ``samples`` and ``channels``.

        It is locked within the block, and removed after an error, or where :meth:`publish` found a version with this content.
        """
        folder = f"datasets/{name}/data/{digest[:16]}-{uuid.uuid4().hex[:8]}"
        try:
            with contextlib.ExitStack() as locked:
                with self.files.lock(f"datasets/{name}"), explained(self.workspace, UNCHANGED):
                    self._remove_leftovers(name, digest)
                    locked.enter_context(self.files.lock(folder, UNCHANGED))
                yield folder
        except BaseException:
            with contextlib.suppress(OSError):
                if folder.rpartition("/")[2] in self.leftovers(name):
                    self.files.remove(folder)
            raise

    def _written(
        self,
        folder: str,
        dataset: Dataset,
        channels: Mapping[str, Sequence[Channel]],
        made: PartRecord,
        progress: Progress,
    ) -> Manifest:
        """Write the tables of a part; its entry of the manifest."""
        with explained(self.workspace, UNCHANGED):
            cells = sum(recording.table.size for recording in dataset.recordings)
            half = cells / max(1, cells + 2 * sum(len(c.stamps) for own in channels.values() for c in own))
            samples = write_samples(self.files, f"{folder}/samples", dataset, channels, stretch(progress, 0.0, half))
            raw = write_channels(self.files, f"{folder}/channels", channels, stretch(progress, half, 1.0))
        return new_part(folder, samples, raw, made)

    def publish(
        self,
        dataset: Dataset,
        part: Manifest,
        base: str | None = None,
        newest: bool = False,
        superseded: Superseded | None = None,
    ) -> int:
        """Publish tables in a folder of :meth:`new_part`, in one step: as a version of their own, or behind those of ``base``.

        Args:
            part: entry of the manifest.
            base, newest, superseded: as of :meth:`append`.

        Returns:
            The number of the new version, or of an existing one with this content.
        """
        name = dataset.name
        after = 0 if base is None else self.manifest(base)["version"]

        def build(number: int) -> Manifest:
            if base is None:
                return new_manifest(dataset, number, part)
            return appended(self._extended(base, newest), dataset, number, part, superseded)

        with self.files.lock(f"datasets/{name}"), explained(self.workspace, UNCHANGED):
            known = self.intact(name, dataset.digest, after)
            if known is None:
                self.files.unlock(part["folder"])
                self.files.settle(part["folder"])
            number = self._publish(name, dataset.digest, build) if known is None else known.version
            if all(own["folder"] != part["folder"] for own in self.read_manifest(name, number)["parts"]):
                self.files.remove(part["folder"])
        return number

    def _remove_leftovers(self, name: str, digest: str) -> None:
        """Remove the folders of killed ingests of the same content."""
        same = [folder for folder in self.files.folders(f"datasets/{name}/data") if folder.startswith(digest[:16])]
        for folder in self.leftovers(name) if same and self.files.locks else ():  # reads every manifest
            path = f"datasets/{name}/data/{folder}"
            if folder in same and not self.files.is_locked(path):
                self.files.remove(path)

    def _publish(self, name: str, digest: str, build: Callable[[int], Manifest]) -> int:
        """Publish the manifest under the next number, which it returns; without locks another writer may claim it first."""
        while True:
            taken = self.files.claimed(f"datasets/{name}/versions")
            version = max([*numbers_of(taken, ".json"), *numbers_of(taken, ".removed.json")], default=0) + 1
            try:
                self.files.publish(manifest_path(name, version), to_text(build(version)))
            except TakenError:
                if self.files.locks:
                    raise
                known = self.find_digest(name, digest)
                if known is not None:
                    return known
                continue
            return version

    def leftovers(self, name: str) -> Sequence[str]:
        """Folders under ``data`` without a version; none where a manifest cannot be read, because it may refer to them."""
        used = set()
        try:
            for version in self.versions(name):
                used |= {part["folder"].rpartition("/")[2] for part in self.read_manifest(name, version)["parts"]}
        except StoreError:
            return ()
        return [folder for folder in self.files.folders(f"datasets/{name}/data") if folder not in used]

    def _has_tables(self, manifest: Manifest) -> bool:
        return all(is_there(self.files, part, which) for part in manifest["parts"] for which in ("samples", "channels"))

    def _channels(self, manifest: Manifest, part: Manifest, recordings: Collection[str] | None) -> pa.Table:
        """The raw channels of a part, without those of recordings that a later part supersedes."""
        import pyarrow as pa
        import pyarrow.compute as pc

        place = f"{manifest['name']}@{manifest['version']}: channels"
        table = read_table(self.files, part, "channels", place, recordings=recordings)
        gone = part.get("superseded", ())
        return table.filter(pc.invert(pc.is_in(table["recording"], pa.array(gone, pa.string())))) if gone else table


def load(reference: str, workspace: str | os.PathLike[str] | None = None) -> pd.DataFrame:
    """A stored version as one table: ``sysid.load("autolog@3")``.

    Args:
        reference: ``"name"`` (its newest version) or ``"name@3"``.
        workspace: folder or object-store URL; else ``SYSID_WORKSPACE``, else ``./workspace``.

    Returns:
        See :func:`~sysid.datasets.versions.assemble.frame_of`.

    Raises:
        StoreError: no such dataset or version, or its files are damaged.
    """
    place = os.fspath(workspace) if workspace is not None else default_location()
    return frame_of(Store(place if "://" in place else Path(place)).load(reference))


@contextmanager
def _damage_skipped() -> Iterator[None]:
    """Errors of damaged versions are ignored. A store that does not answer may hold the version: its error is raised."""
    try:
        yield
    except StorageError:
        raise
    except StoreError:
        pass


def _only(manifest: Manifest, names: Collection[str]) -> Manifest:
    """The manifest with these recordings.

    Raises:
        StoreError: one that it does not have.
    """
    known = [item["name"] for item in manifest["recordings"]]
    for name in names:
        if name not in known:
            where = f"dataset {manifest['name']}@{manifest['version']}"
            raise StoreError(where, f"no recording {name!r}", nearest(name, known))
    splits = {name: role for name, role in manifest["splits"].items() if name in names}
    return {**manifest, "recordings": [item for item in manifest["recordings"] if item["name"] in names], "splits": splits}
