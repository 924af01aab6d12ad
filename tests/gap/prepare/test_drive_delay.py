"""Delay of a logged force on a drive with a spring: with the load in the regression, the whole band determines it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from force_axis import acting, linear_motion, machine, multisine, recording

from sysid.gap.prepare.drives import DriveResonance, drive_delay, drive_resonance, load_acceleration
from sysid.plant.force import ForceFilter
from sysid.plant.force_band import force_filter

RATE, LOAD = 1000.0, 1.2
AXIS = machine(RATE).axis("x")


def test_the_acceleration_of_the_load_is_that_of_an_oscillator() -> None:
    time, frequency, damping = np.arange(20_000) / RATE, 7.0, 0.05
    for hz in (2.0, 6.5, 20.0):
        s, omega = 2j * np.pi * hz, 2.0 * np.pi * frequency
        gain = (2.0 * damping * omega * s + omega**2) / (s**2 + 2.0 * damping * omega * s + omega**2)
        found = load_acceleration(np.sin(2.0 * np.pi * hz * time), frequency, damping, RATE)[-5000:]
        assert found == pytest.approx((gain * np.exp(s * time[-5000:])).imag, abs=0.005 * abs(gain))


def test_an_acceleration_that_stays_is_that_of_the_load_too() -> None:
    assert load_acceleration(np.full(100, 3.0), 7.0, 0.05, RATE) == pytest.approx(np.full(100, 3.0))


@pytest.mark.parametrize("antiresonance", [6.0, 15.0, 25.0])
@pytest.mark.parametrize("early", [0, 1])
@pytest.mark.parametrize("assumed", [0.0, 0.5])
def test_a_held_force_is_half_a_sample_ahead_whatever_the_spring(antiresonance: float, early: int, assumed: float) -> None:
    force, omega = multisine(20.0, 40.0), 2.0 * np.pi * antiresonance
    position = linear_motion(force, RATE, LOAD * omega**2, LOAD, damping=2.0 * 0.04 * omega * LOAD)
    friction = 4.0 * np.sign(np.gradient(position))
    part = recording(np.roll(acting(force, position, RATE), -early) + friction, position, noise=(0.05, 1e-6))
    settings = replace(force_filter([part], AXIS), delay=early + assumed)
    resonance = drive_resonance([part], AXIS, settings)
    assert resonance is not None
    assert drive_delay([part], AXIS, settings, resonance) == pytest.approx(0.5 + early, abs=0.07)


def test_a_recording_that_determines_no_delay_keeps_the_one_assumed() -> None:
    slow = multisine(20.0, 0.9)
    position = linear_motion(slow, RATE)
    part = recording(acting(slow, position, RATE), position, noise=(5.0, 1e-5))
    settings = ForceFilter(delay=0.25)
    assert drive_delay([part], AXIS, settings, DriveResonance(15.0, 25.0, 0.04, 1.8)) == 0.25
    assert drive_delay([], AXIS, settings, DriveResonance(15.0, 25.0, 0.04, 1.8)) == 0.25
