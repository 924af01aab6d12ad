"""What a dataset has of what an effect needs, counted by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plant_data import Array, KnownEffect, arm, dataset_of, measured, nominal

from sysid.datasets.quality.use import turning_points
from sysid.datasets.recording import Dataset, Recording
from sysid.effects import CATALOGUE, effect_named
from sysid.effects.effect import Stage
from sysid.gap import find_gap
from sysid.gap.candidates import Candidate, Scales, candidates_at
from sysid.gap.excitation import advice, excitation_at, excitation_of, identifiable_targets, moved
from sysid.plant import Plant


def candidate(name: str, target: str) -> Candidate:
    plant: Plant = nominal()
    if effect_named(name).target == "stream":
        plant = replace(plant, streams={target: ("boom.joint",)})
    scales = Scales(loads=dict.fromkeys(arm().axis_names, 1.0))
    stages: tuple[Stage, ...] = ("command", "force", "joint", "end_effector", "tool")
    found = [c for s in stages for c in candidates_at(plant, plant.vector(), (s,), (target,), scales) if c.effect.name == name]
    return found[0]


def recording(**columns: object) -> Recording:
    values = {name.replace("_", "."): np.asarray(v, dtype=float) for name, v in columns.items()}
    count = max(v.size for v in values.values())
    table = {"time": np.arange(count) / 100.0} | {k: np.broadcast_to(v, count) for k, v in values.items()}
    return Recording("made", pd.DataFrame(table), 100.0)


def have(name: str, target: str, made: Recording) -> float:
    return excitation_of(candidate(name, target), [made], arm()).have


def test_reversals() -> None:
    """Six strokes have five reversals; a tremor of half a percent of the travel has none."""
    strokes = np.concatenate([np.linspace(0, 1, 100), np.linspace(1, 0, 100)] * 3)
    tremor = 0.005 * np.sin(np.arange(600))
    assert have("backlash", "slew", recording(slew_joint=strokes)) == 5
    assert have("backlash", "slew", recording(slew_joint=strokes + tremor)) == 5


@given(st.lists(st.floats(0.2, 1.0), min_size=2, max_size=12))
def test_turning_points_of_a_zigzag(strokes: list[float]) -> None:
    corners = np.concatenate([[0.0], np.cumsum([s * (-1) ** k for k, s in enumerate(strokes)])])
    path = np.interp(np.arange(0, len(strokes), 0.05), np.arange(len(corners)), corners)
    path = np.append(path, corners[-1])
    assert turning_points(path, 0.1) == len(strokes) - 1


def test_nothing_moves_nothing_turns() -> None:
    assert turning_points(np.ones(10), 0.0) == 0


def test_small_commands_on_the_poorer_side() -> None:
    command = np.concatenate([np.full(300, 0.2), np.full(100, -0.2), np.full(500, -0.9), np.zeros(200)])
    assert have("valve_deadband", "slew", recording(slew_command=command)) == pytest.approx(1.0)


def test_changes_of_the_command() -> None:
    command = np.concatenate([np.zeros(50), np.full(50, 0.5), np.full(50, -0.5), np.full(50, 0.004), np.full(50, 0.3)])
    assert have("input_delay", "slew", recording(slew_command=command)) == 4, "start, reversal, stop, start"


def test_seconds_of_motion_and_rest() -> None:
    command = np.concatenate([np.zeros(400), np.full(300, 0.5), np.full(100, -0.5)])
    made = recording(boom_command=command)
    assert have("internal_leakage", "boom", made) == pytest.approx(4.0)
    assert have("gain_error", "boom", made) == pytest.approx(4.0)
    assert have("asymmetric_gain", "boom", made) == pytest.approx(1.0)


def test_coverage_of_the_joint_range() -> None:
    made = recording(slew_joint=np.linspace(-1.3, 1.3, 50), boom_joint=np.linspace(0, 0.183, 50), wrist_joint=0.0)
    assert have("joint_offset", "slew", made) == pytest.approx(50.0)
    assert have("link_length_error", "boom", made) == pytest.approx(10.0)
    assert have("base_misalignment", "base", made) == pytest.approx(0.0), "the axis that moved least"


@pytest.mark.parametrize(
    ("values", "moves"),
    [
        (np.zeros(500), False),
        (0.3 + 1e-16 * np.arange(500) % 3, False),
        (0.3 + 2e-4 * np.random.default_rng(0).normal(size=500), False),
        (np.linspace(0.0, 0.004, 500), False),
        (np.linspace(0.0, 0.2, 500), True),
        (np.full(500, np.nan), False),
    ],
    ids=["zero", "rounding", "noise", "under a thousandth of its limits", "four percent", "not measured"],
)
@pytest.mark.parametrize("sheet", [True, False])
def test_whether_an_axis_moved(values: Array, moves: bool, sheet: bool) -> None:
    machine = arm() if sheet else replace(arm(), noise={})
    assert moved([recording(slew_joint=values)], machine, "slew") == moves


def test_an_axis_without_limits_moves_beyond_its_noise() -> None:
    axis = replace(arm().axes[0], limits=None)
    machine = replace(arm(), noise={}, axes=(axis, *arm().axes[1:]))
    tremor = 1e-3 * np.random.default_rng(0).normal(size=3000)
    assert not moved([recording(slew_joint=tremor)], machine, "slew")
    assert moved([recording(slew_joint=tremor + 0.1 * np.sin(0.01 * np.arange(3000)))], machine, "slew")


@pytest.mark.parametrize("frequency", [1.0, 3.1, 4.7])
def test_a_motion_too_fast_for_the_rate_is_a_motion(frequency: float) -> None:
    time = np.arange(300) / 10.0
    table = pd.DataFrame({"time": time, "slew.joint": 0.4 * np.sin(2.0 * np.pi * frequency * time)})
    assert moved([Recording("slow", table, 10.0)], replace(arm(), noise={}), "slew")


def test_poses_apart_are_a_motion_and_a_single_one_is_none() -> None:
    def poses(*places: float) -> Recording:
        table = {"time": 5.0 * np.arange(len(places)), "boom.joint": places}
        return Recording("poses", pd.DataFrame(table), 0.2, "poses")

    assert not moved([poses(0.4)], arm(), "boom")
    assert not moved([poses(0.4, 0.4001, 0.3999)], arm(), "boom")
    assert moved([poses(0.4, 0.9, 0.1)], arm(), "boom")
    assert moved([poses(0.4), poses(0.7)], arm(), "boom")


def test_only_what_moved_can_get_a_name() -> None:
    still = [recording(slew_joint=np.linspace(0, 1, 100), boom_joint=0.4, wrist_joint=0.1)]
    targets = ("slew", "slew.joint", "boom", "boom.cylinder", "wrist.joint", "machine", "base", "tool", "ee.x", "capture")
    shown = ("slew", "slew.joint", "base", "tool", "ee.x", "capture")
    assert identifiable_targets(targets, still, arm()) == shown
    assert identifiable_targets(targets, [recording(slew_joint=0.1)], arm()) == ()


def test_no_effect_of_an_axis_that_stands_still_is_excited() -> None:
    """Whatever else is counted: seconds at rest, commands that led to nothing, other axes that moved."""
    command = np.where(np.arange(4000) // 200 % 2, 0.3, -0.3)
    made = recording(
        boom_command=command,
        boom_cylinder=0.06,
        boom_joint=0.4,
        slew_command=command,
        slew_joint=np.sin(0.01 * np.arange(4000)),
    )
    for effect in CATALOGUE:
        target = {"axis": "boom", "signal": "boom.joint"}.get(effect.target)
        if target is not None and "velocity" in (effect.actuations or ("velocity",)):
            item = excitation_at(effect, target, [made], arm())
            assert not item.sufficient, effect.name
            assert advice(item, arm()) == (
                "boom did not move (0 % of its range, at least 0.1 needed), so that no effect on it or on its "
                "sensors is identifiable. "
                "Record boom moving over its range in both directions."
            )
    assert excitation_at(effect_named("gain_error"), "slew", [made], arm()).sufficient


def test_an_axis_that_stands_still_gets_no_name_and_one_line_of_advice() -> None:
    """A sensor that reads 4.18 degrees too much shows in every pose of one posture: so does any other cause."""
    truth = nominal(
        KnownEffect("sensor_bias", "wrist.joint", {"bias": 0.073}), KnownEffect("gain_error", "slew", {"ratio": 0.8})
    )
    parts = []
    for k, r in enumerate(dataset_of(truth, 12.0).recordings):
        table = r.table.assign(**{"wrist.command": 0.2, "wrist.joint": np.nan})
        table["wrist.joint"] = np.where(table["time"] < 0.2, 0.273, np.nan)
        parts.append(measured(truth, replace(r, table=table), k))
    splits = dataset_of(truth, 1.0).splits
    dataset = Dataset.of(arm(), parts, splits)
    result = find_gap(dataset, nominal())
    assert {(e.name, e.target) for e in result.effects} == {("gain_error", "slew")}
    assert not any(e.sufficient for e in result.excitation if e.target in ("wrist", "wrist.joint"))
    assert sum(text.startswith("wrist did not move (") for text in result.next_experiment) == 1
    assert not any("Sensor bias of wrist" in text for text in result.next_experiment)


def test_motion_of_the_tip() -> None:
    x = np.concatenate([np.zeros(300), np.linspace(0.0, 0.5, 200), np.full(300, 0.5)])
    assert have("gripper_sway", "tool", recording(ee_x=x, ee_y=0.0, ee_z=0.0)) == pytest.approx(2.2, abs=0.25)


def test_a_missing_signal_counts_as_nothing() -> None:
    empty = recording(slew_joint=np.full(100, np.nan))
    for effect in CATALOGUE:
        axis = "wrist" if effect.actuations == ("position",) else "boom"
        target = {"axis": axis, "signal": "boom.joint", "stream": "capture"}.get(effect.target, effect.target)
        servo = effect.actuations == ("servo",)  # the arm has no servo axis
        if effect.stage not in ("force", "links") and effect.fitted and not effect.described_only and not servo:
            item = excitation_of(candidate(effect.name, target), [empty], arm())
            assert item.have <= 1.0, "rest is all that a still machine shows"
            assert not item.sufficient


def test_advice_says_what_there_is_and_what_to_record() -> None:
    item = excitation_of(candidate("backlash", "slew"), [recording(slew_joint=np.linspace(0, 1, 100))], arm())
    assert advice(item, arm()) == (
        "Backlash of slew: 0 reversals, about 8 needed. "
        "Record 20 slow reversals of slew, with at least 5 % of its range between them."
    )


@pytest.mark.slow
def test_an_effect_that_nothing_excites_is_not_tried_but_reported() -> None:
    """The slew only turns one way: play cannot show, and is said to lack reversals."""
    truth = nominal(KnownEffect("gain_error", "slew", {"ratio": 0.8}))
    dataset = dataset_of(truth, 10.0)
    one_way = []
    for r in dataset.recordings:
        turned = 0.05 * np.arange(len(r)) / 100.0
        columns = {"slew.command": np.full(len(r), 0.05 / (0.8 * 0.436)), "slew.joint": turned}
        noise = np.random.default_rng(0).normal(0, 2e-4, len(r))
        table = r.table[["time"]].assign(**columns)
        one_way.append(Recording(r.name, table.assign(**{"slew.joint": turned + noise}), 100.0))
    result = find_gap(type(dataset).of(arm(), one_way, dataset.splits), nominal())
    lacking = {(e.name, e.target) for e in result.excitation if not e.sufficient}
    assert {("backlash", "slew"), ("valve_deadband", "slew"), ("asymmetric_gain", "slew")} <= lacking
    assert not {(e.name, e.target) for e in result.effects} & lacking
    assert any(text.startswith("Backlash of slew: 0 reversals") for text in result.next_experiment)
