"""Flight logs that arrive one by one: new ones are identified, a drift is named, an interrupted log is used."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from threading import Event
from typing import Any

import pytest
from command_line import run
from lift_flights import fly, interrupt

from sysid.datasets import ingest
from sysid.errors import SettingsError, StoreError
from sysid.fleet import watch, watching
from sysid.fleet.effects import FleetEffect
from sysid.fleet.result import FleetMachine
from sysid.workspace import open_workspace

DEADBAND = FleetEffect("valve_deadband", "boom", None, ("positive", "negative"))
KEYS = ("histories", "drifts")
#: Seconds without a change after which a log without an end is complete here.
QUIET = 0.2


@pytest.fixture
def named(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The search for names is replaced by the hidden effect; the datasets for which it was made."""
    references: list[str] = []

    def name_effects(location: str, reference: str, plant: str | None) -> FleetMachine:
        references.append(reference)
        return FleetMachine(reference, "named", (DEADBAND,))

    monkeypatch.setattr(watching, "name_effects", name_effects)
    return references


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace with the first four flights of lift-1, beside them."""
    folder = tmp_path_factory.mktemp("first")
    for k in range(4):
        fly(folder, 0.08, k)
    ingest(folder / "flights", folder / "workspace", recipe=folder / "flights" / "recipe.toml", name="lift-1")
    return folder


@pytest.fixture
def place(first: Path, tmp_path: Path) -> Path:
    """The workspace in a copy of :func:`first`, which is ``tmp_path``."""
    shutil.copytree(first, tmp_path, dirs_exist_ok=True)
    return tmp_path / "workspace"


@contextmanager
def growing(path: Path) -> Iterator[None]:
    """A file that is written to all the time."""
    done = Event()

    def write() -> None:
        while not done.wait(0.05):
            with path.open("ab") as file:
                file.write(b".")

    with ThreadPoolExecutor(1) as pool:
        pool.submit(write)
        try:
            yield
        finally:
            done.set()


def test_flights_that_arrive_one_by_one(place: Path, tmp_path: Path, named: list[str]) -> None:
    flights = tmp_path / "flights"
    result = watch(place, "lift-1", [flights])
    assert (named, result.new, result.fleet.drifts) == (["lift-1@1"], (), ())
    seen: list[str] = []
    for k, band in enumerate((0.08, 0.08, 0.11, 0.11, 0.11, 0.11, 0.11, 0.11)):
        path = fly(tmp_path, band, 10 + k)
        if k == 3:
            interrupt(path, 0.6)
            with growing(path.parent / "notes.txt"):
                result = watch(place, "lift-1", [flights], quiet_s=1.0)
            assert (result.new, result.arrivals.waiting) == ((), (path.parent.name,))
        result = watch(place, "lift-1", [flights], quiet_s=QUIET)
        assert result.new == (path.parent.name,), result.arrivals
        assert [name for name, note in result.arrivals.notes if "cut off" in note] == [path.parent.name] * (k == 3)
        seen.append(path.parent.name)
        if result.noticed:
            break
    assert named == ["lift-1@1"]
    assert {(d.effect.name, d.since) for d in result.noticed} == {("valve_deadband", seen[2])}
    for drift in result.noticed:
        assert drift.before == pytest.approx(0.08, abs=1e-3)
        assert drift.after == pytest.approx(0.11, abs=1e-3)
    short = result.fleet.histories[0].recordings.index(seen[3])
    ends = result.fleet.histories[0].ends
    assert 0.4 < (ends[short] - ends[short - 1]) * 3600.0 / 40.0 < 0.75
    assert not watch(place, "lift-1", [flights]).new

    # All at once, from the version of the beginning: the same to the digit.
    kept = result.to_json()
    state = place / "fleet/watch/lift-1.json"
    before = state.read_text()
    values = json.loads(before)
    state.write_text(json.dumps({key: values[key] for key in ("schema", "machine", "plant")}))
    again = watch(place, "lift-1").to_json()
    for key in KEYS:
        assert again[key] == kept[key]
    assert state.read_text() == before


@pytest.mark.slow
def test_effects_of_machines_like_it_are_watched_as_well(place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ingest(tmp_path / "flights", place, recipe=tmp_path / "flights" / "recipe.toml", name="lift-2")

    def name_effects(location: str, reference: str, plant: str | None) -> FleetMachine:
        effects = (DEADBAND,) if reference == "lift-2@1" else ()
        return FleetMachine(reference, "named", effects)

    monkeypatch.setattr(watching, "name_effects", name_effects)
    assert not watch(place, "lift-1").fleet.histories
    found = watch(place, "lift-1", like=["lift-2"], restart=True).fleet
    assert [(m.name, m.effects) for m in found.machines] == [("lift-1", (DEADBAND,))]
    assert [h.parameter for h in found.histories] == ["positive", "negative"]


def test_a_log_that_cannot_be_used_does_not_hold_up_the_others(place: Path, tmp_path: Path, named: list[str]) -> None:
    flights = tmp_path / "flights"
    broken, whole = fly(tmp_path, 0.08, 20), fly(tmp_path, 0.08, 21)
    broken.write_bytes(b"no log")
    result = watch(place, "lift-1", [flights], quiet_s=QUIET)
    assert result.new == (whole.parent.name,)
    assert [name for name, _ in result.arrivals.left_out] == [broken.parent.name]


@pytest.mark.slow
def test_two_watchers_at_once_hold_each_recording_once(place: Path, tmp_path: Path, named: list[str]) -> None:
    flights = tmp_path / "flights"
    watch(place, "lift-1")
    paths = [fly(tmp_path, 0.08, 50 + k) for k in range(3)]
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda _: watch(place, "lift-1", [flights]), range(2)))
    held = watch(place, "lift-1", [flights])
    assert not held.new
    for history in held.fleet.histories:
        assert [history.recordings.count(path.parent.name) for path in paths] == [1, 1, 1]
    names = [recording.name for recording in open_workspace(place).dataset("lift-1").recordings]
    assert len(names) == len(set(names))


def test_another_plant_a_rebuilt_dataset_and_a_damaged_state_are_refused(place: Path, tmp_path: Path, named: list[str]) -> None:
    watch(place, "lift-1")
    workspace = open_workspace(place)
    plant = workspace.plant(workspace.dataset("lift-1"))
    other = workspace.models.register("lift", "plant", plant.with_effect(_deadband()).to_files(), {}).reference
    with pytest.raises(SettingsError, match="another simulation"):
        watch(place, "lift-1", plant=other)
    assert watch(place, "lift-1", plant=other, restart=True).new == ()
    with pytest.raises(SettingsError, match="without a version"):
        watch(place, "lift-1@1")
    state = place / "fleet/watch/lift-1.json"
    state.write_text(state.read_text()[:-20])
    with pytest.raises(StoreError, match="--restart"):
        watch(place, "lift-1")
    fly(tmp_path / "others", 0.08, 30)
    logs = tmp_path / "others" / "flights"
    watch(place, "lift-1", restart=True)
    for source in list(logs.glob("motion-*")):
        source.rename(source.with_name("motion-other"))
    ingest(logs, place, recipe=logs / "recipe.toml", name="lift-1")
    with pytest.raises(SettingsError, match="that continues lift-1@1"):
        watch(place, "lift-1")


def _deadband() -> Any:
    from sysid.machine import KnownEffect

    return KnownEffect("valve_deadband", "boom", {"positive": 0.02, "negative": 0.02})


@pytest.mark.slow
def test_the_command_from_names_to_the_alarm(place: Path, tmp_path: Path) -> None:
    flights = tmp_path / "flights"
    words = ("--workspace", place, "fleet", "watch", "lift-1", flights, "--json", tmp_path / "watch.json", "--fail-on", "new")
    assert run(*words) == 0
    codes = []
    for k in range(6):
        fly(tmp_path, 0.11, 40 + k)
        codes.append(run(*words))
    assert codes.count(3) == 1
    result = json.loads((tmp_path / "watch.json").read_text())
    assert {drift["effect"]["name"] for drift in result["drifts"]} == {"valve_deadband"}
    assert result["dataset"] == "lift-1@7"
    assert "lift-1" in (place / "fleet/watch/lift-1.html").read_text()
