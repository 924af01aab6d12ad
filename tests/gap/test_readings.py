"""The steps in which a sensor reads, from its readings alone."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sysid.gap.readings import reading_step

Array = npt.NDArray[np.float64]


@given(st.floats(1e-6, 1e-2), st.integers(0, 100))
def test_the_step_of_readings(step: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = np.cumsum(rng.integers(-3, 4, 400)) + 50
    values = step * places.astype(float)
    values[[3, 77]] = np.nan
    assert reading_step([values[:200], values[200:]]) == pytest.approx(step, rel=1e-6)
    assert reading_step([values + rng.normal(0.0, 0.3 * step, 400)]) == 0.0


def test_what_never_changes_has_no_step() -> None:
    assert reading_step([np.full(50, 0.3)]) == 0.0
    assert reading_step([np.full(50, np.nan), np.empty(0)]) == 0.0


def strokes(seed: int) -> Array:
    """Positions of a cylinder over 40 s at 100 Hz: moves between random places with rests between them [m]."""
    rng = np.random.default_rng(seed)
    places = np.repeat(rng.uniform(0.0, 0.16, 14), 300)
    return np.convolve(places, np.hanning(180) / np.hanning(180).sum(), "valid")


@pytest.mark.parametrize("step", [5e-5, 2e-4, 1e-3])
@pytest.mark.parametrize("noise", [0.02, 0.1, 0.18])
def test_noise_behind_the_converter_hides_no_step(step: float, noise: float) -> None:
    rng = np.random.default_rng(3)
    parts = [np.round(strokes(k) / step) * step for k in range(3)]
    noisy = [part + noise * step * rng.standard_normal(len(part)) for part in parts]
    noisy[0][50:60] = np.nan
    assert reading_step(noisy) == pytest.approx(step, rel=1e-3)


@pytest.mark.parametrize("seed", range(6))
def test_a_sensor_without_steps_has_none(seed: int) -> None:
    rng = np.random.default_rng(seed)
    assert reading_step([strokes(seed) + 2e-5 * rng.standard_normal(len(strokes(seed)))]) == 0.0
    assert reading_step([np.full(4000, 0.1) + 2e-5 * rng.standard_normal(4000)]) == 0.0
