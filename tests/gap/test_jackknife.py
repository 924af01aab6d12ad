"""Standard errors from the values without each recording."""

from __future__ import annotations

import numpy as np
import pytest
from plant_data import dataset_of, nominal
from scipy import stats

from sysid.gap.candidates import candidates_at
from sysid.gap.data import Data
from sysid.gap.problem import problems_of, split_of
from sysid.gap.stage_intervals import half_widths, jackknifed
from sysid.machine import KnownEffect
from sysid.plant import compile_plant


def test_it_is_the_spread_of_the_values_without_each_cluster() -> None:
    """Of a line with an offset, against refits by least squares without each cluster."""
    rng = np.random.default_rng(1)
    clusters = np.repeat(np.arange(6), 30)
    slopes = np.column_stack([np.ones(180), rng.normal(size=180)])
    output = slopes @ [1.0, 2.0] + rng.normal(size=6)[clusters] * slopes[:, 1] + rng.normal(size=180)
    best = np.linalg.lstsq(slopes, output, rcond=None)[0]
    without = np.array([np.linalg.lstsq(slopes[clusters != g], output[clusters != g], rcond=None)[0] for g in range(6)])
    expected = stats.t.ppf(0.975, 5) * np.sqrt(5 / 6 * ((without - best) ** 2).sum(axis=0))
    found = half_widths(output - slopes @ best, slopes, clusters, np.zeros(2))
    assert found == pytest.approx(expected, rel=1e-9)


def test_intervals_contain_the_mean_of_recordings_that_differ() -> None:
    """Each recording has its own best value; independent errors of rows would give an interval five times too narrow."""
    rng = np.random.default_rng(2)
    clusters, slopes = np.repeat(np.arange(5), 200), np.ones((1000, 1))
    covered = []
    for _ in range(400):
        output = rng.normal(size=5)[clusters] + 0.1 * rng.normal(size=1000)
        covered.append(abs(output.mean()) <= half_widths(output - output.mean(), slopes, clusters, np.zeros(1))[0])
    assert 0.92 < np.mean(covered) < 0.98


def test_two_recordings_are_too_few() -> None:
    assert half_widths(np.ones(20), np.ones((20, 1)), np.repeat([0, 1], 10), np.zeros(1)).tolist() == [0.0]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_threshold_between_two_samples_has_a_width(seed: int) -> None:
    """Within a tenth of its negligible change no motion, or a single one, begins at another sample."""
    plant, truth = nominal(), KnownEffect("stiction", "boom", {"breakaway": 0.2, "release": 0.05})
    dataset = dataset_of(plant.with_effect(truth), 60.0, seed)
    model, split = compile_plant(plant), split_of(dataset)
    problem = next(p for p in problems_of(model, dataset) if "boom" in p.targets and p.stage == "command")
    candidate = next(c for c in candidates_at(plant, model.theta, ("command",), ("boom",)) if c.effect.name == "stiction")
    data = Data(problem, split.fit, np.array([dataset.machine.noise[signal] for signal in problem.signals]))
    widths = jackknifed(data, model.theta, candidate.unknowns, np.array([0.2, 0.05]))
    assert 0.0 < widths[0] < 0.05
