"""A tool that swings widely keeps the energy of a pendulum."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sysid.machine import KnownEffect
from sysid.machine.kinematics import GRAVITY
from sysid.plant import nominal_plant
from sysid.plant.stepper import Stepper
from sysid.testing.probe import RATE_HZ, probe_machine

LENGTH, DAMPING, SECONDS = 0.25, 0.001, 20.0


@pytest.mark.parametrize("degrees", [10.0, 45.0, 70.0])
def test_a_wide_swing_is_that_of_a_pendulum(degrees: float) -> None:
    """Against the equation of its angle."""
    rate, start = math.sqrt(GRAVITY / LENGTH), math.radians(degrees)

    def slope(_: float, state: np.ndarray) -> list[float]:
        angle, speed = state
        return [speed, -(rate**2) * math.sin(angle) - 2.0 * DAMPING * rate * speed]

    time = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    expected = solve_ivp(slope, (0.0, SECONDS), [start, 0.0], t_eval=time, rtol=1e-9, atol=1e-11).y[0]
    values = {"length": LENGTH, "damping_ratio": DAMPING}
    stepper = Stepper(nominal_plant(probe_machine()).with_effect(KnownEffect("gripper_sway", "tool", values)), RATE_HZ)
    joints = [0.0, 0.2, 0.0, 0.0]
    tip = stepper.reset(joints).ee[0]
    states = [stepper.reset(joints, swing=[tip[0] + LENGTH * math.sin(start), tip[1], 0.0, 0.0])]
    states += [stepper.step(np.zeros(4)) for _ in range(len(time) - 2)]
    found = np.array([math.asin((state.tool[0, 0] - tip[0]) / LENGTH) for state in states])
    expected = expected[1:]  # the tool moves by a sample when it is put at the given place
    late, first = slice(-round(2.0 * RATE_HZ), None), slice(0, round(2.0 * RATE_HZ))
    assert np.degrees(np.abs(found[late]).max()) == pytest.approx(np.degrees(np.abs(expected[late]).max()), abs=0.5)
    np.testing.assert_allclose(found[first], expected[first], atol=math.radians(0.5))
