"""The steps in which a sensor reads, from its readings alone."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plant_data import dataset_of, nominal

from sysid.gap.prepare.noise import noise_levels
from sysid.gap.prepare.resolution import _interval, coarse_sensors, reading_step, with_steps
from sysid.machine import KnownEffect

Array = npt.NDArray[np.float64]


@given(st.floats(1e-6, 1e-2), st.integers(0, 100))
def test_the_step_of_readings(step: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = np.cumsum(rng.integers(-3, 4, 400)) + 50
    values = step * places.astype(float)
    values[[3, 77]] = np.nan
    assert reading_step([values[:200], values[200:]]) == pytest.approx(step, rel=1e-6)
    assert reading_step([values + rng.normal(0.0, 0.3 * step, 400)]) == 0.0


@given(st.floats(1e-6, 1e-2), st.integers(0, 100))
def test_a_motion_that_never_takes_a_single_step_shows_it(step: float, seed: int) -> None:
    """A servo of 12 bits at 10 Hz moved by two counts or more between any two rows; its noise came out as 10⁻⁶ of its range."""
    rng = np.random.default_rng(seed)
    ways = np.where(rng.random(300) < 0.7, 0, rng.choice([-7, -5, -3, -2, 2, 3, 4, 9], 300))
    assert reading_step([step * np.cumsum(ways)]) == pytest.approx(step, rel=1e-6)


def test_its_interval_contains_the_step_of_readings_with_few_digits() -> None:
    """Nine digits of a log: without them the interval was 10⁻⁹ of the step wide, and 4 of 50 sensors were outside."""
    rng, held = np.random.default_rng(0), 0
    for _ in range(50):
        step = rng.uniform(1e-3, 1e-2)
        time = np.arange(3000) / 100.0
        angle = rng.uniform(0.2, 0.8) * np.sin(rng.uniform(0.5, 2.0) * time + rng.uniform(0.0, 6.0)) + rng.uniform(-0.5, 0.5)
        readings = np.array([float(f"{value:.9g}") for value in step * np.round(angle / step)])
        found = reading_step([readings])
        low, high = _interval([readings], found)
        held += bool(low <= step <= high)
    assert held == 50


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


@pytest.mark.parametrize("seed", range(4))
def test_a_sensor_that_stands_in_most_recordings_has_none(seed: int) -> None:
    """Readings of rest are all alike; what moves in them is noise."""
    rng = np.random.default_rng(seed)
    still = [np.full(4000, 0.1 + 0.01 * k) + 2e-5 * rng.standard_normal(4000) for k in range(3)]
    assert reading_step([strokes(seed) + 2e-5 * rng.standard_normal(len(strokes(seed))), *still]) == 0.0


@given(st.floats(2.0, 40.0), st.integers(0, 2**32 - 1))
def test_a_slow_stroke_among_rests_has_none(noises: float, seed: int) -> None:
    """Its changes are those of the noise, ``noises`` standard deviations in ten readings; the rests are at a few places."""
    rng, time = np.random.default_rng(seed), np.arange(1000) / 100.0
    parts = []
    for _ in range(4):
        way = np.clip(time - rng.uniform(1.0, 5.0), 0.0, rng.uniform(0.5, 2.0)) * 10.0 * noises
        parts.append(1e-5 * (rng.uniform(-1e3, 1e3) + way + rng.standard_normal(len(time))))
    assert reading_step(parts) == 0.0


def test_steps_that_a_data_sheet_does_not_promise_are_noise_with_a_name() -> None:
    plant = nominal()
    truth = KnownEffect("sensor_quantisation", "boom.cylinder", {"step": 1e-3})
    dataset = dataset_of(plant.with_effect(truth), 20.0, noise=0.2)
    noise = noise_levels(dataset)
    (coarse,) = coarse_sensors(plant, dataset.recordings, noise)
    assert coarse.signal == "boom.cylinder"
    assert coarse.interval95[0] < 1e-3 < coarse.interval95[1]
    assert coarse.interval95 == pytest.approx((1e-3, 1e-3), rel=1e-3)
    level = np.hypot(noise["boom.cylinder"], 1e-3 / 12**0.5)
    assert with_steps(plant, (coarse,), noise)["boom.cylinder"] == pytest.approx(level)
    known = plant.with_effect(truth)
    assert coarse_sensors(known, dataset.recordings, noise) == ()
    assert with_steps(known, (), noise) == pytest.approx(with_steps(plant, (coarse,), noise))


@pytest.mark.parametrize("rate_hz", [1.0, 10.0, 200.0])
@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_steady_motion_has_no_step(rate_hz: float, noise: float) -> None:
    """At constant speed readings are multiples of the distance between two samples, which is no resolution of it."""
    time = np.arange(600) / rate_hz
    draw = np.random.default_rng(0)
    ramps = [0.3 * speed * time + noise * draw.standard_normal(len(time)) for speed in (0.5, 1.0, -1.0)]
    assert reading_step(ramps) == 0.0
    step = 0.9 / rate_hz
    rounded = [step * np.round(speed * time / step) for speed in (0.31, 0.47, -0.23)]
    assert reading_step(rounded) == pytest.approx(step, rel=1e-3)


@given(st.sampled_from([10.0, 20.0, 50.0, 200.0]), st.floats(0.02, 0.3), st.sampled_from([0.0, 1e-3]), st.integers(0, 1000))
def test_pushes_at_a_few_speeds_have_no_step(rate_hz: float, gain: float, noise: float, seed: int) -> None:
    """Starts and stops at whole fractions of one speed: all places are multiples of a fraction of a sample's way."""
    rng = np.random.default_rng(seed)
    speeds = np.repeat(gain * rng.choice([-1.0, -0.6, 0.0, 0.6, 1.0], (3, 40)), round(rate_hz), axis=1)
    parts = [np.cumsum(part) / rate_hz for part in speeds]
    parts = [part + noise * gain / rate_hz * rng.standard_normal(len(part)) for part in parts]
    assert reading_step(parts) == 0.0
    step = 0.37 * gain / rate_hz
    drawn = np.repeat(gain * rng.uniform(-1.0, 1.0, (3, 40)), round(rate_hz), axis=1)
    rounded = [step * np.round(np.cumsum(part) / rate_hz / step) for part in drawn]
    assert reading_step(rounded) == pytest.approx(step, rel=1e-3)
