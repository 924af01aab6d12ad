"""Delay of a logged force against the motion: held over its step, logged early, or measured with the motion."""

from __future__ import annotations

import numpy as np
import pytest
from force_axis import MASS, acting, linear_motion, machine, multisine, recording
from scipy import signal

from sysid.plant.force import ForceFilter, force_inputs
from sysid.plant.force_band import force_filter
from sysid.plant.force_delay import force_delay

RATE = 1000.0
AXIS = machine().axis("x")


@pytest.mark.parametrize("early", [0, 1])
def test_a_held_force_is_half_a_sample_ahead_and_a_whole_one_more_if_logged_early(early: int) -> None:
    force = multisine(20.0, 20.0)
    position = linear_motion(force, RATE)
    log = np.roll(acting(force, position, RATE), -early)
    part = recording(log, position, noise=(0.02, 1e-8))
    assert force_delay([part], AXIS, force_filter([part], AXIS)) == pytest.approx(0.5 + early, abs=0.1)


def test_a_force_measured_with_the_motion_has_none() -> None:
    position = linear_motion(multisine(20.0, 20.0), RATE)
    speed = np.gradient(position) * RATE
    force = MASS * np.gradient(speed) * RATE + 3.0 * speed + 1.5 * np.sign(speed)
    part = recording(force, position, noise=(0.02, 1e-8))
    assert force_delay([part], AXIS, force_filter([part], AXIS)) == pytest.approx(0.0, abs=0.1)


def test_a_spring_in_the_drive_is_not_taken_for_a_delay() -> None:
    load = 1.2
    force = multisine(20.0, 40.0)
    position = linear_motion(force, RATE, load * (2.0 * np.pi * 15.0) ** 2, load)
    part = recording(acting(force, position, RATE), position, noise=(0.05, 3e-7))
    assert force_delay([part], AXIS, force_filter([part], AXIS)) == pytest.approx(0.5, abs=0.15)


def test_the_delay_is_removed_before_the_comparison() -> None:
    force = multisine(20.0, 40.0)
    position = linear_motion(force, RATE)
    part = recording(acting(force, position, RATE), position)
    left = []
    for delay in (0.0, 0.5):
        inputs = force_inputs(part, AXIS, ForceFilter(force_hz=40.0, position_hz=100.0, delay=delay))
        a = signal.sosfiltfilt(inputs.low_pass, inputs.acceleration)[inputs.rows]
        left.append(np.std(inputs.force - MASS * a) / np.std(inputs.force))
    assert left[1] < 0.01
    assert left[0] > 0.05
