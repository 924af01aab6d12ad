"""A parameter that changes is noticed soon; one that does not is left alone for as long as stated."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from sysid.fleet.drift import MOST, REFERENCE, cumulative_sums, decision_interval, drifts, standardised
from sysid.fleet.effects import FleetEffect, ParameterHistory

BACKLASH = FleetEffect("backlash", "slew", "drive", ("width",))


def history(values: np.ndarray, deviations: np.ndarray, negligible: float = 1e-4) -> ParameterHistory:
    names, ends = tuple(f"run-{k:03d}" for k in range(len(values))), tuple((k + 1) / 60.0 for k in range(len(values)))
    rows = tuple(map(float, values)), tuple(map(float, deviations))
    return ParameterHistory("crane-01", BACKLASH, "width", "rad", negligible, names, ends, *rows)


@pytest.mark.parametrize("run_length", [50.0, 200.0])
def test_mean_time_between_false_alarms_is_the_one_requested(run_length: float) -> None:
    rng, interval = np.random.default_rng(7), decision_interval(run_length)
    lengths = []
    for _ in range(300):
        alarms = np.flatnonzero(cumulative_sums(rng.standard_normal(round(12 * run_length))) > interval)
        lengths.append(alarms[0] + 1 if len(alarms) else 12 * run_length)
    assert np.mean(lengths) == pytest.approx(run_length, rel=0.25)


def test_residuals_are_standard_normal_whatever_mean_and_scale() -> None:
    rng = np.random.default_rng(8)
    joined = []
    for _ in range(300):
        deviations = rng.uniform(0.5, 3.0, 12)
        joined.append(standardised(rng.normal(40.0, 7.0 * deviations), deviations)[3:])
    assert np.abs(np.concatenate(joined)).max() <= MOST
    assert stats.kstest(np.concatenate(joined), "norm").pvalue > 0.01
    assert abs(np.corrcoef(np.array(joined)[:, :-1].ravel(), np.array(joined)[:, 1:].ravel())[0, 1]) < 0.06


def test_a_step_is_noticed_dated_and_measured() -> None:
    rng = np.random.default_rng(9)
    values = np.concatenate([rng.normal(0.006, 2e-4, 30), rng.normal(0.0075, 2e-4, 15)])
    (found,) = drifts([history(values, np.full(45, 2e-4))], 1e-3)
    assert found.since == "run-030"
    assert found.noticed in [f"run-{k:03d}" for k in range(31, 40)]
    assert found.before95[0] < 0.006 < found.before95[1]
    assert found.after95[0] < 0.0075 < found.after95[1]


def test_a_slow_growth_is_noticed() -> None:
    rng = np.random.default_rng(10)
    values = 0.006 + 5e-5 * np.maximum(0.0, np.arange(80.0) - 20.0) + rng.normal(0.0, 2e-4, 80)
    found = drifts([history(values, np.full(80, 2e-4))], 1e-3)
    assert found
    assert all(item.after > item.before for item in found)


def test_scatter_between_recordings_beside_errors_of_all_sizes_raises_no_more_alarms() -> None:
    """The values scatter by 2e-4 whatever their errors, of which some are a tenth of others."""
    rng = np.random.default_rng(15)
    alarms = 0
    for _ in range(20):
        deviations = rng.choice([2e-6, 2e-5], 2000)
        values = 0.006 + rng.normal(0.0, 2e-4, 2000)
        alarms += len(drifts([history(values, deviations, negligible=0.0)], 1.0 / 60.0))
    # 667 h in which 11 false alarms are accepted; weights by the errors alone give 31.
    assert alarms < 25


def test_outliers_alone_raise_no_alarm() -> None:
    rng = np.random.default_rng(11)
    values = rng.normal(0.006, 2e-4, 60)
    values[[20, 40]] = 0.1
    assert not drifts([history(values, np.full(60, 2e-4))], 1e-3)
    assert decision_interval(60_000.0) > MOST - REFERENCE


def test_a_negligible_change_is_not_reported() -> None:
    rng = np.random.default_rng(12)
    values = np.concatenate([rng.normal(0.006, 1e-6, 30), rng.normal(0.00605, 1e-6, 20)])
    assert not drifts([history(values, np.full(50, 1e-6))], 1e-3)
    assert drifts([history(values, np.full(50, 1e-6), negligible=1e-5)], 1e-3)


def test_a_growth_that_is_small_against_what_is_negligible_at_first_is_noticed_when_it_is_not() -> None:
    """Each step is a hundredth of a negligible change and many standard deviations of a recording."""
    rng = np.random.default_rng(14)
    grown = 1e-6 * np.maximum(0.0, np.arange(300.0) - 20.0)
    found = drifts([history(0.006 + grown + rng.normal(0.0, 1e-7, 300), np.full(300, 1e-7))], 1e-3)
    assert found
    noticed = int(found[0].noticed[4:])
    # The later half of a growth since its date has a mean of three quarters of it, and the date is in its middle.
    assert 1.0 < grown[noticed] / 1e-4 < 1.5
    assert found[0].after - found[0].before == pytest.approx(1e-4, rel=0.1)


def test_two_changes_are_both_found() -> None:
    rng = np.random.default_rng(13)
    levels = np.repeat([0.006, 0.008, 0.011], 25)
    found = drifts([history(levels + rng.normal(0.0, 2e-4, 75), np.full(75, 2e-4))], 1e-3)
    assert [item.since for item in found] == ["run-025", "run-050"]


def test_too_few_recordings_are_left_alone() -> None:
    assert not drifts([history(np.array([0.006, 0.009]), np.full(2, 1e-5))], 1e-3)
