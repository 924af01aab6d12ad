"""Recordings are predicted by values that are fitted to others."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from plant_data import dataset_of, nominal

from sysid.datasets.recording import Dataset
from sysid.gap.candidates import candidates_at
from sysid.gap.data import Data
from sysid.gap.fit import Fit, fit_candidates, place
from sysid.gap.held_out import cross_validated_error
from sysid.gap.prepare.case import Stage
from sysid.gap.problem import problems_of, split_of
from sysid.machine import KnownEffect
from sysid.plant import compile_plant

PLANT, TRUE = nominal(), 1.04


def study() -> tuple[Stage, Fit]:
    """The drive of a boom whose gain is 4 % larger, and its fit with that gain; two fitted recordings of three."""
    dataset = dataset_of(PLANT.with_effect(KnownEffect("gain_error", "boom", {"ratio": TRUE})))
    return drive(dataset, "gain_error", TRUE, accumulates=False)


def drive(dataset: Dataset, name: str, value: float, accumulates: bool) -> tuple[Stage, Fit]:
    """The drive of the boom in a dataset, and its fit with the effect ``name`` of one parameter."""
    model, split = compile_plant(PLANT), split_of(dataset)
    problem = next(p for p in problems_of(model, dataset) if p.stage == "command" and p.target == "boom")
    sigma = np.array([dataset.machine.noise[signal] for signal in problem.signals])
    effect = next(c for c in candidates_at(PLANT, model.theta, "command", ("boom",)) if c.effect.name == name)
    result: Any = SimpleNamespace(accumulates=accumulates)
    stage = Stage(problem, split, sigma, model.theta, result=result)
    return stage, Fit((effect,), effect.unknowns, np.array([value]), placed(stage, effect.unknowns, value))


def placed(stage: Stage, unknowns: tuple, value: float) -> np.ndarray:
    return place(stage.theta, unknowns, np.array([[value]]))[0]


def test_an_effect_that_all_recordings_share_is_predicted_to_the_noise_floor() -> None:
    stage, fit = study()
    assert cross_validated_error(stage, fit) < 1.2
    assert cross_validated_error(stage, stage.nominal) > 5.0


def test_fitted_recordings_have_values_of_the_others_and_held_out_ones_those_of_the_model() -> None:
    """A wrong value of the model is fitted again for the former only."""
    stage, fit = study()
    wrong = replace(fit, values=np.array([1.0]), theta=placed(stage, fit.unknowns, 1.0))
    seen = replace(stage, split=replace(stage.split, held_out=stage.split.held_out[:0]))
    assert cross_validated_error(seen, wrong) == pytest.approx(cross_validated_error(seen, fit), rel=0.02)
    held_out = replace(stage, split=replace(stage.split, fit=stage.split.fit[:1], select=()))
    assert cross_validated_error(held_out, wrong) == pytest.approx(cross_validated_error(held_out, stage.nominal))


def test_a_recording_that_differs_is_not_predicted_by_the_others() -> None:
    """Each of two recordings with gains of 4 % to either side is wrong by 8 % of its motion, as with no effect by 4 %."""
    stage, fit = study()
    other = dataset_of(PLANT.with_effect(KnownEffect("gain_error", "boom", {"ratio": 2.0 - TRUE})))
    two = [stage.split.fit[0], split_of(other).fit[1]]
    apart = replace(stage, split=replace(stage.split, fit=tuple(two), select=(), held_out=stage.split.held_out[:0]))
    assert cross_validated_error(apart, fit) > 1.5 * cross_validated_error(apart, apart.nominal)


def leaking(rate: float) -> tuple[Stage, Fit]:
    """The drive of a boom of which each recording drifts by another speed, beside a leak."""
    dataset = dataset_of(PLANT.with_effect(KnownEffect("internal_leakage", "boom", {"rate": rate})))
    recordings = []
    for k, recording in enumerate(dataset.recordings):
        slow = 2e-5 * (1.0 + 0.3 * k) * recording.table["time"]
        recordings.append(
            replace(recording, table=recording.table.assign(**{"boom.cylinder": recording.values("boom.cylinder") - slow}))
        )
    return drive(replace(dataset, recordings=tuple(recordings)), "internal_leakage", rate, accumulates=True)


def test_values_are_those_of_least_squares() -> None:
    """A drift that grows with the time is a part of the leak."""
    stage, fit = leaking(1e-4)
    free = Data(stage.problem, stage.split.seen, stage.sigma)
    found = fit_candidates(free, stage.theta, fit.candidates, [fit.values])
    squares = [np.nansum(np.concatenate(free.residuals(f.theta[None]), axis=1) ** 2) for f in (fit, found)]
    assert squares[1] < squares[0]
    assert found.values[0] > fit.values[0]
