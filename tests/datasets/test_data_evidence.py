"""What a dataset offers an identification, counted on motions made for it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sysid.datasets import ingest
from sysid.datasets.quality.evidence import evidence_of
from sysid.datasets.quality.noise import noise_of, table_noise
from sysid.datasets.quality.use import AxisUse, Scale, level_of, reversals, together, turning_points, use_of
from sysid.datasets.recording import Dataset, Kind, Recording
from sysid.machine import Machine, machine_from_files

Array = npt.NDArray[np.float64]

MACHINE = """
schema = 1
name = "two"
rate_hz = 100.0
[noise]
"lift.joint" = 1e-3
[[axes]]
name = "turn"
actuation = "velocity"
drives = "joint"
gain = 0.5
limits = [-2.0, 2.0]
[[axes]]
name = "lift"
actuation = "velocity"
drives = "joint"
gain = 0.5
limits = [0.0, 1.0]
"""


def machine() -> Machine:
    return machine_from_files({"machine.toml": MACHINE}, "two")


def recording(name: str, columns: Mapping[str, object], kind: Kind = "motion") -> Recording:
    arrays = {k: np.atleast_1d(np.asarray(v, dtype=float)) for k, v in columns.items()}
    count = max(len(v) for v in arrays.values())
    table = {"time": np.arange(count) / 100.0, **{k: np.broadcast_to(v, count) for k, v in arrays.items()}}
    return Recording(name, pd.DataFrame(table), 100.0, kind)


def dataset(*recordings: Recording, **splits: str) -> Dataset:
    return Dataset.of(machine(), recordings, splits)  # type: ignore[arg-type]


def driven(command: Array, start: float = 0.0, noise: float = 0.0, seed: int = 0) -> Array:
    path = start + np.concatenate([[0.0], np.cumsum(0.5 * np.nan_to_num(command)[:-1]) / 100.0])
    return path + np.random.default_rng(seed).normal(0.0, noise, len(command)) if noise else path


def use(command: Array, moved: Array, top_speed: float = 0.5) -> AxisUse:
    made = recording("made", {"turn.command": command, "turn.joint": moved})
    return use_of(made, machine().axis("turn"), Scale(1.0, top_speed))


steps = st.lists(st.tuples(st.sampled_from([-1.0, -0.6, -0.2, 0.0, 0.1, 0.35, 0.8, 1.0]), st.integers(20, 120)), min_size=2)


@given(steps)
def test_every_second_is_counted_once(parts: list[tuple[float, int]]) -> None:
    command = np.concatenate([np.full(count, value) for value, count in parts])
    found = use(command, driven(command))
    total = len(command) / 100.0
    assert found.idle_s + found.positive_s + found.negative_s == pytest.approx(total)
    assert sum(found.seconds) == pytest.approx(found.positive_s + found.negative_s)
    assert found.small_positive_s <= found.positive_s + 1e-9
    assert found.small_negative_s <= found.negative_s + 1e-9
    assert found.slow_positive_s + found.slow_negative_s <= total
    assert 0.0 <= found.covered(1) <= 1.0


@given(steps)
def test_the_mirrored_motion_swaps_the_sides(parts: list[tuple[float, int]]) -> None:
    command = np.concatenate([np.full(count, value) for value, count in parts])
    one, other = use(command, driven(command)), use(-command, -driven(command))
    assert (one.positive_s, one.small_positive_s, one.slow_positive_s) == (
        other.negative_s,
        other.small_negative_s,
        other.slow_negative_s,
    )
    assert (one.reversals, one.command_changes) == (other.reversals, other.command_changes)
    # A command on the edge between two cells counts to the right one, mirrored to the other: only the sum is the same.
    assert sum(one.seconds) == pytest.approx(sum(other.seconds))


@given(steps, steps)
def test_recordings_add_up(first: list[tuple[float, int]], second: list[tuple[float, int]]) -> None:
    uses = [use(u, driven(u)) for parts in (first, second) for u in [np.concatenate([np.full(n, v) for v, n in parts])]]
    both = together(uses)
    assert both.reversals == uses[0].reversals + uses[1].reversals
    assert both.idle_s == pytest.approx(uses[0].idle_s + uses[1].idle_s)
    np.testing.assert_allclose(both.seconds, np.add(uses[0].seconds, uses[1].seconds))
    assert both.full == 1.0


def most_turning_points(values: list[float], least: float) -> int:
    """Of all ways to choose samples between which the signal goes up and down by more than ``least``, the most turns."""
    up, down = [1] * len(values), [1] * len(values)  # samples of the longest way that ends here, by its last direction
    for k, value in enumerate(values):
        up[k] = max([1, *(down[i] + 1 for i in range(k) if value - values[i] > least)])
        down[k] = max([1, *(up[i] + 1 for i in range(k) if values[i] - value > least)])
    return max(0, max(up + down) - 2)


@given(
    st.lists(st.integers(-5, 5), min_size=1, max_size=60), st.sampled_from([0.5, 1.0, 2.5, 4.0]), st.sampled_from([1, 3, 64])
)
def test_turning_points_are_those_of_the_definition(values: list[int], least: float, few: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sysid.datasets.quality.use._FEW", few)  # pieces shorter than the signal
        found = turning_points(np.array(values, dtype=float), least)
    assert found == most_turning_points([float(v) for v in values], least)


def test_nothing_cannot_be_added_up() -> None:
    with pytest.raises(ValueError, match="no use"):
        together([])


@given(strokes=st.integers(1, 8), noise=st.sampled_from([0.0, 1e-4, 2e-3, 1e-2]), seed=st.integers(0, 50))
def test_reversals_are_those_of_the_motion_whatever_the_noise(strokes: int, noise: float, seed: int) -> None:
    corners = np.array([0.0, 0.5] * strokes)
    path = np.interp(np.linspace(0.0, len(corners) - 1.0, 150 * len(corners)), np.arange(len(corners)), corners)
    noisy = path + np.random.default_rng(seed).normal(0.0, max(noise, 1e-9), len(path))
    assert reversals(noisy, 100.0) == len(corners) - 2


@given(noise=st.floats(1e-5, 1e-1), seed=st.integers(0, 200))
def test_a_sensor_at_rest_does_not_reverse(noise: float, seed: int) -> None:
    assert reversals(1.0 + np.random.default_rng(seed).normal(0.0, noise, 6000), 100.0) <= 2


def test_noise_of_a_slow_sensor_is_not_lost_between_its_samples() -> None:
    rng = np.random.default_rng(0)
    slow = np.arange(0.0, 60.0, 1.0 / 19.0)
    time = np.arange(0.0, 59.0, 0.02)
    table = np.interp(time, slow, 0.05 * np.sin(0.3 * slow) + rng.normal(0.0, 1e-4, len(slow)))
    assert noise_of(table, 50.0) < 0.5e-4, "a table between the samples is smooth"
    assert table_noise(table, 50.0) == pytest.approx(1e-4, rel=0.35)
    assert table_noise(np.ones(3), 50.0) == 0.0


def test_small_commands_and_slow_motion_are_counted_per_side() -> None:
    command = np.concatenate([np.full(300, 0.2), np.full(200, -0.05), np.full(400, -0.9), np.zeros(100)])
    found = use(command, driven(command))
    assert (found.small_positive_s, found.small_negative_s) == pytest.approx((3.0, 2.0))
    assert (found.slow_positive_s, found.slow_negative_s) == pytest.approx((0.0, 2.0), abs=0.15), (
        "slow: below a tenth of the top"
    )
    assert (found.covered(1), found.covered(-1)) == (0.1, 0.2)


def test_a_missing_command_is_neither_idle_nor_given() -> None:
    command = np.concatenate([np.full(100, np.nan), np.zeros(100), np.ones(100)])
    found = use(command, driven(command))
    assert (found.idle_s, found.positive_s) == pytest.approx((1.0, 1.0))
    assert set(level_of(command)) == {0.0, 1.0}


def test_coverage_of_a_pair_and_of_poses() -> None:
    """A diagonal visits one cell in ten; poses in the opposite corner visit one more; a shorter visit is none."""
    along = np.linspace(0.001, 0.999, 1000)
    motion = recording("run", {"turn.command": 0.1, "lift.command": 0.1, "turn.joint": 4.0 * along - 2.0, "lift.joint": along})
    poses = recording("poses", {"turn.joint": np.full(3, 1.9), "lift.joint": 0.05}, "poses")
    (pair,) = evidence_of(dataset(motion, poses, run="fit")).maps
    assert (pair.first.axis, pair.second.axis) == ("turn", "lift")
    assert pair.covered_moving == pytest.approx(0.10)
    assert pair.covered == pytest.approx(0.11)
    assert pair.poses[9][0] == 3
    flash = recording(
        "run", {"turn.command": 0.1, "lift.command": 0.1, "turn.joint": np.repeat(along, 1)[:10], "lift.joint": 0.5}
    )
    assert evidence_of(dataset(flash, run="fit")).maps[0].covered == 0.0


def test_an_axis_without_limits_is_measured_against_itself() -> None:
    bare = machine_from_files({"machine.toml": MACHINE.replace("limits = [-2.0, 2.0]\n", "")}, "two")
    made = recording("run", {"turn.command": 1.0, "lift.command": 1.0, "turn.joint": np.linspace(0, 3, 50), "lift.joint": 0.5})
    spans = evidence_of(replace(dataset(made, run="fit"), machine=bare)).spans
    assert [(s.source, s.covered) for s in spans] == [("recorded", 1.0), ("limits", 0.0)]


def test_still_phases_and_their_postures() -> None:
    """Stop for two seconds at three places, two of them alike; half a second is no phase."""
    command = np.concatenate([np.zeros(200), np.full(200, 0.5), np.zeros(200), np.full(200, -0.5), np.zeros(200), np.ones(100)])
    command = np.concatenate([command, np.zeros(50), np.ones(50)])
    turn = driven(command, noise=1e-3)
    made = recording("run", {"turn.command": command, "lift.command": 0.0, "turn.joint": turn, "lift.joint": 0.4})
    found = evidence_of(dataset(made, run="fit"))
    (single,) = found.recordings
    assert [round(rest.from_s) for rest in single.rests] == [0, 4, 8]
    assert [rest.seconds for rest in single.rests] == pytest.approx([2.0, 2.0, 2.0], abs=0.3)
    assert len(found.postures) == 2
    places = sorted(rest.posture["turn"] for rest in found.postures)
    assert places == pytest.approx([0.0, 0.5], abs=2e-3)
    assert found.noise["turn.joint"].still == pytest.approx(1e-3, rel=0.2)
    assert found.noise["lift.joint"].sheet == 1e-3


@pytest.mark.parametrize("most", [2**18, 300])
def test_the_same_commands_again_show_what_does_not_repeat(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two runs of one command, the second half a second later and 5 % faster; a third does something else.

    Args:
        most: rows above which a shift is first searched on means.
    """
    monkeypatch.setattr("sysid.datasets.quality.evidence.MOST_ROWS", most)
    rng = np.random.default_rng(3)
    command = np.repeat(rng.choice([-1.0, -0.5, 0.0, 0.5, 1.0], 30), 40)
    late = np.concatenate([np.zeros(50), command])
    other = np.repeat(rng.choice([-1.0, -0.5, 0.0, 0.5, 1.0], 30), 40)
    runs = [
        recording(name, {"turn.command": u, "lift.command": 0.0, "turn.joint": path, "lift.joint": 0.4})
        for name, u, path in (
            ("a", command, driven(command)),
            ("b", late, 1.05 * driven(late)),
            ("c", other, driven(other)),
        )
    ]
    found = evidence_of(dataset(*runs, a="fit", b="fit", c="fit"))
    (repeat,) = found.repeats
    assert (repeat.first, repeat.second, repeat.shift_s) == ("a", "b", pytest.approx(0.5))
    expected = 0.05 * np.sqrt(np.mean((driven(command) - driven(command)[0]) ** 2) / 2.0)
    assert repeat.spread["turn.joint"] == pytest.approx(expected, rel=0.1)
    assert "lift.joint" not in repeat.spread, "it was not commanded"
    assert found.noise["turn.joint"].repeats == repeat.spread["turn.joint"]
    assert found.noise["lift.joint"].repeats is None


