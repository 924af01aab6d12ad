"""The effects that the gap workflow names on one machine, stored by the plant under test."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from sysid.datasets.recording import Dataset
from sysid.files import json_text, write_durably
from sysid.fleet.effects import FleetEffect
from sysid.fleet.result import FleetMachine
from sysid.plant import Plant
from sysid.registry.version import sha256
from sysid.workspace import Workspace, open_workspace


def name_effects(location: str, reference: str, plant: str | None) -> dict[str, Any]:
    """Task: the gap of one machine, from a stored result of this dataset version and plant if there is one.

    Args:
        plant: a registered plant; by default the nominal one of the dataset.
    """
    from sysid.gap import find_gap

    place = open_workspace(location)
    dataset = place.dataset(reference)
    tested = place.plant(dataset, plant)
    stored = place.gap(dataset)
    if stored is not None and place.tests(stored, tested):
        return _machine(dataset, stored.verdict, stored.effects)
    own = _own_file(place, dataset, tested)
    if own.exists():
        return dict(json.loads(own.read_text("utf-8")))
    result = find_gap(dataset, tested, place.models)
    if stored is None:
        place.keep_gap(dataset, result)  # for the report; one of another plant is not replaced
    machine = _machine(dataset, result.verdict, result.effects)
    write_durably(own, json_text(machine).encode(), "fleet", "Make room in the workspace, and call again.")
    return machine


def _machine(dataset: Dataset, verdict: Any, effects: Any) -> dict[str, Any]:
    return FleetMachine(dataset.reference, verdict, tuple(map(FleetEffect.of, effects))).to_json()


def plant_sha256(plant: Plant) -> str:
    """Content address of a plant, by its files."""
    hashes = {file: sha256(content) for file, content in plant.to_files().items()}
    return sha256(json.dumps(hashes, sort_keys=True).encode())


def _own_file(place: Workspace, dataset: Dataset, plant: Plant) -> Path:
    """The names by this plant, in the results of the dataset version."""
    return place.output(f"fleet-{plant_sha256(plant)[:16]}.json", dataset)
