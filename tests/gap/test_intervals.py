"""Intervals, noise and floor: figures that a user reads as such."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plant_data import arm, dataset_of, nominal

from sysid.datasets import Dataset
from sysid.gap.candidates import candidates_at
from sysid.gap.data import Data
from sysid.gap.disagreement import run_rmse
from sysid.gap.fit import Fit, fit_candidates, place
from sysid.gap.intervals import Known, known_of
from sysid.gap.intervals.known import FRAMES
from sysid.gap.prepare.noise import noise_levels, problem_floor, run_floors, with_noise
from sysid.gap.problem import Problem, drive_problem, problems_of, split_of
from sysid.machine import KnownEffect
from sysid.plant import compile_plant, free_run

TRUTH = KnownEffect("valve_deadband", "slew", {"positive": 0.09, "negative": 0.06})


def known(
    truth: KnownEffect, seed: int, noise: float = 5.0, stage: str = "command", start: float = 1.1, frames: int = 0
) -> Known:
    """What is known of an effect from two noisy recordings; the fit starts a little off.

    Args:
        frames: signals have offsets, the same in all recordings: what noise leaves of the mean of so many frames; 0: none.
    """
    plant = nominal()
    dataset = dataset_of(plant.with_effect(truth), 12.0, seed, noise)
    if frames:
        dataset = shifted(dataset, noise / frames**0.5, np.random.default_rng(seed))
    model, split = compile_plant(plant), split_of(dataset)
    problem: Problem = next(p for p in problems_of(model, dataset) if truth.target in p.targets and p.stage == stage)
    offered = candidates_at(plant, model.theta, problem.kind.stages, (truth.target,))
    candidate = next(c for c in offered if c.effect.name == truth.name)
    levels = {signal: noise * level for signal, level in dataset.machine.noise.items()}
    sigma = np.array([levels[signal] for signal in problem.signals])
    data = Data(problem, split.fit, sigma)
    fit = fit_candidates(data, model.theta, [candidate], [start * np.array([float(v) for v in truth.parameters.values()])])  # type: ignore[arg-type]
    return known_of(data, model.theta, fit, levels, seed)


def shifted(dataset: Dataset, times: float, rng: np.random.Generator) -> Dataset:
    """All measured signals off by so many times their noise, in all recordings alike."""
    off = {signal: times * level * rng.standard_normal() for signal, level in dataset.machine.noise.items()}
    tables = [r.table.assign(**{s: r.table[s] + off[s] for s in off if s in r.table}) for r in dataset.recordings]
    return replace(
        dataset, recordings=tuple(replace(r, table=table) for r, table in zip(dataset.recordings, tables, strict=True))
    )


@pytest.mark.slow
def test_what_all_recordings_share_is_in_the_interval() -> None:
    """Zeros and mounts are off alike in all recordings, so that their scatter says nothing about it."""
    truth = KnownEffect("joint_offset", "boom", {"offset": 0.01})
    found = [known(truth, seed, stage="end_effector", frames=FRAMES) for seed in range(20)]
    hits = [bool(each.limits[0, 0] <= 0.01 <= each.limits[0, 1]) for each in found]
    assert np.mean(hits) >= 0.85
    errors = [abs(each.fit.values[0] - 0.01) for each in found]
    halves = [0.5 * float(np.ptp(each.limits[0])) for each in found]
    assert np.median(halves) < 5.0 * np.median(errors), "an interval that holds everything says nothing"
    without = [known(truth, seed, stage="end_effector") for seed in range(4)]
    assert np.median([abs(each.fit.values[0] - 0.01) for each in without]) < 0.5 * np.median(errors)


def test_intervals_cover_the_truth() -> None:
    """Twenty sets of recordings, two parameters each: about 95 % of the intervals hold the truth."""
    values = np.array(list(TRUTH.parameters.values()))
    hits, widths = [], []
    for seed in range(20):
        found = known(TRUTH, seed)
        low, high = found.limits.T
        hits += list((low <= values) & (values <= high))
        widths.append(high - low)
        assert ((low < found.fit.values) & (found.fit.values < high)).all()
    assert np.mean(hits) >= 0.9
    assert np.median(widths) < 0.01, "an interval that holds everything says nothing"


def test_at_a_bound_the_interval_is_one_sided() -> None:
    """One side of the valve has no dead-band: no interval reaches below zero, and that side's holds it."""
    truth = KnownEffect("valve_deadband", "slew", {"positive": 0.05, "negative": 0.0})
    for seed in range(4):
        found = known(truth, seed)
        assert found.limits[1, 0] == 0.0
        assert 0.0 < found.limits[1, 1] < 0.02
        assert found.limits[0, 0] > 0.02


def test_what_acts_in_steps_has_an_interval_as_well() -> None:
    """Slopes say nothing about thresholds. Ramps up show where a stuck spool breaks away, no ramp down where it is caught."""
    truth = KnownEffect("stiction", "slew", {"breakaway": 0.2, "release": 0.1})
    for seed in range(3):
        ends = known(truth, seed, start=1.0).limits
        breakaway, caught = np.diff(ends).ravel()
        assert ends[0, 0] <= 0.2 <= ends[0, 1]
        assert 0.0 < breakaway < 0.02
        assert caught > 0.1, "any release explains recordings in which the command always drops at once"