def test_time_together_is_counted_for_each_pair() -> None:
    command = np.concatenate([np.ones(300), np.zeros(300)])
    shifted = np.roll(command, 100)
    made = recording(
        "run", {"turn.command": command, "lift.command": shifted, "turn.joint": driven(command), "lift.joint": 0.4}
    )
    assert evidence_of(dataset(made, run="fit")).together_s == {("turn", "lift"): pytest.approx(2.0)}


def test_json_is_plain_and_says_its_thresholds() -> None:
    made = recording(
        "run", {"turn.command": 0.3, "lift.command": 0.0, "turn.joint": np.linspace(0, 1, 300), "lift.joint": np.nan}
    )
    value = evidence_of(dataset(made, run="fit")).to_json()
    again = json.loads(json.dumps(value, allow_nan=False))
    assert again["recordings"]["run"]["role"] == "fit"
    assert again["thresholds"]["small_command"] == [0.02, 0.4]
    assert again["axes"]["turn"]["small_positive_s"] == pytest.approx(3.0)
    assert "lift" not in again["ranges"], "not measured"


def test_a_dataset_of_poses_alone_has_evidence() -> None:
    poses = recording("poses", {"turn.joint": np.linspace(-1, 1, 30), "lift.joint": 0.5}, "poses")
    found = evidence_of(dataset(poses))
    assert found.axes == {}
    assert found.recordings[0].poses == 30
    assert found.maps[0].covered > 0.0
    json.dumps(found.to_json(), allow_nan=False)


