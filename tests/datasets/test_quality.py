"""Quality figures: noise of a moving signal, reversals, gaps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sysid.datasets.quality.noise import noise_of


@given(sigma=st.floats(1e-6, 1e-2), seed=st.integers(0, 1000))
def test_noise_is_found_under_motion(sigma: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 60.0, 0.01)
    motion = 0.3 * sigma * 1e3 * np.sin(0.7 * time)
    assert noise_of(motion + sigma * rng.normal(size=len(time)), 100.0) == pytest.approx(sigma, rel=0.15)


def test_noise_needs_stretches_without_gaps() -> None:
    values = np.random.default_rng(0).normal(size=1000)
    values[::5] = np.nan
    assert np.isnan(noise_of(values, 100.0))
    values[400:600] = 0.0
    assert noise_of(values, 100.0) == pytest.approx(0.0, abs=1e-12)


def test_the_noise_of_a_counting_sensor_is_that_of_its_step() -> None:
    time = np.arange(0.0, 60.0, 0.05)
    counts = 3.6e-4 * np.round(np.where((time > 20) & (time < 25), 0.08 + 0.005 * (time - 20), 0.08) / 3.6e-4)
    assert noise_of(counts, 20.0) == pytest.approx(3.6e-4 / np.sqrt(12.0), rel=0.5)  # 50 samples move
