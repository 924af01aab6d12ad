"""Removal of versions from which no model was made, and of leftovers: first the manifest, then the data.

A process that is killed in between leaves tables without a version, which the next vacuum removes. The manifest of a removed
version stays as ``<number>.removed.json``, with its provenance; its number is never given again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from sysid.datasets.versions.files import explained
from sysid.datasets.versions.index import is_number, manifest_path
from sysid.datasets.versions.store import Store
from sysid.errors import SettingsError, StoreError, nearest
from sysid.names import is_dataset_name

#: Without locks, tables without a manifest may belong to an active writer: they are kept for this time [s].
YOUNG_S = 24 * 3600.0

#: (reference, digest) of a version → models made from it; the digest is empty where the manifest cannot be read.
Users = Callable[[str, str], Sequence[str]]


@dataclass(frozen=True)
class RemovedPart:
    """A version (``autolog@1``), or a folder or file without a version; ``size`` is not shared with others [bytes]."""

    what: str
    size: int


@dataclass(frozen=True)
class NotRemoved:
    """A version or leftover that is kept, with the reason."""

    what: str
    reason: str


@dataclass(frozen=True)
class VacuumResult:
    """What a vacuum removed, or would remove where ``dry_run``."""

    removed: tuple[RemovedPart, ...]
    kept: tuple[NotRemoved, ...]
    dry_run: bool

    @property
    def size(self) -> int:
        """Freed size [bytes]."""
        return sum(item.size for item in self.removed)


def vacuum(
    store: Store, users: Users, references: Sequence[str] = (), keep: int | None = None, dry_run: bool = False
) -> VacuumResult:
    """Remove leftovers of killed writers, and versions.

    Args:
        users: models made from a version; a version with users is kept.
        references: versions to be removed (``name@3``); a ``name`` alone limits the removal to this dataset.
        keep: number of the newest versions of each dataset that are kept; None removes no others.
        dry_run: change nothing.

    Raises:
        SettingsError: ``keep`` is below 1.
        StoreError: no such version.
        StorageError: the workspace may not be written.
    """
    if keep is not None and keep < 1:
        raise SettingsError("keep", str(keep), "at least 1", "Name versions to remove all of a dataset.")
    there = [name for name in store.files.folders("datasets") if is_dataset_name(name)]
    wanted: dict[str, set[int]] = {}
    for reference in references:
        name, _, number = reference.partition("@")
        if name not in there:
            raise StoreError(f"workspace {store.workspace}", f"no dataset {name!r}", nearest(name, there))
        wanted.setdefault(name, set())
        if number:
            if not is_number(number) or int(number) not in store.versions(name):
                store.manifest(reference)  # says what there is
            wanted[name].add(int(number))
    removed: list[RemovedPart] = []
    kept = _links(store, "datasets") if not wanted else []
    for name in sorted(wanted) or there:
        with store.files.lock(f"datasets/{name}"):
            some, others = _one(store, name, wanted.get(name, set()), users, keep, dry_run)
            removed += some
            kept += others
    return VacuumResult(tuple(removed), tuple(kept), dry_run)


def _one(
    store: Store, name: str, named: Iterable[int], users: Users, keep: int | None, dry_run: bool
) -> tuple[list[RemovedPart], list[NotRemoved]]:
    """:func:`vacuum` of one dataset under its lock."""
    versions = store.versions(name)
    kept = [item for folder in ("", "/data", "/versions") for item in _links(store, f"datasets/{name}{folder}")]
    going = []
    folders: dict[int, frozenset[str] | None] = {}
    for version in versions:
        digest, folders[version] = _read(store, name, version)
        if version in named or (keep is not None and version in versions[:-keep]):
            by = users(f"{name}@{version}", digest)
            if by:
                kept.append(NotRemoved(f"{name}@{version}", f"{', '.join(by)} was made from it"))
            elif folders[version] is None and version not in named:
                kept.append(NotRemoved(f"{name}@{version}", "its manifest cannot be read: name the version to remove it"))
            else:
                going.append(version)
    staying = [folders[version] for version in versions if version not in going]
    data = f"datasets/{name}/data"
    weights = {folder: store.files.weight(f"{data}/{folder}") for folder in store.files.folders(data)}
    removed = []
    loose: list[str] = []
    if any(own is None for own in staying):
        reason = "a manifest of this dataset cannot be read, and may refer to data that no other refers to"
        kept.append(NotRemoved(data, reason))
        removed += [RemovedPart(f"{name}@{version}", 0) for version in going]
    else:
        needed = {folder for own in staying for folder in own or ()}
        free = {folder for folder in weights if folder not in needed}
        for version in going:
            own = {folder for folder in folders[version] or () if folder in free}
            removed.append(RemovedPart(f"{name}@{version}", sum(weights[folder][0] for folder in own)))
            free -= own
            loose += own
        for folder in sorted(free):
            size, age = weights[folder]
            if store.files.is_locked(f"{data}/{folder}"):
                kept.append(NotRemoved(f"{data}/{folder}", "a writer is at work on it"))
            elif not store.files.locks and age < YOUNG_S:
                kept.append(NotRemoved(f"{data}/{folder}", "younger than a day: a writer may be at work on it"))
            else:
                removed.append(RemovedPart(f"{data}/{folder}", size))
                loose.append(folder)
    drafts = [f"datasets/{name}/versions/{file}" for file in store.files.names(f"datasets/{name}/versions") if file[0] == "."]
    drafts = drafts if store.files.locks else []  # without locks they may belong to an active writer
    removed += [RemovedPart(draft, 0) for draft in drafts]
    if not dry_run:
        with explained(store.workspace, "what was removed so far is gone whole, the rest is as it was"):
            for version in going:
                store.files.rename(manifest_path(name, version), manifest_path(name, version, removed=True))
            for path in (*(f"{data}/{folder}" for folder in loose), *drafts):
                store.files.remove(path)
    return removed, kept


def _links(store: Store, folder: str) -> list[NotRemoved]:
    """Links, which are neither followed nor removed."""
    return [NotRemoved(f"{folder}/{name}", "is a link, which is not followed") for name in store.files.links(folder)]


def _read(store: Store, name: str, version: int) -> tuple[str, frozenset[str] | None]:
    """Digest of a version and the folders of its data; empty and None where its manifest cannot be read."""
    try:
        manifest = store.read_manifest(name, version)
    except StoreError:
        return "", None
    return manifest["digest"], frozenset(part["folder"].rpartition("/")[2] for part in manifest["parts"])
