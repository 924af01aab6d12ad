"""What a workspace holds, as items with their sources."""

from __future__ import annotations

from dataclasses import replace

from sysid.datasets.versions.index import VersionIndex
from sysid.datasets.versions.manifest import Manifest
from sysid.errors import StoreError
from sysid.site.dataset_items import dataset_items
from sysid.site.gap_items import created_plants, gap_items
from sysid.site.item import Item
from sysid.site.model_items import model_items
from sysid.workspace import Workspace


def inventory(workspace: Workspace) -> tuple[Item, ...]:
    """All items of a workspace, the newest first; no table and no network is loaded.

    What cannot be read is an item of the kind ``damaged``.
    """
    index = VersionIndex(workspace.location)
    found = list(dataset_items(index))
    units = {item.reference: dict(manifest_of(index, item)["units"]) for item in found if item.kind == "dataset"}
    found += gap_items(workspace.root, units)
    found += model_items(workspace.models.survey())
    items = {item.key: item for item in found if item.kind != "damaged"}
    for plant, gap in created_plants(workspace.root, items).items():
        if plant in items:
            items[plant] = replace(items[plant], parents=(*items[plant].parents, gap))
    whole = [replace(item, parents=tuple(key for key in item.parents if key in items)) for item in items.values()]
    return tuple(sorted(whole, key=lambda item: item.created, reverse=True)) + tuple(
        item for item in found if item.kind == "damaged"
    )


def manifest_of(index: VersionIndex, item: Item) -> Manifest:
    """The manifest of a dataset version.

    Raises:
        StoreError: it was removed meanwhile.
    """
    if item.kind != "dataset":
        raise StoreError(item.key, "is not a dataset version", "one")
    name, _, version = item.reference.rpartition("@")
    return index.read_manifest(name, int(version))
