"""The versions of a workspace by their manifests, without their tables, and the lines of their list.

Listing them must be quick, so that nothing here imports numpy, pandas or the table formats. A manifest is written once: as long
as its file is the same, by device, inode, size and times, so is its line. Lines are kept in the user's cache folder, because
proving a manifest by its seal takes longer than everything else in a list.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import astuple, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from sysid.datasets.versions.files import Files, LocalFiles, ObjectFiles
from sysid.datasets.versions.manifest import Manifest, from_text
from sysid.errors import SettingsError, StorageError, StoreError, nearest
from sysid.files import make_folder, written_whole
from sysid.foreign import shown
from sysid.location import cache_home
from sysid.names import check_dataset_name
from sysid.parse import parse_json, read_text

#: A file that changed within this time [ns] may change again with the same times, which count in ticks of the system.
TICK_NS = 2_000_000_000
Identity = tuple[int, ...]


@dataclass(frozen=True)
class Entry:
    """One line of the list of versions; ``damage``: why a version cannot be read, then the other fields are empty."""

    name: str
    version: int
    digest: str = ""
    created: str = ""
    machine: str = ""
    recordings: int = 0
    seconds: float = 0.0
    damage: str = ""

    @property
    def reference(self) -> str:
        return f"{self.name}@{self.version}"


@dataclass
class KeptEntries:
    """The lines of an earlier list, and those of this one.

    Args:
        earlier: reference → the identity of its manifest, and the line.
    """

    earlier: Mapping[str, tuple[Identity, Entry]]
    now: dict[str, tuple[Identity, Entry]] = field(default_factory=dict)

    def entry(self, found: Entry, identity: Identity | None, read: Callable[[], Entry]) -> Entry:
        """The line of a manifest of this ``identity``; it is ``read`` where it is not kept."""
        known, kept = self.earlier.get(found.reference, (None, found))
        entry = kept if identity is not None and identity == known else read()
        if identity is not None and not entry.damage and max(identity[-2:]) < time.time_ns() - TICK_NS:
            self.now[entry.reference] = identity, entry
        return entry


@contextmanager
def kept_entries(place: str) -> Iterator[KeptEntries]:
    """The kept lines of the datasets at ``place``; at the end of the block those of this list are kept."""
    path = cache_home() / "versions" / f"{hashlib.sha256(place.encode('utf-8', 'surrogateescape')).hexdigest()[:32]}.json"
    kept = KeptEntries({})
    with suppress(OSError, ValueError, TypeError):  # missing, damaged, or of another sysid: everything is read
        kept = KeptEntries({entry.reference: (identity, entry) for identity, entry in map(_line, parse_json(read_text(path)))})
    yield kept
    if kept.now != kept.earlier:
        with suppress(OSError, StorageError):  # a list needs no cache
            make_folder(path.parent)
            with written_whole(path) as half:
                half.write_text(json.dumps([(identity, astuple(entry)) for identity, entry in kept.now.values()]))


def _line(item: Any) -> tuple[Identity, Entry]:
    identity, values = item
    kinds = [type(getattr(Entry("", 0), entry.name)) for entry in fields(Entry)]
    if [type(value) for value in values] != kinds or {type(number) for number in identity} != {int}:
        raise ValueError("no line of a list")
    return tuple(identity), Entry(*values)


def entry_of(manifest: Manifest) -> Entry:
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


@dataclass(frozen=True)
class VersionIndex:
    """The dataset versions of one workspace: a folder, or the URL of an object store (``s3://…``, ``gs://…``, ``file:///…``)."""

    workspace: str | Path

    @cached_property
    def files(self) -> Files:
        if "://" not in str(self.workspace):
            return LocalFiles(Path(self.workspace))
        return ObjectFiles(str(self.workspace).rstrip("/"))

    def list(self) -> tuple[Entry, ...]:
        """All versions of all datasets, by name and number; those that cannot be read with their damage.

        A manifest that was read for an earlier list and is the same file is not read again.
        """
        with kept_entries(self.files.uri("datasets")) as kept:
            return tuple(self._listed(entry, kept) for entry in self._found())

    def survey(self) -> Iterator[tuple[Entry, Manifest | None]]:
        """As :meth:`list`, each with its manifest; None for a version that cannot be read."""
        for entry in self._found():
            yield (entry, None) if entry.damage else self._read(entry)

    def _found(self) -> Iterator[Entry]:
        """Every version by its name and number alone; a dataset that cannot be listed with its damage."""
        for name in self.files.links("datasets"):
            yield Entry(name, 0, damage="is a link, which is not followed")
        for name in self.files.folders("datasets"):
            try:
                yield from (Entry(name, version) for version in self.versions(check_dataset_name(name)))
            except (StoreError, SettingsError) as error:
                yield Entry(name, 0, damage=str(error))

    def _read(self, found: Entry) -> tuple[Entry, Manifest | None]:
        try:
            manifest = self.read_manifest(found.name, found.version)
        except StoreError as error:
            return replace(found, damage=str(error)), None
        return entry_of(manifest), manifest

    def _listed(self, found: Entry, kept: KeptEntries) -> Entry:
        if found.damage:
            return found
        try:
            identity = self.files.identity(manifest_path(found.name, found.version))
        except (OSError, StoreError):
            identity = None
        return kept.entry(found, identity, lambda: self._read(found)[0])

    def manifest(self, reference: str) -> Manifest:
        """The manifest of a version in the newest schema (``docs/guide/versions.md``).

        Raises:
            StoreError: no such dataset or version, or a damaged manifest.
            SettingsError: no valid name of a dataset.
        """
        name, _, number = reference.partition("@")
        versions = self.versions(check_dataset_name(name))
        if not versions and not self.removed(name):
            names = [folder for folder in self.files.folders("datasets") if self.versions(folder)]
            where = f"workspace {self.workspace}"
            raise StoreError(where, f"no dataset {name!r}", nearest(name, names), "Run `sysid ingest`.")
        if (number or not versions) and (not is_number(number) or int(number) not in versions):
            listed = ", ".join(map(str, versions)) or "none is left"
            if is_number(number) and int(number) in self.removed(name):
                remedy = "Ingest the same logs again: they become a new version of the same content."
                raise StoreError(f"dataset {name}", f"version {number} was removed by vacuum", f"one of: {listed}", remedy)
            raise StoreError(f"dataset {name}", f"no version {number!r}", f"one of: {listed}")
        return self.read_manifest(name, int(number) if number else versions[-1])

    def read_manifest(self, name: str, version: int, removed: bool = False) -> Manifest:
        """:meth:`manifest` of a stored version, or of a ``removed`` one."""
        path = manifest_path(name, version, removed)
        try:
            manifest = from_text(self.files.read(path), path)
        except FileNotFoundError:
            raise StoreError(path, "is gone", "a manifest", "It was removed by hand, or just now.") from None
        if (manifest["name"], manifest["version"]) != (name, version):
            found = f"the manifest of {shown(manifest['name'])}@{manifest['version']}"
            raise StoreError(path, found, f"that of {name}@{version}", "It was copied or renamed by hand: move it back.")
        return manifest

    def versions(self, name: str) -> Sequence[int]:
        """Numbers of the versions of ``name``, increasing."""
        return numbers_of(self.files.names(f"datasets/{name}/versions"), ".json")

    def removed(self, name: str) -> Sequence[int]:
        """Numbers of the versions of ``name`` that vacuum removed, increasing."""
        return numbers_of(self.files.names(f"datasets/{name}/versions"), ".removed.json")


def manifest_path(name: str, version: int, removed: bool = False) -> str:
    """Path of the manifest of a stored or ``removed`` version in its workspace."""
    return f"datasets/{name}/versions/{version:06d}{'.removed' if removed else ''}.json"


def numbers_of(names: Sequence[str], ending: str) -> Sequence[int]:
    """Version numbers of manifests with this ending, increasing."""
    numbers = [name.removesuffix(ending) for name in names if name.endswith(ending)]
    return sorted(int(number) for number in numbers if is_number(number))


def is_number(text: str) -> bool:
    """Whether ``text`` is a version number; ``²`` is a digit too, and Python converts at most 4300 digits."""
    return text.isascii() and text.isdigit() and len(text) < 10
