"""Lineage of a model version: its sources, down to the raw files, and what was made from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from sysid.datasets import Lineage, Store
from sysid.datasets import lineage as lineage_of_dataset
from sysid.errors import StoreError
from sysid.registry import ModelVersion, ancestors, descendants


@dataclass(frozen=True)
class RelatedVersion:
    """Another model version in a lineage."""

    reference: str
    kind: str
    digest: str
    aliases: tuple[str, ...] = ()


@dataclass(frozen=True)
class ResultUse:
    """A stored result that uses the version: kind of result, dataset version, kind of use."""

    what: str
    dataset: str
    how: str


@dataclass(frozen=True)
class ModelLineage:
    """The lineage of one version.

    Args:
        dataset, dataset_digest: of its data; empty if its lineage names none.
        missing: why the lineage of the dataset version is not available; empty if it is.
        source: the lineage of that dataset version, to its raw files.
        parents: model versions that it was made from, directly or indirectly.
        children: model versions made from it, directly or indirectly.
        uses: results that use it.
    """

    model: str
    kind: str
    digest: str
    created_ms: int
    aliases: tuple[str, ...]
    dataset: str
    dataset_digest: str
    missing: str
    source: Lineage | None
    parents: tuple[RelatedVersion, ...]
    children: tuple[RelatedVersion, ...]
    uses: tuple[ResultUse, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain values, schema 1."""
        values = asdict(self)
        values["source"] = self.source.to_json() if self.source is not None else None
        return {"schema": 1, **values}


def lineage_of(
    version: ModelVersion, versions: Sequence[ModelVersion], store: Store, uses: Sequence[ResultUse] = ()
) -> ModelLineage:
    """Follow the lineage of a version both ways.

    Args:
        versions: all versions of the registry.
        store: of the datasets.
        uses: stored results that use it.
    """
    parents = ancestors(versions, version)
    dataset, digest = next((found for found in map(_dataset, (version, *parents)) if found[0]), ("", ""))
    source, missing = _source(store, dataset, digest)
    return ModelLineage(
        model=version.reference,
        kind=version.kind,
        digest=version.digest,
        created_ms=version.created_ms,
        aliases=version.aliases,
        dataset=dataset,
        dataset_digest=digest or (source.digest if source is not None else ""),
        missing=missing,
        source=source,
        parents=tuple(map(_relative, parents)),
        children=tuple(map(_relative, descendants(versions, version.reference))),
        uses=tuple(uses),
    )


def _source(store: Store, dataset: str, digest: str) -> tuple[Lineage | None, str]:
    """The lineage of the dataset version, or why it is not available."""
    if not dataset:
        return None, "its lineage names no dataset version"
    try:
        found = lineage_of_dataset(store, dataset)
    except StoreError as error:
        return None, str(error)
    if digest and found.digest != digest:
        return None, f"{dataset} is another dataset of the same name (digest {found.digest[:12]}…)"
    return found, ""


def _dataset(version: ModelVersion) -> tuple[str, str]:
    name = version.lineage.get("dataset")
    return (str(name), str(version.lineage.get("dataset_digest", ""))) if isinstance(name, str) else ("", "")


def _relative(version: ModelVersion) -> RelatedVersion:
    return RelatedVersion(version.reference, version.kind, version.digest, version.aliases)
