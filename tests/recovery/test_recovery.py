"""True parameters come back from data that the plant made itself; without an effect nothing is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cases import CASES, KNOWN, base, label
from plant_data import CAPTURE, arm, dataset_of, loaded_arm, nominal, slide

from sysid.datasets.recording import Dataset
from sysid.effects import CATALOGUE
from sysid.gap import find_gap
from sysid.gap.data import Data
from sysid.gap.fit import fit_candidates, starting_values
from sysid.gap.prepare.case import open_case, stage_candidates
from sysid.machine import KnownEffect
from sysid.plant import Plant

#: Share by which a parameter may miss the truth. Stiction is known to the nearest command that was given: ramps pass its
#: thresholds between two samples, so nothing pulls a fit to the exact value.
TOLERANCE = {
    "gripper_sway": {"damping_ratio": 0.05},
    "stiction": {"breakaway": 0.05, "release": 0.05, "spool_breakaway": 0.05, "spool_release": 0.5},
}


def fitted(truth: KnownEffect, plant: Plant, dataset: Dataset) -> KnownEffect:
    """The effect as :func:`fit_candidates` finds it, every other parameter as the plant has it; the order of rows is stated."""
    plant = replace(plant, machine=replace(plant.machine, convention="read_before_written"))
    case, stages = open_case(dataset, plant, 0)
    for coarse in case.coarse:  # steps are read off, not fitted
        if (truth.name, truth.target) == (coarse.effect.name, coarse.signal):
            return coarse.effect
    for stage in stages:
        for candidate in stage_candidates(case, stage):
            same = (candidate.effect.name, candidate.target, candidate.side) == (truth.name, truth.target, truth.side)
            if same and set(candidate.form.names) == set(truth.parameters):
                data = Data(stage.problem, stage.split.fit, stage.sigma)
                fit = fit_candidates(data, case.theta, [candidate], starting_values([candidate], (), 0))
                return candidate.instance(fit.values)
    raise AssertionError(f"{label(truth)} is no candidate at any stage that is measured")


@pytest.mark.parametrize("truth", CASES, ids=label)
def test_parameters_come_back(truth: KnownEffect) -> None:
    plant = base(truth)
    found = fitted(truth, plant, dataset_of(plant.with_effect(truth), 12.0, noise=0.2))
    for key, value in truth.parameters.items():
        true = np.atleast_1d(np.asarray(value, dtype=float))
        share = TOLERANCE.get(truth.name, {}).get(key, 0.01)
        room = share * np.max(np.abs(true))  # a vector is evaluated as a whole: some of its components may be zero
        assert np.allclose(found.parameters[key], true, rtol=0.0, atol=room), f"{key}: {found.parameters[key]} for {value}"


def test_play_driven_by_a_noisy_input_is_found_a_little_too_wide() -> None:
    """The noise of the measured cylinder crosses the play by itself; the excess falls with the noise."""
    truth = next(c for c in CASES if c.name == "backlash" and c.target == "boom")
    excess = []
    for noise in (0.2, 3.0):
        found = fitted(truth, base(truth), dataset_of(base(truth).with_effect(truth), 20.0, noise=noise))
        excess.append(float(found.parameters["width"]) / float(truth.parameters["width"]) - 1.0)  # type: ignore[arg-type]
    assert abs(excess[0]) < 0.01
    assert excess[0] < excess[1] < 0.2


@pytest.mark.parametrize(
    "plant",
    [
        pytest.param(nominal(*KNOWN, streams=CAPTURE), marks=pytest.mark.slow),
        pytest.param(nominal(machine=arm()), marks=pytest.mark.slow),
        nominal(machine=slide()),
        nominal(*KNOWN, machine=loaded_arm(), streams=CAPTURE),
    ],
    ids=["lags", "bare", "slide", "masses"],
)
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_nothing_is_named_where_nothing_is_missing(plant: Plant, seed: int) -> None:
    result = find_gap(dataset_of(plant, 25.0, seed), plant)
    assert result.effects == ()
    assert result.verdict == "no_gap"
    # A frictionless slide drifts by whatever its integrator rounds: it is evaluated by its force.
    gap = result.stage_gap if plant.machine.name == "slide" else result.gap
    assert gap.before
    for signal, before in gap.before.items():
        assert before < 1.15 * gap.noise_floor[signal], signal


def test_every_effect_has_a_case() -> None:
    # tests/gap/arm, tests/gap/test_servo_controllers.py
    elsewhere = {e.name for e in CATALOGUE if e.of_links or e.described_only or e.actuations == ("servo",)}
    assert {case.name for case in CASES} == {effect.name for effect in CATALOGUE} - elsewhere
