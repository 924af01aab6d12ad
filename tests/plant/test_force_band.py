"""Bandwidth of the force comparison: the band of the excitation, less where noise hides it."""

from __future__ import annotations

import numpy as np
import pytest
from force_axis import MASS, acting, linear_motion, machine, multisine, recording
from scipy import signal

from sysid.datasets import Recording
from sysid.errors import ExcitationError
from sysid.plant.force import LEAST_HZ, force_inputs, highest_force_hz
from sysid.plant.force_band import force_filter

RATE = 1000.0
AXIS = machine().axis("x")


def pushed(last_hz: float, noise: tuple[float, float] = (0.01, 1e-8), spring: tuple[float, float] = (0.0, 0.0)) -> Recording:
    force = multisine(15.0, last_hz)
    position = linear_motion(force, RATE, *spring)
    return recording(acting(force, position, RATE), position, noise=noise)


@pytest.mark.parametrize("last_hz", [20.0, 40.0])
def test_the_band_ends_with_the_excitation(last_hz: float) -> None:
    found = force_filter([pushed(last_hz)], AXIS)
    assert found.force_hz == pytest.approx(last_hz, abs=2.0)
    assert found.position_hz >= 2.5 * found.force_hz


def test_noise_of_the_force_ends_it_earlier() -> None:
    clear, noisy = (force_filter([pushed(60.0, noise=(n, 1e-8))], AXIS).force_hz for n in (0.01, 60.0))
    assert clear == pytest.approx(60.0, abs=2.0)
    assert noisy == LEAST_HZ


def test_an_inertia_within_the_band_is_not_biased_by_the_noise_of_the_position() -> None:
    part = pushed(60.0, noise=(0.01, 3e-5))
    found = force_filter([part], AXIS)
    assert LEAST_HZ < found.force_hz < 50.0
    inputs = force_inputs(part, AXIS, found)
    a = signal.sosfiltfilt(inputs.low_pass, inputs.acceleration)[inputs.rows]
    assert float(a @ inputs.force / (a @ a)) == pytest.approx(MASS, rel=0.05)


def test_an_antiresonance_does_not_end_it() -> None:
    load = 1.2
    spring = load * (2.0 * np.pi * 15.0) ** 2
    found = force_filter([pushed(50.0, noise=(0.05, 3e-7), spring=(spring, load))], AXIS)
    assert found.force_hz > 40.0  # antiresonance 15 Hz, resonance 24 Hz


def test_slow_motion_and_low_rates_have_the_least_and_the_largest_band() -> None:
    assert force_filter([pushed(2.0)], AXIS).force_hz == LEAST_HZ
    force = multisine(20.0, 23.0, 50.0)
    part = recording(force, linear_motion(force, 50.0), 50.0)
    assert force_filter([part], machine(50.0).axis("x")).force_hz <= highest_force_hz(50.0) == pytest.approx(8.0)


def run_of_half_a_second(seed: int) -> Recording:
    """0.54 s, up to 0.66 m/s and back, with dry friction of 6 N and viscous friction of 10 N·s/m."""
    time = np.arange(540) / RATE
    rng = np.random.default_rng(seed)
    speed = 0.66 * np.sin(2 * np.pi * time / 0.54) + 0.05 * np.sin(2 * np.pi * 11.0 * time + rng.uniform(0, 6.28))
    position = np.cumsum(speed) / RATE
    acceleration = np.gradient(np.gradient(position)) * RATE**2
    force = MASS * acceleration + 10.0 * speed + 6.0 * np.sign(speed)
    return recording(force, position, noise=(0.2, 1e-7), seed=seed)


def test_a_run_of_half_a_second_is_compared() -> None:
    parts = [run_of_half_a_second(seed) for seed in range(3)]
    found = force_filter(parts, AXIS)
    assert found.force_hz > 12.0
    inputs = [force_inputs(part, AXIS, found) for part in parts]
    columns = [np.column_stack([i.acceleration, i.speed, np.sign(i.speed)]) for i in inputs]
    X = np.vstack([signal.sosfiltfilt(i.low_pass, c, axis=0)[i.rows] for i, c in zip(inputs, columns, strict=True)])
    values = np.linalg.lstsq(X, np.concatenate([i.force for i in inputs]), rcond=None)[0]
    assert values == pytest.approx([MASS, 10.0, 6.0], rel=0.1)


def test_too_short_a_run_says_how_many_samples_it_has() -> None:
    part = run_of_half_a_second(0)
    with pytest.raises(ExcitationError, match=r"4 independent samples of the force at 10 Hz; expected 18"):
        force_inputs(part, AXIS)


def test_rest_says_that_the_axis_hardly_moves() -> None:
    time = np.arange(4000) / RATE
    position = np.where(time < 3.6, 0.0, 0.1 * (time - 3.6))
    with pytest.raises(ExcitationError, match="the axis hardly moves"):
        force_inputs(recording(np.ones(4000), position), AXIS)
