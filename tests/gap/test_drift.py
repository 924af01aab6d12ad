"""The drift model: drifting residuals are made white, the strength of the drift is found, and drift alone is no evidence."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sysid.gap.drift import BIN, DriftStrength, estimate_drift, robust_scale, to_bins, whiten_lanes

Array = npt.NDArray[np.float64]


def drifting(count: int, calm: float, moving: float, seed: int, noise: float = 1.0) -> tuple[Array, Array]:
    """A series of the local level model, and its activity (rests and motion, mean 1)."""
    rng = np.random.default_rng(seed)
    activity = np.repeat(rng.choice([0.0, 0.5, 2.5], count // 20 + 1), 20)[:count]
    activity /= activity.mean()
    level = np.cumsum(np.sqrt(calm + moving * activity) * rng.standard_normal(count))
    return noise * (level + rng.standard_normal(count)), activity


def autocorrelation(values: Array, lag: int) -> float:
    centred = values - values.mean()
    return float(centred[lag:] @ centred[:-lag] / (centred @ centred))


@pytest.mark.parametrize(("calm", "moving"), [(0.0, 0.0), (0.1, 0.0), (0.0, 0.3), (5.0, 0.0), (0.2, 2.0)])
def test_whitened_residuals_are_white(calm: float, moving: float) -> None:
    series, activity = drifting(4000, calm, moving, 1, noise=0.7)
    (white,) = whiten_lanes(series[None], activity, DriftStrength(calm, moving))
    bound = 3.0 / np.sqrt(len(white))
    assert all(abs(autocorrelation(white[10:], lag)) < bound for lag in (1, 2, 5, 20))
    assert np.std(white) == pytest.approx(0.7, rel=0.05)
    if calm + moving > 0.05:
        assert autocorrelation(series, 1) > 0.5, "the series itself is far from white"


@pytest.mark.parametrize(("calm", "moving"), [(0.1, 0.0), (0.0, 0.3), (5.0, 0.0)])
def test_strengths_are_found(calm: float, moving: float) -> None:
    parts = [drifting(3000, calm, moving, seed, noise=1.3) for seed in range(2)]
    drift, _ = estimate_drift([series for series, _ in parts], [activity for _, activity in parts])
    assert drift.calm + drift.moving == pytest.approx(calm + moving, rel=0.5)
    assert (drift.moving > drift.calm) == (moving > calm)
    assert drift.noise == pytest.approx(1.3, rel=0.1)


def test_white_noise_has_no_drift() -> None:
    series, activity = drifting(3000, 0.0, 0.0, 5)
    drift, _ = estimate_drift([series], [activity])
    assert not drift.present
    assert drift.noise == pytest.approx(1.0, rel=0.05)


def test_missing_bins_stay_missing_and_the_level_drifts_on() -> None:
    series, activity = drifting(200, 0.5, 0.0, 3)
    series[50:80] = np.nan
    (white,) = whiten_lanes(series[None], activity, DriftStrength(0.5))
    assert (np.isnan(white) == np.isnan(series)).all()
    assert abs(white[80]) < 5.0, "thirty unseen bins make the next one uncertain, not surprising"


def test_a_few_outliers_do_not_change_the_scale() -> None:
    values = np.random.default_rng(0).standard_normal(2000)
    spoiled = values.copy()
    spoiled[::400] = 1e3
    assert np.std(spoiled) > 40.0
    assert robust_scale(spoiled) == pytest.approx(robust_scale(values), rel=0.3)


@given(st.integers(1, 60), st.integers(1, 3), st.sampled_from([10.0, 100.0, 37.0]))
def test_bins_keep_the_mean(count: int, width: int, rate: float) -> None:
    residual = np.random.default_rng(count).standard_normal((2, 40 * count, width))
    bins = to_bins(residual, rate)
    size = max(1, round(BIN * rate))
    used = residual[:, : bins.shape[1] * size]
    assert bins.shape == (2, 40 * count // size, width)
    assert np.allclose(bins.mean(axis=1), used.mean(axis=1))


def test_a_bin_needs_half_of_its_samples() -> None:
    residual = np.ones((20, 1))
    residual[:6] = np.nan
    residual[10:14] = np.nan
    assert np.isnan(to_bins(residual, 100.0)[:, 0]).tolist() == [True, False]
