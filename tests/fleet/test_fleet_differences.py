"""Machines that differ are found, equal ones are not, at the stated rate."""

from __future__ import annotations

import numpy as np
import pytest
from statsmodels.stats.meta_analysis import combine_effects

from sysid.fleet.differences import LEVEL, combined, differences, machine_value, p_equal
from sysid.fleet.effects import FleetEffect, ParameterHistory

DEADBAND = FleetEffect("valve_deadband", "boom", None, ("positive", "negative"))


def history(
    machine: str, values: np.ndarray, deviations: np.ndarray, parameter: str = "positive", negligible: float = 0.004
) -> ParameterHistory:
    names = tuple(f"run-{k}" for k in range(len(values)))
    ends = tuple((k + 1) / 60.0 for k in range(len(values)))
    return ParameterHistory(
        machine, DEADBAND, parameter, "1", negligible, names, ends, tuple(map(float, values)), tuple(map(float, deviations))
    )


def fleet(rng: np.random.Generator, centres: list[float], recordings: int, between: float = 0.002) -> list[ParameterHistory]:
    found = []
    for k, centre in enumerate(centres):
        deviations = rng.uniform(0.001, 0.004, recordings)
        values = centre + rng.normal(0.0, np.hypot(between, deviations))
        found.append(history(f"crane-{k:02d}", values, deviations))
    return found


def test_equal_machines_are_called_different_as_rarely_as_stated() -> None:
    rng = np.random.default_rng(1)
    p_values = [p_equal(list(map(machine_value, fleet(rng, [0.08] * 6, 5)))) for _ in range(400)]
    # The standard errors are at least those of the known variances, on the safe side.
    assert 0.005 < np.mean(np.array(p_values) < LEVEL) < LEVEL + 0.03


def test_a_machine_that_differs_is_named() -> None:
    rng = np.random.default_rng(2)
    (found,) = differences(fleet(rng, [0.08] * 7 + [0.11], 6))
    assert found.differs
    assert found.deviating == ("crane-07",)
    assert found.between == pytest.approx(0.0106, rel=0.5)


def test_a_certain_but_negligible_difference_is_not_reported() -> None:
    rng = np.random.default_rng(3)
    few = [history(f"crane-{k}", c + rng.normal(0.0, 1e-5, 8), np.full(8, 1e-5)) for k, c in enumerate((0.08, 0.0805, 0.081))]
    (found,) = differences(few)
    assert found.p_value is not None
    assert found.p_value < 1e-6
    assert not found.differs
    assert not found.deviating


def test_scatter_between_recordings_widens_the_interval_of_a_machine() -> None:
    values = np.array([0.07, 0.09, 0.075, 0.085])
    value = machine_value(history("crane", values, np.full(4, 1e-6)))
    assert value.error == pytest.approx(np.std(values, ddof=1) / 2.0, rel=1e-3)


def test_a_machine_with_one_recording_is_not_compared() -> None:
    rng = np.random.default_rng(4)
    (found,) = differences([*fleet(rng, [0.08, 0.08], 4), history("new", np.array([0.3]), np.array([0.001]))])
    assert [m.machine for m in found.machines] == ["crane-00", "crane-01"]
    assert not found.differs


def test_several_parameters_share_the_level() -> None:
    rng = np.random.default_rng(5)
    rows = fleet(rng, [0.08, 0.083, 0.079, 0.081], 4)
    (alone,) = differences(rows)
    other = [history(h.machine, rng.normal(0.05, 0.002, 4), np.full(4, 0.002), "negative") for h in rows]
    together = differences([*rows, *other])
    assert len(together) == 2
    assert together[0].p_value is not None
    assert alone.p_value is not None
    assert together[0].p_value >= alone.p_value


def test_the_variance_between_equals_that_of_statsmodels_on_a_scale_where_its_tolerance_is_small() -> None:
    rng = np.random.default_rng(6)
    variances = rng.uniform(50.0, 400.0, 9)
    values = rng.normal(0.0, np.sqrt(variances + 900.0))
    reference = combine_effects(values, variances, method_re="iterated")
    mean, error, tau2 = combined(1e-4 * values, 1e-8 * variances)
    assert 1e4 * mean == pytest.approx(reference.mean_effect_re, rel=1e-4)
    assert 1e4 * error == pytest.approx(reference.sd_eff_w_re, rel=1e-4)
    assert 1e8 * tau2 == pytest.approx(reference.tau2, rel=1e-4)


def test_values_that_scatter_less_than_their_errors_have_no_variance_between() -> None:
    assert combined(np.array([1.0, 1.001, 0.999]), np.full(3, 0.01))[2] == 0.0
