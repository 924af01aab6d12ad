"""What a workspace holds, as items with their sources."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sysid.datasets.versions.index import VersionIndex
from sysid.datasets.versions.manifest import Manifest
from sysid.errors import StoreError
from sysid.registry import DamagedModel, ModelVersion
from sysid.site.dataset_items import SIGNALS, dataset_items
from sysid.site.flight_items import flight_items
from sysid.site.gap_items import gap_items
from sysid.site.item import Item
from sysid.site.model_items import model_items
from sysid.workspace import Workspace


def inventory(workspace: Workspace, survey: Sequence[ModelVersion | DamagedModel] | None = None) -> tuple[Item, ...]:
    """All items of a workspace, the newest first; no table and no network is loaded.

    What cannot be read is an item of the kind ``damaged``.

    Args:
        survey: of the registry; default: made here.
    """
    survey = workspace.models.survey() if survey is None else survey
    models = list(model_items(survey))
    flights = list(flight_items(workspace.root, {item.reference: item for item in models if item.kind != "damaged"}))
    logs = {item.digest: item.key for item in flights if item.digest}
    datasets = list(dataset_items(VersionIndex(workspace.location), logs))
    units = {item.reference: {f.name: f.text for f in item.facts if f.group == SIGNALS} for item in datasets}
    found = [*datasets, *gap_items(workspace.root, units), *models, *flights]
    items = {item.key: item for item in found if item.kind != "damaged"}
    for gap in [item for item in items.values() if item.created_plant]:
        plant = items.get(f"plant:{gap.created_plant}")
        if plant is not None:
            items[plant.key] = replace(plant, parents=(*plant.parents, gap.key))
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
