"""What a recording is expected to tell is what it tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plant_data import KnownEffect, nominal
from short_supply import coarse_arm, slow_dataset, tie

from sysid.gap.data import Data
from sysid.gap.experiment import Experiment, Planning, propose, rehearse
from sysid.gap.experiment.information import Hypothesis, discrimination, noise_of_bin, precision
from sysid.gap.experiment.open_hypothesis import Question
from sysid.gap.fit import fit_candidates
from sysid.plant import Plant

NOISE = 6e-4


def asked() -> tuple[Plant, Question, Experiment]:
    plant = nominal(machine=coarse_arm(NOISE))
    lag = plant.with_effect(KnownEffect("first_order_lag", "boom", {"time_constant": 0.1}))
    case, repaired, question = tie(slow_dataset(lag, 8.0), plant, "command", "boom", "first_order_lag", "input_delay")
    (experiment,) = propose(case, repaired, [question], Planning(gap=1.0, lengths=(20.0,))).experiments
    return repaired, question, experiment


def rehearsed(truth: Plant, question: Question, experiment: Experiment) -> Data:
    return Data(question.stage.problem, [rehearse(truth, experiment)], question.stage.sigma)


def forgetting(model: Hypothesis) -> Hypothesis:
    return replace(model, known=np.zeros_like(model.known))


def test_a_model_does_not_differ_from_itself() -> None:
    truth, question, experiment = asked()
    data = rehearsed(truth, question, experiment)
    first, second = question.models
    assert discrimination(data, first, first, question.drifts).nats == pytest.approx(0.0, abs=1e-3)
    assert discrimination(data, first, first, question.drifts).rmse == pytest.approx(1.0, abs=1e-3)
    assert discrimination(data, first, second, question.drifts).nats > 20.0
    assert discrimination(data, first, second, question.drifts).rmse > 1.05


def test_a_rival_that_forgets_comes_nearer() -> None:
    truth, question, experiment = asked()
    data = rehearsed(truth, question, experiment)
    first, second = question.models
    near = discrimination(data, first, forgetting(second), question.drifts).nats
    assert near <= discrimination(data, first, second, question.drifts).nats + 1e-6


def test_expected_precision_is_the_scatter_of_fits() -> None:
    """Forty noisy recordings fitted: the standard deviation of the time constant is the Cramér-Rao bound."""
    truth, question, experiment = asked()
    clean = rehearse(truth, experiment)
    first = question.models[0]
    data = Data(question.stage.problem, [clean], question.stage.sigma)
    bound = float(precision(data, forgetting(first), question.drifts)[0])
    assert first.candidate is not None
    found = []
    for seed in range(40):
        noisy = clean.values("boom.cylinder") + np.random.default_rng(seed).normal(0.0, NOISE, len(clean))
        recording = replace(clean, table=clean.table.assign(**{"boom.cylinder": noisy}))
        fit = fit_candidates(
            Data(question.stage.problem, [recording], question.stage.sigma), truth.vector(), (first.candidate,), [first.values]
        )
        found.append(float(fit.values[0]))
    assert np.std(found) == pytest.approx(bound, rel=0.35), "forty fits give a standard deviation to ± 11 %"


def test_expected_nats_are_those_of_noisy_recordings() -> None:
    """The log likelihood ratio of truth and refitted rival on noisy recordings, as the workflow computes it."""
    truth, question, experiment = asked()
    clean = rehearse(truth, experiment)
    first, second = (forgetting(model) for model in question.models)
    expected = discrimination(Data(question.stage.problem, [clean], question.stage.sigma), first, second, question.drifts)
    assert second.candidate is not None
    ratios = []
    for seed in range(20):
        noisy = clean.values("boom.cylinder") + np.random.default_rng(seed).normal(0.0, NOISE, len(clean))
        data = Data(
            question.stage.problem,
            [replace(clean, table=clean.table.assign(**{"boom.cylinder": noisy}))],
            question.stage.sigma,
        )
        rival = fit_candidates(data, nominal(machine=coarse_arm(NOISE)).vector(), (second.candidate,), [second.values])
        ratios.append(data.drifts(first.theta)[1] - rival.log_likelihood)
    assert np.mean(ratios) == pytest.approx(expected.nats, rel=0.25)


def test_noise_of_a_bin() -> None:
    assert noise_of_bin(100.0) == pytest.approx(10.0**-0.5)
    assert noise_of_bin(10.0) == 1.0
    assert noise_of_bin(1.0) == 1.0
