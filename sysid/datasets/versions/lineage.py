"""Provenance of a version: raw files by sha256, recipe, machine, clocks, settings, code, and the files of its tables."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from sysid.datasets.recording import ClockRecord, Source
from sysid.datasets.versions.manifest import Manifest, clock_from
from sysid.datasets.versions.store import Store
from sysid.errors import StoreError
from sysid.names import uncut_name


@dataclass(frozen=True)
class Step:
    """A version from which another one was made ``by`` append or split; ``there``: whether it is still stored."""

    reference: str
    digest: str
    by: str
    there: bool


@dataclass(frozen=True)
class PartLineage:
    """The tables of one ingest, and their provenance.

    Args:
        recordings: in the tables.
        sources: raw files of the tables.
        recipe_sha256: empty where the columns had canonical names.
        ingest: version of the ingest code.
        settings: of resampling.
        software: library → version.
        tables: path or URL of each table → sha256 of its Parquet files (none for manifests of schema 1).
    """

    recordings: tuple[str, ...]
    sources: tuple[Source, ...]
    recipe_sha256: str
    clocks: tuple[ClockRecord, ...]
    settings: Mapping[str, Any]
    mounts: Mapping[str, Any]
    created: str
    sysid: str
    ingest: int
    python: str
    software: Mapping[str, str]
    tables: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True)
class Lineage:
    """The provenance of one version; ``steps`` from the version before back to the first."""

    dataset: str
    digest: str
    created: str
    steps: tuple[Step, ...]
    machine: Mapping[str, str]
    splits: Mapping[str, str]
    parts: tuple[PartLineage, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain values, schema 1."""
        return {"schema": 1, **asdict(self)}


def lineage(store: Store, reference: str) -> Lineage:
    """The provenance of a version.

    Raises:
        StoreError: no such version, or a damaged manifest.
    """
    manifest = store.manifest(reference)
    return Lineage(
        dataset=f"{manifest['name']}@{manifest['version']}",
        digest=manifest["digest"],
        created=manifest["created"],
        steps=tuple(_steps(store, manifest)),
        machine={name: _sha256(text) for name, text in manifest["machine"].items()},
        splits=manifest["splits"],
        parts=tuple(_part(store, manifest, number) for number in range(len(manifest["parts"]))),
    )


def _steps(store: Store, manifest: Manifest) -> list[Step]:
    steps: list[Step] = []
    name, base = manifest["name"], manifest["base"]
    while base is not None:
        version = int(base["version"])
        there = version in store.versions(name)
        steps.append(Step(f"{name}@{version}", base["digest"], base["by"], there))
        try:
            base = store.read_manifest(name, version, removed=not there)["base"]
        except StoreError:  # damaged, or removed by hand: earlier steps are unknown
            break
    return steps


def _part(store: Store, manifest: Manifest, number: int) -> PartLineage:
    part = manifest["parts"][number]
    made = part["made"]
    recordings = tuple(item["name"] for item in manifest["recordings"] if item["part"] == number)
    whole = {*recordings, *map(uncut_name, recordings)}
    sources = [item for item in manifest["sources"] if item["path"].rpartition("/")[0] in whole]
    return PartLineage(
        recordings=recordings,
        sources=tuple(Source(**{**item, "losses": tuple(item["losses"])}) for item in sources),
        recipe_sha256=_sha256(made["recipe"]) if made["recipe"] else "",
        clocks=tuple(clock_from(item) for item in manifest["clocks"] if item["recording"] in whole),
        **{key: made[key] for key in ("settings", "mounts", "created", "sysid", "ingest", "python", "software")},
        tables={
            store.files.uri(f"{part['folder']}/{which}"): tuple(
                file["sha256"] for file in (part[which] or {"files": ()})["files"]
            )
            for which in ("samples", "channels")
        },
    )


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()
