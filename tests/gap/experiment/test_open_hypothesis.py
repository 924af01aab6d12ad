"""The expected information of a recording equals the information that simulated recordings yield."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from plant_data import KnownEffect, nominal
from weak_excitation import coarse_arm, slow_dataset, tie

from sysid.gap.data import Data
from sysid.gap.experiment import Experiment, Planning, dry_run, propose
from sysid.gap.experiment.open_hypothesis import (
    OpenHypothesis,
    PlausibleModel,
    discrimination,
    estimated_drifts,
    noise_of_bin,
    precision,
)
from sysid.gap.fit import fit_candidates
from sysid.plant import Plant

NOISE = 6e-4


@functools.cache
def planned() -> tuple[Plant, OpenHypothesis, Experiment]:
    plant = nominal(machine=coarse_arm(NOISE))
    lag = plant.with_effect(KnownEffect("first_order_lag", "boom", {"time_constant": 0.1}))
    case, repaired, hypothesis = tie(slow_dataset(lag, 8.0), plant, "command", "boom", "first_order_lag", "input_delay")
    (experiment,) = propose(case, repaired, [hypothesis], Planning(gap=1.0, lengths=(20.0,))).experiments
    return repaired, hypothesis, experiment


def simulated(truth: Plant, hypothesis: OpenHypothesis, experiment: Experiment) -> Data:
    return Data(hypothesis.stage.problem, [dry_run(truth, experiment)], hypothesis.stage.sigma)


def without_prior(model: PlausibleModel) -> PlausibleModel:
    return replace(model, known=np.zeros_like(model.known))


def test_a_model_does_not_differ_from_itself() -> None:
    truth, hypothesis, experiment = planned()
    data = simulated(truth, hypothesis, experiment)
    first, second = hypothesis.models
    nats, rmse = discrimination(data, first, first, hypothesis.drifts)
    assert nats == pytest.approx(0.0, abs=1e-3)
    assert rmse == pytest.approx(1.0, abs=1e-3)
    nats, rmse = discrimination(data, first, second, hypothesis.drifts)
    assert nats > 20.0
    assert rmse > 1.05


def test_an_alternative_without_prior_information_is_harder_to_reject() -> None:
    truth, hypothesis, experiment = planned()
    data = simulated(truth, hypothesis, experiment)
    first, second = hypothesis.models
    near, _ = discrimination(data, first, without_prior(second), hypothesis.drifts)
    nats, _ = discrimination(data, first, second, hypothesis.drifts)
    assert near <= nats + 1e-6


def test_expected_precision_is_the_scatter_of_fits() -> None:
    """Forty noisy recordings fitted: the standard deviation of the time constant is the Cramér-Rao bound."""
    truth, hypothesis, experiment = planned()
    clean = dry_run(truth, experiment)
    first = hypothesis.models[0]
    data = Data(hypothesis.stage.problem, [clean], hypothesis.stage.sigma)
    bound = float(precision(data, without_prior(first), hypothesis.drifts)[0])
    assert first.candidate is not None
    found = []
    for seed in range(40):
        noisy = clean.values("boom.cylinder") + np.random.default_rng(seed).normal(0.0, NOISE, len(clean))
        recording = replace(clean, table=clean.table.assign(**{"boom.cylinder": noisy}))
        fit = fit_candidates(
            Data(hypothesis.stage.problem, [recording], hypothesis.stage.sigma),
            truth.vector(),
            (first.candidate,),
            [first.values],
        )
        found.append(float(fit.values[0]))
    assert np.std(found) == pytest.approx(bound, rel=0.35), "forty fits give a standard deviation to ± 11 %"


def test_expected_nats_are_those_of_noisy_recordings() -> None:
    """The log likelihood ratio of truth and refitted alternative on noisy recordings, as the workflow computes it."""
    truth, hypothesis, experiment = planned()
    clean = dry_run(truth, experiment)
    first, second = (without_prior(model) for model in hypothesis.models)
    planned_data = Data(hypothesis.stage.problem, [clean], hypothesis.stage.sigma)
    expected, _ = discrimination(planned_data, first, second, hypothesis.drifts)
    assert second.candidate is not None
    ratios = []
    for seed in range(20):
        noisy = clean.values("boom.cylinder") + np.random.default_rng(seed).normal(0.0, NOISE, len(clean))
        data = Data(
            hypothesis.stage.problem,
            [replace(clean, table=clean.table.assign(**{"boom.cylinder": noisy}))],
            hypothesis.stage.sigma,
        )
        alternative = fit_candidates(data, nominal(machine=coarse_arm(NOISE)).vector(), (second.candidate,), [second.values])
        ratios.append(np.subtract(*(estimated_drifts(data, data.bins(f.theta[None]))[1] for f in (first, alternative))))
    assert np.mean(ratios) == pytest.approx(expected, rel=0.25)


def test_noise_of_a_bin() -> None:
    assert noise_of_bin(100.0) == pytest.approx(10.0**-0.5)
    assert noise_of_bin(10.0) == 1.0
    assert noise_of_bin(1.0) == 1.0
