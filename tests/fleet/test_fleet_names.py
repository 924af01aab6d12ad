"""The names of a machine are those by the plant under test, from a stored result only if it is of that plant."""

from __future__ import annotations

from pathlib import Path

import pytest
from fleet_logs import write_fleet

import sysid.gap
from sysid.fleet.estimates import name_effects
from sysid.gap import GapResult
from sysid.gap.result import Gap
from sysid.machine import KnownEffect
from sysid.plant import Plant
from sysid.workspace import Workspace, open_workspace

DEADBAND = KnownEffect("valve_deadband", "boom", {"positive": 0.08, "negative": 0.08})


@pytest.fixture
def place(tmp_path: Path) -> Workspace:
    return open_workspace(write_fleet(tmp_path, {"lift-1": [0.08, 0.08, 0.08]}))


@pytest.fixture
def searched(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The plants that were tested; the search itself is replaced by one that names nothing."""
    references: list[str] = []

    def find_gap(dataset: object, plant: Plant, registry: object) -> GapResult:
        references.append(plant.reference)
        return gap_of(plant.reference or "lift@1")

    monkeypatch.setattr(sysid.gap, "find_gap", find_gap)
    return references


def gap_of(plant: str) -> GapResult:
    none = Gap({}, {}, {})
    return GapResult("lift-1@1", plant, "", "no_gap", (), (), (), (), none, none, (), (), 0.0)


def registered(place: Workspace, plant: Plant) -> str:
    return place.models.register("lift", "plant", plant.to_files(), {}).reference


def test_a_stored_result_of_another_plant_is_not_used(place: Workspace, searched: list[str]) -> None:
    dataset = place.dataset("lift-1")
    nominal = place.plant(dataset)
    repaired = nominal.with_effect(DEADBAND)
    first, second = registered(place, nominal), registered(place, repaired)
    place.keep_gap(dataset, gap_of(second))
    location = str(place.location)
    name_effects(location, "lift-1", None)
    assert searched == [""]
    kept = place.gap(dataset)
    assert kept is not None
    assert kept.plant_before == second  # the user's result stays
    name_effects(location, "lift-1", None)
    name_effects(location, "lift-1", second)
    assert searched == [""]
    name_effects(location, "lift-1", first)
    assert searched == [""], "the nominal plant under its name has the same files"


def test_a_stored_result_of_the_nominal_plant_is_used(place: Workspace, searched: list[str]) -> None:
    dataset = place.dataset("lift-1")
    place.keep_gap(dataset, gap_of(registered(place, place.plant(dataset))))
    name_effects(str(place.location), "lift-1", None)
    assert searched == []


def test_names_by_a_plant_are_kept_for_the_next_call(place: Workspace, searched: list[str]) -> None:
    dataset = place.dataset("lift-1")
    repaired = place.plant(dataset).with_effect(DEADBAND)
    reference = registered(place, repaired)
    found = [name_effects(str(place.location), "lift-1", reference) for _ in range(2)]
    assert searched == [reference]
    assert found[0] == found[1]