def test_play_is_as_wide_as_it_is_although_its_input_is_noisy() -> None:
    """Noise of the cylinder crosses the play: what fits best is too wide by a tenth and more, which is taken off."""
    truth = KnownEffect("backlash", "boom", {"width": 0.01}, "drive")
    found = [known(truth, seed, 10.0, "joint") for seed in range(6)]
    widths = np.array([each.fit.values[0] for each in found])
    assert np.mean(widths) == pytest.approx(0.01, rel=0.05)
    assert sum(each.limits[0, 0] <= 0.01 <= each.limits[0, 1] for each in found) >= 5
    assert all(
        np.array_equal(place(each.fit.theta, each.fit.unknowns, each.fit.values[None])[0], each.fit.theta) for each in found
    )


@pytest.mark.parametrize("seed", range(4))
def test_a_share_of_the_speed_is_as_accurate_as_clocks(seed: int) -> None:
    """A gain error of 0.08 % on a quiet machine; a dead time depends on the instants of sampling."""
    low, high = known(KnownEffect("gain_error", "slew", {"ratio": 1.0008}), seed, noise=1.0).limits[0]
    assert 1.0 < low <= 1.0008 <= high < 1.0016
    low, high = known(KnownEffect("input_delay", "slew", {"delay": 0.05}), seed, noise=1.0).limits[0]
    assert low <= 0.05 <= high
    assert high - low > 1e-4


def test_a_dead_time_of_a_fraction_of_a_sample_is_told_from_none() -> None:
    """0.4 ms on a quiet machine: the accuracy of the plant does not widen the interval to the rejected value."""
    low, high = known(KnownEffect("input_delay", "slew", {"delay": 4e-4}), 0, noise=0.5, start=1.0).limits[0]
    assert 0.0 < low <= 4e-4 <= high


def test_no_unknowns_no_intervals() -> None:
    nothing = Fit((), (), np.empty(0), nominal().vector())
    data = Data(drive_problem(compile_plant(nominal()), arm().axis("slew")), (), np.array([1e-3]))
    found = known_of(data, nominal().vector(), nothing, {})
    assert found.limits.shape == (0, 2)


def test_noise_is_estimated_where_the_data_sheet_is_silent() -> None:
    """In tables while the machine moves; a figure that ingest took from the sensor's own samples is believed before that."""
    dataset = dataset_of(nominal(), 30.0)
    silent = replace(dataset, machine=replace(dataset.machine, noise={}))
    levels = noise_levels(silent)
    for signal in ("slew.joint", "boom.cylinder"):
        assert levels[signal] == pytest.approx(arm().noise[signal], rel=0.2), signal
    quality = {"recordings": {"run-1": {"signals": {"slew.joint": {"noise": 7e-4}}}}}
    assert noise_levels(replace(silent, quality=quality))["slew.joint"] == 7e-4


def test_a_perfect_signal_has_almost_no_noise() -> None:
    """So that nothing is divided by zero."""
    dataset = dataset_of(nominal(), 10.0, noise=0.0)
    levels = noise_levels(replace(dataset, machine=replace(dataset.machine, noise={})))
    assert all(0.0 < level < 1e-3 for level in levels.values())


def test_the_data_sheet_comes_first() -> None:
    dataset = dataset_of(nominal(), 5.0)
    levels = noise_levels(dataset)
    assert {s: levels[s] for s in arm().noise} == dict(arm().noise)
    assert not any(signal.endswith(".command") for signal in levels)


def test_floor_is_what_the_true_model_scores() -> None:
    """Stage by stage and in free run, where noise enters the start state as well."""
    truth = nominal(KnownEffect("gripper_sway", "tool", {"length": 0.22, "damping_ratio": 0.04}))
    dataset = dataset_of(truth, 20.0, 3)
    noise, split, model = noise_levels(dataset), split_of(dataset), compile_plant(truth)
    for problem in problems_of(model, dataset):
        floor = problem_floor(problem, model.theta, split.fit, noise, 0)
        left = [problem.measured(r) - problem.predict(model.theta[None], r)[0] for r in split.fit]
        score = np.sqrt(np.nanmean(np.concatenate(left) ** 2, axis=0))
        assert np.allclose(score, floor, rtol=0.5), problem.signals
    floors, _ = run_floors(lambda r: free_run(truth, r), [(r, free_run(truth, r)) for r in split.fit], noise, 0)
    scores = run_rmse([(r, free_run(truth, r)) for r in split.fit])
    assert floors.keys() == scores.keys()
    for signal, score in scores.items():
        assert score == pytest.approx(floors[signal], rel=0.4), signal


def test_added_noise_has_its_size_and_leaves_commands_alone() -> None:
    recording = dataset_of(nominal(), 20.0).recordings[0]
    noisy = with_noise(recording, {"slew.joint": 1e-2}, np.random.default_rng(0))
    assert np.std(noisy.values("slew.joint") - recording.values("slew.joint")) == pytest.approx(1e-2, rel=0.05)
    assert np.array_equal(noisy.values("slew.command"), recording.values("slew.command"))
