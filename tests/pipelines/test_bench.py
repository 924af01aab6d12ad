"""What `make bench` compares is comparable: every effect acts, the neighbours move the same machine as they are told."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from sysid.effects import CATALOGUE
from sysid.plant import Plant

PIPELINES = str(Path(__file__).parents[2] / "pipelines")


@pytest.fixture(scope="module")
def benchmarks() -> Iterator[dict[str, ModuleType]]:
    """The modules in pipelines/benchmarks, found as the pipeline finds them."""
    import importlib

    sys.path.insert(0, PIPELINES)
    try:
        yield {name: importlib.import_module(f"benchmarks.{name}") for name in ("rows", "crane", "peers", "history")}
    finally:
        sys.path.remove(PIPELINES)


@pytest.fixture(scope="module")
def plant(benchmarks: dict[str, ModuleType]) -> Plant:
    crane: Plant = benchmarks["crane"].crane()
    return crane


def test_a_ratio_above_one_is_better_whichever_way_the_unit_counts(benchmarks: dict[str, ModuleType]) -> None:
    row = benchmarks["rows"].row
    times = row("read", "peer", [1.0, 2.0, 4.0], [4.0, 4.0, 12.0])
    assert times["ratio"] == {"min": 2.0, "median": 3.0, "max": 4.0}
    assert (times["ours"], times["theirs"], times["unit"]) == (2.0, 4.0, "s")
    speeds = row("step", "peer", [8.0], [2.0], "steps/s", more_is_better=True)
    assert speeds["ratio"]["median"] == 4.0
    missed = benchmarks["rows"].against_limit("first", [20.0, 40.0], 10.0, "s")
    assert missed["peer"] == "limit of 10 s"
    assert missed["ratio"]["max"] == 0.5


def test_turns_alternate_after_one_run_that_does_not_count(benchmarks: dict[str, ModuleType]) -> None:
    calls: list[str] = []
    taken = benchmarks["rows"].in_turns({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, 2)
    assert calls == list("ababab")
    assert [len(times) for times in taken.values()] == [2, 2]


def test_a_ratio_that_falls_by_more_than_15_percent_is_told(benchmarks: dict[str, ModuleType], tmp_path: Path) -> None:
    row, history = benchmarks["rows"].row, benchmarks["history"]
    path = tmp_path / "history.json"
    before = [row("read", "peer", [1.0], [4.0]), row("read", "other", [1.0], [4.0])]
    lanes = [row("lanes", "peer", [1.0], [2.0], note=note) for note in ("one core", "two cores")]
    head = {"commit": "0123456789ab", "date": "2026-11-30", "machine": "a computer", "seed": None}
    history.write_history(path, [], head, [*before, *lanes])
    (known,) = history.read_history(path)
    assert known["ratios"] == {"read|peer": 4.0, "read|other": 4.0, "lanes|peer": 2.0, "lanes|peer|two cores": 2.0}
    assert set(known) == {"commit", "date", "machine", "ratios"}
    now = [row("read", "peer", [1.0], [3.3]), row("read", "other", [1.0], [3.5]), row("read", "limit of 1 s", [9.0], [1.0])]
    assert history.fallen(now, "a computer", [known]) == ["read|peer: 3.3, was 4 at 0123456789ab"]
    assert history.fallen(now, "another computer", [known]) == []
    history.write_history(path, [known], head, now)
    assert [len(each["ratios"]) for each in history.read_history(path)] == [4, 3]


def test_the_measured_plant_has_every_effect_of_a_valve_driven_crane(plant: Plant) -> None:
    absent = {effect.name for effect in CATALOGUE} - {item.name for item in plant.effects}
    elsewhere = {
        e.name for e in CATALOGUE if (e.actuations and "velocity" not in e.actuations) or e.of_links or e.described_only
    }
    assert absent == elsewhere
    for item in plant.effects:
        less = plant.without_effect(item.name, item.target, item.side)
        assert not np.array_equal(less.vector(), plant.vector()), f"{item.name} on {item.target} is neutral"


def test_an_effect_without_a_magnitude_is_refused(benchmarks: dict[str, ModuleType], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(benchmarks["crane"].AMOUNTS, "backlash")
    with pytest.raises(SystemExit, match="no magnitude for backlash: add one to AMOUNTS"):
        benchmarks["crane"].crane()


def test_the_measured_plant_moves_on_all_axes_and_swings(benchmarks: dict[str, ModuleType], plant: Plant) -> None:
    crane = benchmarks["crane"]
    log = crane.recorded(plant, 40.0)
    assert {*crane.read(plant.machine), *(f"{name}.command" for name in plant.machine.axis_names)} == set(log.signals)
    for axis in plant.machine.axes:
        values, (low, high) = log.values(axis.driven), axis.range
        assert np.nanmax(values) - np.nanmin(values) > 0.1 * (high - low)
    sideways = log.values("tool.y") - log.values("ee.y")
    assert np.nanmax(sideways) - np.nanmin(sideways) > 0.01


def test_neighbours_follow_the_same_commands_to_the_same_place(benchmarks: dict[str, ModuleType], plant: Plant) -> None:
    crane, peers = benchmarks["crane"], benchmarks["peers"]
    machine, start = plant.machine, crane.middle(plant.machine)
    speeds = crane.commands(15.0) * crane.joint_speeds(machine)
    mujoco = peers.MujocoCrane(machine, crane.RATE, start, 1)
    bullet = peers.BulletCrane(machine, str(crane.FOLDER / "autolog.urdf"), crane.RATE, start)
    states, steps = mujoco.rollout(speeds, 2), bullet.run(speeds)
    one_by_one = mujoco.step_by_step(np.repeat(speeds[:, None], 2, axis=1))
    settled = slice(500, None)
    peers.must_follow("MuJoCo", speeds[settled], mujoco.driven_speeds(states[0])[settled])
    peers.must_follow("PyBullet", speeds[settled], steps[settled, 4:8])
    np.testing.assert_allclose(one_by_one, states[:, -1], rtol=0, atol=1e-6)
    last = start + speeds.sum(axis=0) / crane.RATE
    np.testing.assert_allclose(steps[-1, :4], last, atol=0.05)
    np.testing.assert_allclose(states[0, -1, 1:5], last, atol=0.05)
    mujoco.close(), bullet.close()


def test_a_neighbour_that_stands_still_is_no_comparison(benchmarks: dict[str, ModuleType]) -> None:
    asked = np.ones((10, 4))
    with pytest.raises(SystemExit, match=r"PyBullet does not follow the commanded speeds: \[1\. 0\. 0\. 0\.\]"):
        benchmarks["peers"].must_follow("PyBullet", asked, asked * [0.0, 1.0, 1.0, 1.0])
