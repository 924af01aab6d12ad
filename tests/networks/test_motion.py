"""Command → motion networks on a lift with a dead-band and a lag: free runs, their bounds, and what they are chosen by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lift_motion import RATE, dataset, lift, recording, with_roles
from numpy.typing import NDArray

from sysid.datasets.recording import Dataset, Recording
from sysid.errors import ExcitationError, SettingsError, StoreError
from sysid.networks import Mlp, MotionNetwork, Normalisation, fit_motion, from_files, parse_recipe, to_files
from sysid.networks.member import LearningCurve
from sysid.networks.motion import free_run_rmse, motion_rows, window_for
from sysid.networks.motion_inputs import MotionBounds, MotionStretch, Window, horizon_errors, whole_run, window_of
from sysid.validate import validate_model
from sysid.validate.validation import ARX, PLANT, output_name

Array = NDArray[np.float64]
MOTION = {
    "step": 0.06,
    "history": [0.0, 0.06, 0.12, 0.18],
    "speeds": [0.06, 0.12],
    "hidden": [16, 16],
    "members": 2,
    "samples": 1500,
    "horizons": [0.6, 1.8],
    "training": {"learning_rate": 5e-3, "batch": 64, "epochs": 30},
}
QUICK = parse_recipe({"motion": MOTION}, "test")


@pytest.fixture(scope="module")
def data() -> Dataset:
    return dataset()


@pytest.fixture(scope="module")
def network(data: Dataset) -> MotionNetwork:
    return fit_motion(data, QUICK)["boom"]


def test_free_runs_beat_the_nominal_simulation_and_a_linear_model(data: Dataset, network: MotionNetwork) -> None:
    """The dead-band is in neither of them."""
    report = validate_model({"boom": network}, data, recipe=QUICK, name="lift-motion@1")
    assert report.kind == "motion"
    assert [entry.output for entry in report.outputs] == [output_name("boom.cylinder", h) for h in (0.6, 1.8, None)]
    for entry in report.outputs:
        assert set(entry.baselines) == {ARX, PLANT}
        assert entry.metrics.rmse < 0.6 * entry.baselines[PLANT].rmse
        assert entry.metrics.rmse < 0.8 * entry.baselines[ARX].rmse
        assert entry.noise_floor == pytest.approx(2e-5 * np.sqrt(2.0))
        assert entry.recordings == ("run-3",)
    own = free_run_rmse(network, data, "held_out", (0.6, 1.8))
    assert own["0.6"] == pytest.approx(report.outputs[0].metrics.rmse, rel=0.05)
    assert own["whole"] == pytest.approx(report.outputs[2].metrics.rmse, rel=0.05)


def test_a_simulation_that_is_right_has_no_error_beside_the_noise() -> None:
    """Without dead-band and lag the nominal simulation is the machine."""
    data = dataset(deadband=0.0, lag=0.0)
    report = validate_model({"boom": linear_network()}, data, recipe=QUICK)
    for entry in report.outputs:
        assert entry.baselines[PLANT].rmse < 4e-5, entry.output
        assert entry.metrics.rmse < 1.5e-4, "the network is the gain; inside its steps it draws straight lines"


def test_the_better_free_run_is_kept(network: MotionNetwork) -> None:
    assert [candidate.speeds for candidate in network.candidates] == [True, False]
    (kept,) = [candidate for candidate in network.candidates if candidate.kept]
    assert kept.score == min(candidate.score for candidate in network.candidates)
    assert (len(network.window.edges) > 1) == kept.speeds
    assert set(kept.free_run) == {"0.6", "1.8", "whole"}


def test_the_seed_decides_and_held_out_rows_do_not(data: Dataset, network: MotionNetwork) -> None:
    run = data.recording("run-3")
    changed = replace(run, table=run.table.assign(**{"boom.cylinder": 0.1}))
    others = with_roles(tuple(changed if r.name == "run-3" else r for r in data.recordings))
    files = to_files({"boom": network})
    assert files[0] == "motion"
    assert to_files(fit_motion(others, QUICK)) == files


def test_a_free_run_looks_at_nothing_that_was_measured_after_its_start(data: Dataset, network: MotionNetwork) -> None:
    run = data.recording("run-3")
    said = network.free_run(run)
    start = int(np.flatnonzero(np.isfinite(said))[0])
    assert start == network.window.depth * network.window.stride(RATE)
    values = run.values("boom.cylinder").copy()
    values[start + 5 :] += 0.05
    np.testing.assert_array_equal(network.free_run(replace(run, table=run.table.assign(**{"boom.cylinder": values}))), said)


def test_steps_one_by_one_are_the_same_run(network: MotionNetwork) -> None:
    commands = np.r_[np.zeros(network.window.depth), np.random.default_rng(0).uniform(-1, 1, 60)]
    run = network.roll(commands[None], np.full((1, network.window.depth + 1), 0.07))[0]
    stream = network.stream(0.07)
    np.testing.assert_allclose([stream.step(u) for u in commands[network.window.depth :]], run[1:], atol=1e-12)


def test_a_gap_of_the_command_starts_a_new_run(network: MotionNetwork) -> None:
    run = recording("run-9", 9)
    command = run.values("boom.command").copy()
    command[700:760] = np.nan
    holed = replace(run, table=run.table.assign(**{"boom.command": command}))
    said, stride, depth = network.free_run(holed), network.window.stride(RATE), network.window.depth
    assert np.isfinite(said[690])
    assert np.isnan(said[705 : 760 + depth * stride]).all()
    again = 760 + depth * stride
    assert said[again] == pytest.approx(run.values("boom.cylinder")[again])
    measured = run.values("boom.cylinder").copy()
    measured[300:400] = np.nan
    unseen = replace(run, table=run.table.assign(**{"boom.cylinder": measured}))
    np.testing.assert_array_equal(network.free_run(unseen), network.free_run(run), "a gap of the sensor is none of the run")


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    size=st.sampled_from([0.1, 10.0, 1e4]),
    follows=st.booleans(),
    commands=st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40),
)
def test_a_free_run_is_bounded_whatever_the_network_says(seed: int, size: float, follows: bool, commands: list[float]) -> None:
    network = wild(seed, size, follows)
    depth, step = network.window.depth, network.window.step
    run = network.roll(np.r_[np.zeros(depth), commands][None], np.full((1, depth + 1), 0.1))[0]
    assert np.isfinite(run).all()
    assert run.min() >= 0.0
    assert run.max() <= 0.2
    speeds = np.diff(run) / step
    assert speeds.min() >= -0.3 - 1e-9
    assert speeds.max() <= 0.4 + 1e-9


@settings(max_examples=40, deadline=None)
@given(
    holes=st.lists(st.tuples(st.booleans(), st.integers(0, 59), st.integers(1, 3)), max_size=4),
    stride=st.integers(1, 3),
    ahead=st.integers(0, 4),
)
def test_rows_never_reach_over_a_gap_or_an_end(holes: list[tuple[bool, int, int]], stride: int, ahead: int) -> None:
    command, position = np.arange(60.0), 100.0 + np.arange(60.0)
    for in_command, begin, length in holes:
        (command if in_command else position)[begin : begin + length] = np.nan
    window = Window(stride / 10.0, (0, 1, 3), (0, 2))
    motion = MotionStretch.of(command, position, stride)
    found = set(motion.starts(window, ahead).tolist())
    for at in range(60):
        last = max(1, ahead)
        lags = range(-ahead + 1, 4) if ahead else window.commands
        edges = range(3) if ahead else window.edges
        needed = [at + last * stride, *(at - edge * stride for edge in edges)]
        steps = [at - lag * stride + k for lag in lags for k in range(stride)]
        fine = (
            at >= 3 * stride
            and at + last * stride < 60
            and np.isfinite(position[needed]).all()
            and np.isfinite(command[steps]).all()
        )
        assert (at in found) == bool(fine), at
    if found and not ahead:
        x, y = motion.rows(window, np.array(sorted(found)))
        assert np.isfinite(x).all()
        np.testing.assert_allclose(y, 10.0)
        np.testing.assert_allclose(x[:, 3], 10.0)
        np.testing.assert_allclose(x[:, 0] - x[:, 2], 3.0 * stride)


def test_times_are_rounded_to_steps_and_steps_to_samples() -> None:
    """So that one recipe does for logs of any rate."""
    recipe = parse_recipe({}, "test").motion
    assert window_for(lift().axis("boom"), recipe, 100.0) == Window(0.05, (0, 1, 2, 3, 4, 6, 8), (0, 1, 2, 4))
    assert window_for(lift().axis("boom"), recipe, 50.0).step == pytest.approx(0.04)
    assert window_for(lift().axis("boom"), recipe, 10.0) == Window(0.1, (0, 1, 2, 3, 4), (0, 1, 2))


def test_a_step_sees_the_mean_command() -> None:
    motion = MotionStretch.of(np.array([0.0, 1.0, 1.0, 0.0, 2.0]), np.zeros(5), 2)
    np.testing.assert_array_equal(motion.command, [0.5, 1.0, 0.5, 1.0, np.nan])


def test_horizons_are_those_of_whole_runs(network: MotionNetwork, data: Dataset) -> None:
    motion = network.motion(data.recording("run-3"))
    ((ends, said, truth),) = horizon_errors(network.speed, network.window, network.bounds, [motion], 0.6, 0.24)
    back = 10 * motion.stride
    first = int(ends[0]) - back
    alone = whole_run(
        network.speed,
        network.window,
        network.bounds,
        MotionStretch(motion.command, _before(motion.position, first, network.window), 3),
    )
    assert said[0] == pytest.approx(alone[ends[0]])
    np.testing.assert_array_equal(truth, motion.position[ends])
    assert np.diff(ends).min() >= 0.24 * RATE
    ahead = network.ahead(data.recording("run-3"), 0.6)
    assert ahead[ends[0]] == pytest.approx(said[0])


def test_a_servo_is_seen_from_where_it_is() -> None:
    """Commands are positions: the network sees how far there is to go, and so means the same everywhere."""
    machine = lift("position")
    window = window_for(machine.axis("boom"), parse_recipe({"motion": MOTION | {"position": False}}, "test").motion, RATE)
    assert window.follows
    here = window.features(np.full((1, 4), 0.12), np.full((1, 3), 0.10))
    there = window.features(np.full((1, 4), 0.07), np.full((1, 3), 0.05))
    np.testing.assert_allclose(here, there)
    np.testing.assert_allclose(here[0, :4], 0.02)
    names = window.names("boom.command", "boom.cylinder")
    assert len(names) == here.shape[1]
    assert names[1] == "boom.command from boom.cylinder 0.06 s before"


def test_files_bring_back_the_same_network(network: MotionNetwork, data: Dataset) -> None:
    kind, files = to_files({"boom": network})
    again = from_files(files, "lift-motion@1")
    assert isinstance(again, dict)
    loaded = again["boom"]
    assert isinstance(loaded, MotionNetwork)
    run = data.recording("run-3")
    np.testing.assert_array_equal(loaded.free_run(run), network.free_run(run))
    assert to_files(again) == (kind, files)
    wrong = replace(network, window=replace(network.window, commands=(0, 1)))
    with pytest.raises(StoreError, match=r"lift-motion@1: boom: .* inputs and 1 outputs; expected .* as its window has"):
        from_files(to_files({"boom": wrong})[1], "lift-motion@1")


def test_unusable_data_and_settings_are_refused(data: Dataset) -> None:
    with pytest.raises(SettingsError, match=r"a step of 0.06 s at 30 Hz; expected whole samples, as in 0.0666667 s"):
        linear_network().free_run(replace(data.recording("run-3"), rate_hz=30.0))
    with pytest.raises(SettingsError, match=r"motion.history: \[0.1, 0.0\]; expected increasing times, from 0 on"):
        window_of(0.06, [0.1, 0.0], [], RATE)
    with pytest.raises(SettingsError, match=r"motion.speeds: \[0.0\]; expected increasing times, above 0"):
        window_of(0.06, [0.0], [0.0], RATE)
    with pytest.raises(SettingsError, match=r"motion.horizons"):
        parse_recipe({"motion": {"horizons": []}}, "test")
    short = with_roles(tuple(recording(f"run-{k}", k, seconds=2.0) for k in range(4)))
    with pytest.raises(ExcitationError, match=r"axis 'boom': \d+ select rows with 0.24 s of command and motion without a gap"):
        fit_motion(short, QUICK)
    frozen = with_roles(tuple(replace(r, table=r.table.assign(**{"boom.command": 0.3})) for r in data.recordings))
    with pytest.raises(ExcitationError, match=r"boom.command 0 s before is constant"):
        fit_motion(frozen, QUICK)
    table = pd.DataFrame({"time": np.arange(200) / RATE, "boom.command": 0.0})
    with pytest.raises(ExcitationError, match=r"no axis with <axis>.command and its motion"):
        fit_motion(with_roles((Recording("run-0", table, RATE),)), QUICK)


def test_rows_are_thinned_evenly(data: Dataset) -> None:
    axis = data.machine.axis("boom")
    window = window_for(axis, QUICK.motion, RATE)
    every, _ = motion_rows(data, axis, window, "fit", 10**6)
    some, speeds = motion_rows(data, axis, window, "fit", 100)
    assert len(some) == len(speeds) == 100
    np.testing.assert_array_equal(some[[0, -1]], every[[0, -1]])


def wild(seed: int, size: float, follows: bool = False) -> MotionNetwork:
    """Random weights of any size."""
    rng = np.random.default_rng(seed)
    window = Window(0.06, (0, 1), (0, 1), True, follows)
    weights = (size * rng.normal(size=(4, 8)), size * rng.normal(size=(8, 1)))
    unit = Normalisation(np.zeros(4), np.ones(4))
    mlp = Mlp(weights, (rng.normal(size=8), rng.normal(size=1)), unit, Normalisation(np.zeros(1), np.ones(1)))
    return built(window, mlp)


def linear_network() -> MotionNetwork:
    """Speed = gain · command, as two rectifiers."""
    window = Window(0.06, (0,), (0,), False)
    mlp = Mlp(
        (np.array([[1.0, -1.0]]), np.array([[0.05], [-0.05]])),
        (np.zeros(2), np.zeros(1)),
        Normalisation(np.zeros(1), np.ones(1)),
        Normalisation(np.zeros(1), np.ones(1)),
    )
    return built(window, mlp)


def built(window: Window, mlp: Mlp) -> MotionNetwork:
    bounds = MotionBounds((-0.3, 0.4), (0.0, 0.2))
    curve = LearningCurve((1, 1), 1, 1, (0.0,), (1,), (0.0,), (0.0,))
    return MotionNetwork("boom", "boom.command", "boom.cylinder", "m", window, (mlp,), bounds, (-1.0, 1.0), (curve,))


def _before(position: Array, last: int, window: Window) -> Array:
    """What it takes to start at ``last`` and nowhere else: whole steps of history, and the step after."""
    kept = np.full(len(position), np.nan)
    at = last + 3 * np.arange(-window.edges[-1], 2)
    kept[at] = position[at]
    return kept