def test_the_excavator_repeats_its_steps_worse_than_its_sensors_read(shared_data: Path, tmp_path: Path) -> None:
    recipe = Path(__file__).parents[2] / "datasets" / "rc_excavator" / "recipe.toml"
    found = evidence_of(ingest(shared_data / "rc_excavator", tmp_path, recipe=recipe))
    assert len(found.repeats) == 9, "three files of three step tests"
    for axis in ("boom", "stick", "bucket"):
        noise = found.noise[f"{axis}.cylinder"]
        assert noise.moving is not None
        assert noise.repeats is not None
        assert 2.0 * noise.moving < noise.repeats < 1e-3
        assert found.axes[axis].reversals < 100, "not the thousand turns of the potentiometer's noise"


@given(sigma=st.floats(1e-6, 1e-2), seed=st.integers(0, 1000))
def test_noise_is_found_under_motion(sigma: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 60.0, 0.01)
    motion = 0.3 * sigma * 1e3 * np.sin(0.7 * time)
    assert noise_of(motion + sigma * rng.normal(size=len(time)), 100.0) == pytest.approx(sigma, rel=0.15)


def test_noise_needs_stretches_without_gaps() -> None:
    values = np.random.default_rng(0).normal(size=1000)
    values[::5] = np.nan
    assert np.isnan(noise_of(values, 100.0))
    values[400:600] = 0.0
    assert noise_of(values, 100.0) == pytest.approx(0.0, abs=1e-12)


def test_the_noise_of_a_counting_sensor_is_that_of_its_step() -> None:
    time = np.arange(0.0, 60.0, 0.05)
    counts = 3.6e-4 * np.round(np.where((time > 20) & (time < 25), 0.08 + 0.005 * (time - 20), 0.08) / 3.6e-4)
    assert noise_of(counts, 20.0) == pytest.approx(3.6e-4 / np.sqrt(12.0), rel=0.5)  # 50 samples move
