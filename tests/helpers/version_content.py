"""The content of a dataset version, for comparisons."""

from __future__ import annotations

from typing import Any

from sysid.datasets import Store

#: What differs between two versions of the same content: times, and the folder of the tables.
VARYING = ("created", "folder")


def content(store: Store, reference: str) -> Any:
    """The manifest of a version without what varies; it holds the sha256 of every Parquet file."""
    return _without(store.manifest(reference))


def _without(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without(own) for key, own in value.items() if key not in VARYING}
    return [_without(own) for own in value] if isinstance(value, list) else value
