"""Ancestors and descendants of model versions, by the references in their lineages."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from sysid.registry.version import ModelVersion


def dataset_descendants(versions: Sequence[ModelVersion], reference: str, digest: str) -> tuple[ModelVersion, ...]:
    """Those of ``versions`` that were made from a dataset version, directly or indirectly."""
    wanted = {reference, digest} - {""}
    direct = {version.reference for version in versions if wanted & {*_named_in(version.lineage, datasets=True)}}
    reached = _followed(versions, direct)
    return tuple(version for version in versions if version.reference in reached)


def descendants(versions: Sequence[ModelVersion], reference: str) -> tuple[ModelVersion, ...]:
    """Those of ``versions`` that were made from a model version, directly or indirectly."""
    reached = _followed(versions, {reference}) - {reference}
    return tuple(version for version in versions if version.reference in reached)


def ancestors(versions: Sequence[ModelVersion], version: ModelVersion) -> tuple[ModelVersion, ...]:
    """The model versions that a version was made from, directly or indirectly."""
    by_reference = {other.reference: other for other in versions}
    found: dict[str, ModelVersion] = {}
    open_ends = [version]
    while open_ends:
        for name in _named_in(open_ends.pop().lineage, datasets=False):
            if name in by_reference and name not in found and name != version.reference:
                found[name] = by_reference[name]
                open_ends.append(by_reference[name])
    return tuple(found.values())


def sources(version: ModelVersion) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The dataset versions and the model versions that a lineage names, and other texts: compare them with known references."""
    return tuple(_named_in(version.lineage, datasets=True)), tuple(_named_in(version.lineage, datasets=False))


def _followed(versions: Sequence[ModelVersion], reached: set[str]) -> set[str]:
    parents = {version.reference: {*_named_in(version.lineage, datasets=False)} for version in versions}
    while more := {name for name, own in parents.items() if name not in reached and own & reached}:
        reached = reached | more
    return reached


def _named_in(value: Any, datasets: bool, key: str = "") -> Iterator[str]:
    """The texts of a lineage at any depth, of keys with ``dataset`` or of all others.

    The keys are needed because a plant and a dataset may have the same name.
    """
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from _named_in(item, datasets, str(name))
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _named_in(item, datasets, key)
    elif isinstance(value, str) and ("dataset" in key) == datasets:
        yield value
