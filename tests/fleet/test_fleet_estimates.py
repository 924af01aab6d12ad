"""Values of known effects in every recording of one machine, from logs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fleet_logs import write_fleet

from sysid.errors import SettingsError
from sysid.fleet import fleet_gap
from sysid.fleet.effects import FleetEffect
from sysid.fleet.estimates import estimate
from sysid.workspace import open_workspace

DEADBAND = FleetEffect("valve_deadband", "boom", None, ("positive", "negative"))


BANDS = {"run-00": 0.08, "run-01": 0.08, "run-02": 0.10, "run-03": 0.10}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_fleet(tmp_path_factory.mktemp("fleet"), {"lift-1": list(BANDS.values()), "lift-2": [0.08, 0.08, 0.08]})


def test_every_recording_has_its_own_value(place: Path) -> None:
    workspace = open_workspace(place)
    dataset = workspace.dataset("lift-1")
    found = estimate(dataset, workspace.plant(dataset), [DEADBAND])
    assert [item.parameter for item in found] == ["positive", "negative"]
    for item in found:
        # Ingest cuts a recording into blocks where roles need them.
        assert {name.partition("#")[0] for name in item.recordings} == set(BANDS)
        assert item.ends[-1] == pytest.approx(4 * 40.0 / 3600.0, rel=0.02)
        assert list(item.ends) == sorted(item.ends)
        errors = np.abs(np.array(item.values) - [BANDS[name.partition("#")[0]] for name in item.recordings])
        assert errors.max() < 1e-3
        assert (errors < 5.0 * np.array(item.deviations)).all()
        assert item.unit == "1"


def test_an_effect_of_another_stage_or_machine_has_no_values(place: Path) -> None:
    workspace = open_workspace(place)
    dataset = workspace.dataset("lift-2")
    other = FleetEffect("backlash", "stick", "drive", ("width",))
    assert estimate(dataset, workspace.plant(dataset), [other]) == ()


def test_the_same_machine_twice_is_refused(place: Path) -> None:
    with pytest.raises(SettingsError, match="lift-1 twice"):
        fleet_gap(place, ["lift-1", "lift-1@1"])


def test_no_machine_is_refused(place: Path) -> None:
    with pytest.raises(SettingsError, match="no machine"):
        fleet_gap(place, [])


@pytest.mark.parametrize("rows", [0, 1, 4, 8, 20, 40, 200])
def test_a_short_recording_has_no_value_rather_than_a_wrong_one(place: Path, rows: int) -> None:
    workspace = open_workspace(place)
    dataset = workspace.dataset("lift-2")
    whole = dataset.recordings[0]
    short = replace(whole, name="short", table=whole.table.iloc[:rows].reset_index(drop=True))
    for history in estimate(dataset, workspace.plant(dataset), (DEADBAND,), later=[short]):
        assert len(history.values) == (rows == 200)
        for value, deviation in zip(history.values, history.deviations, strict=True):
            assert abs(value - 0.08) < 4.0 * deviation + 1e-3
