"""``sysid fleet gap`` from logs to its page: one machine differs, one drifts; the same on several processes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import run
from fleet_logs import write_fleet

from sysid.execution import LocalExecutor
from sysid.fleet import fleet_gap

BANDS = {
    "lift-1": [0.08] * 5,
    "lift-2": [0.08] * 5,
    "lift-3": [0.12] * 5,
    "lift-4": [0.08] * 5,
    "lift-5": [0.08] * 5 + [0.11] * 6,
}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_fleet(tmp_path_factory.mktemp("fleet"), BANDS)


@pytest.mark.slow
def test_the_command_names_what_differs_and_what_drifts(place: Path, tmp_path: Path) -> None:
    words = ("fleet", "gap", *BANDS, "--json", tmp_path / "fleet.json", "--fail-on", "drift")
    assert run("--workspace", place, *words) == 3
    result = json.loads((tmp_path / "fleet.json").read_text("utf-8"))
    named = {effect["name"]: effect["named_on"] for effect in result["effects"]}
    assert named["valve_deadband"][:4] == ["lift-1", "lift-2", "lift-3", "lift-4"]  # lift-5 is a mixture
    assert all(machines == ["lift-5"] for name, machines in named.items() if name != "valve_deadband")
    assert any("lift-5" in note and "before and after" in note for note in result["notes"])
    for item in result["differences"]:
        assert item["differs"] == (item["effect"]["name"] == "valve_deadband")
        assert item["deviating"] == (["lift-3", "lift-5"] if item["differs"] else [])
    assert {(drift["machine"], drift["since"]) for drift in result["drifts"]} == {("lift-5", "run-05")}
    for drift in result["drifts"]:
        assert drift["before"] == pytest.approx(0.08, abs=5e-4)
        assert drift["after"] == pytest.approx(0.11, abs=5e-4)
    page = (place / "fleet" / "fleet.html").read_text("utf-8")
    assert "differ: lift-3, lift-5" in page
    assert page.count("<svg") >= 10

    again = fleet_gap(place, list(BANDS), executor=LocalExecutor(2)).to_json()
    for key in ("effects", "differences", "drifts", "histories"):  # to the digit, from the stored gap results
        assert json.loads(json.dumps(again[key])) == result[key]
