"""Intervals, noise and floor: figures that a user reads as such."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plant_data import arm, dataset_of, nominal

from sysid.gap.candidates import candidates_at
from sysid.gap.fit import Data, Fit, fit_candidates
from sysid.gap.floor import problem_floor, run_floor, with_noise
from sysid.gap.intervals import covariance_of, intervals
from sysid.gap.localise import run_rmse
from sysid.gap.noise import noise_levels
from sysid.gap.problem import Problem, drive_problem, problems_of, split_of
from sysid.machine import KnownEffect
from sysid.plant import compile_plant, free_run

TRUTH = KnownEffect("valve_deadband", "slew", {"positive": 0.09, "negative": 0.06})


def fitted(seed: int) -> tuple[Fit, np.ndarray]:
    plant = nominal()
    dataset = dataset_of(plant.with_effect(TRUTH), 12.0, seed, noise=5.0)
    model, split = compile_plant(plant), split_of(dataset)
    problem: Problem = next(p for p in problems_of(model, dataset) if p.target == "slew" and p.stage == "command")
    (candidate,) = (c for c in candidates_at(plant, model.theta, "command", ("slew",)) if c.effect.name == TRUTH.name)
    data = Data(problem, split.fit, np.array([1e-3]))
    fit = fit_candidates(data, model.theta, [candidate], [np.array([0.1, 0.1])])
    return fit, intervals(fit, *covariance_of(data, model.theta, fit))


def test_intervals_cover_the_truth() -> None:
    """Thirty sets of recordings, two parameters each: about 95 % of the intervals hold the truth."""
    values = np.array(list(TRUTH.parameters.values()))
    hits, widths = [], []
    for seed in range(30):
        fit, ends = fitted(seed)
        hits += list((ends[:, 0] <= values) & (values <= ends[:, 1]))
        widths.append(ends[:, 1] - ends[:, 0])
        assert all(low <= value <= high for value, (low, high) in zip(fit.values, ends, strict=True))
    assert np.mean(hits) >= 0.85
    assert np.median(widths) < 0.01, "an interval that holds everything says nothing"


def test_no_unknowns_no_intervals() -> None:
    nothing = Fit((), (), np.empty(0), nominal().vector(), (), 0.0, True)
    data = Data(drive_problem(compile_plant(nominal()), arm().axis("slew")), (), np.array([1e-3]))
    covariance, count = covariance_of(data, nominal().vector(), nothing)
    assert covariance.shape == (0, 0)
    assert intervals(nothing, covariance, count).shape == (0, 2)


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
        assert np.allclose(score, floor, rtol=0.4), problem.signals
    floors = run_floor(lambda r: free_run(truth, r), split.fit, noise, 0)
    scores = run_rmse([(r, free_run(truth, r)) for r in split.fit])
    assert floors.keys() == scores.keys()
    for signal, score in scores.items():
        assert score == pytest.approx(floors[signal], rel=0.4), signal


def test_added_noise_has_its_size_and_leaves_commands_alone() -> None:
    recording = dataset_of(nominal(), 20.0).recordings[0]
    noisy = with_noise(recording, {"slew.joint": 1e-2}, np.random.default_rng(0))
    assert np.std(noisy.values("slew.joint") - recording.values("slew.joint")) == pytest.approx(1e-2, rel=0.05)
    assert np.array_equal(noisy.values("slew.command"), recording.values("slew.command"))
