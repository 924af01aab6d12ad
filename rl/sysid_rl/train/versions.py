"""A plant and a forward model of the same machine from the registry."""

from __future__ import annotations

from collections.abc import Mapping

from sysid.errors import SettingsError, StoreError
from sysid.networks.forward import ForwardModel
from sysid.plant import Plant, plant_from_files
from sysid.registry import ModelVersion, Registry
from sysid_rl.train.task import check_pair


def load_versions(registry: Registry, plant: str, forward: str) -> tuple[Plant, ForwardModel]:
    """A plant and a forward model that fit each other.

    Raises:
        StoreError, SettingsError: as :func:`sysid_rl.train.factory.from_versions`.
    """
    from sysid.networks.artifacts import from_files

    plants, models = registry.load(plant), registry.load(forward)
    for version, kind in ((plants, "plant"), (models, "forward")):
        if version.kind != kind:
            raise StoreError(f"model {version.reference}", f"is of kind {version.kind!r}", f"a version of kind {kind!r}")
    found = plant_from_files(plants.files, plants.reference)
    model = from_files(models.files, models.reference)
    assert not isinstance(model, Mapping)
    check_pair(found, model, models.reference)
    _check_lineage(registry, plants, models)
    return found, model


def _check_lineage(registry: Registry, plant: ModelVersion, forward: ModelVersion) -> None:
    """Refuse a forward model that was trained on a dataset of another machine than the plant and its sources."""
    from sysid.registry.version import ancestors

    trained_on = str(forward.lineage.get("dataset", "")).partition("@")[0]
    sources = [plant, *ancestors(registry.list(), plant)]
    known = {str(version.lineage[key]).partition("@")[0] for version in sources for key in ("dataset", "machine")
             if version.lineage.get(key)}  # fmt: skip
    if trained_on and known and trained_on not in known:
        raise SettingsError(
            f"forward model {forward.reference}",
            f"was trained on another machine (dataset {forward.lineage['dataset']})",
            f"a dataset of the machine of plant {plant.reference}: {', '.join(sorted(known))}",
            "Name a forward version of that machine, or fit one.",
        )
