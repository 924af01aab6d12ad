"""Evidence on drifting residuals: what is not there is not named, what is there is."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from plant_data import arm_inputs, dataset_of, measured, nominal

from sysid.datasets.recording import Dataset
from sysid.gap import find_gap
from sysid.gap.drift import estimate_drift
from sysid.gap.unnamed.residual_series import gain_p_value
from sysid.machine import KnownEffect

Array = npt.NDArray[np.float64]


def autoregressive(count: int, rho: float, rng: np.random.Generator) -> Array:
    out = np.zeros(count)
    shocks = rng.standard_normal(count)
    for k in range(1, count):
        out[k] = rho * out[k - 1] + shocks[k]
    return out


@pytest.mark.parametrize("rho", [0.9, 0.98])
def test_a_spurious_regressor_on_autocorrelated_noise(rho: float) -> None:
    """Where samples count as independent it wins by ΔBIC > 10 in many runs; where residuals are whitened, in none."""
    naive = whitened = 0
    runs = 60
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        noise, regressor = autoregressive(400, rho, rng), autoregressive(400, rho, rng)
        left = noise - regressor * (regressor @ noise) / (regressor @ regressor)
        naive += 400 * np.log((noise @ noise) / (left @ left)) - np.log(400) > 10
        activity = np.ones(400)
        totals = [estimate_drift([series], [activity])[1] for series in (noise, left)]
        whitened += 2 * (totals[1] - totals[0]) - np.log(400) > 10
    assert naive > 0.1 * runs, "the trap is there"
    assert whitened <= 1


def test_a_gain_that_is_only_chance_has_no_small_p_value() -> None:
    """Null gains with the memory of drifting residuals: at most one in twenty passes 1 %."""
    small = sum(
        gain_p_value(autoregressive(300, 0.7, np.random.default_rng(seed)), seed, draws=300) < 0.01 for seed in range(60)
    )
    assert small <= 3


def test_a_steady_gain_has_a_small_p_value() -> None:
    gain = 0.5 + autoregressive(300, 0.5, np.random.default_rng(3))
    assert gain_p_value(gain, 0) < 0.01
    assert gain_p_value(-gain, 0) > 0.99


def test_no_gain_at_all_is_no_evidence() -> None:
    assert gain_p_value(np.zeros(100), 0) == 1.0
    assert gain_p_value(np.ones(5), 0) == 1.0


def test_p_values_repeat_with_their_seed() -> None:
    gain = autoregressive(200, 0.6, np.random.default_rng(1))
    assert gain_p_value(gain, 7) == gain_p_value(gain, 7)


def disturbed(seed: int, *hidden: KnownEffect) -> Dataset:
    """A slew whose speed is disturbed by what no model knows: 2 % of it, correlated over a second or so."""
    truth = nominal(*hidden)
    dataset = dataset_of(truth, 25.0, seed)
    recordings = []
    for k, recording in enumerate(dataset.recordings):
        rng = np.random.default_rng([seed, k])
        speed = np.gradient(measured(truth, arm_inputs(recording.name, 25.0, 10 * seed + k), 0, 0.0).values("slew.joint"))
        drift = np.cumsum(speed * 0.02 * autoregressive(len(recording), 0.98, rng) * np.sqrt(1 - 0.98**2))
        table = recording.table[["time", "slew.command", "slew.joint"]]
        recordings.append(
            type(recording)(recording.name, table.assign(**{"slew.joint": recording.values("slew.joint") + drift}), 100.0)
        )
    return Dataset.of(truth.machine, recordings, dataset.splits)


@pytest.mark.slow
def test_disturbances_are_not_named() -> None:
    named = [(e.name, e.target) for seed in range(8) for e in find_gap(disturbed(seed), nominal()).effects]
    assert len(named) <= 1, named


@pytest.mark.slow
def test_an_effect_is_named_through_disturbances() -> None:
    hidden = KnownEffect("valve_deadband", "slew", {"positive": 0.08, "negative": 0.11})
    result = find_gap(disturbed(1, hidden), nominal())
    assert [(e.name, e.target) for e in result.effects] == [("valve_deadband", "slew")]
    for key, value in hidden.parameters.items():
        assert result.effects[0].parameters[key] == pytest.approx(value, rel=0.1)
