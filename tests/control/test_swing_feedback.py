"""Swing of a hanging tool: estimated from the motion of the tip as the plant moves it, and damped by feedback."""

from __future__ import annotations

import math

import numpy as np
import pytest
from crane_model import Perfect, crane_plant
from hypothesis import given
from hypothesis import strategies as st

from sysid.machine import KnownEffect
from sysid_rl.control.pendulum import Pendulum, pendulum_of
from sysid_rl.control.swing_damper import SwingDamper
from sysid_rl.control.swing_estimator import SwingEstimator
from sysid_rl.train.driven import DrivenEnvironment
from sysid_rl.train.task import Task

PLANT = crane_plant(KnownEffect("gripper_sway", "tool", {"length": 0.22, "damping_ratio": 0.04}))


def test_the_estimate_is_the_swing_of_the_plant() -> None:
    env = DrivenEnvironment(PLANT, Perfect(PLANT), size=2, task=Task(steps=1000))
    seen = env.begin([0.0, 0.4, -1.2, 0.1], [0.8, 0.0, 0.3])
    estimator = SwingEstimator(pendulum_of(PLANT), 100.0, copies=2)
    estimator.reset(seen[:, 4:7])
    for k in range(300):
        seen, _, _ = env.step(np.array([[0.3 if k < 60 else 0.0, 0.4, -1.2, 0.1], [0.1, 0.5, -1.2, 0.1]]))
        below, speed = estimator.step(seen[:, 4:7])
        np.testing.assert_allclose(below, seen[:, -6:-3], atol=1e-9)
        np.testing.assert_allclose(speed, seen[:, -3:], atol=1e-7)
    assert np.abs(seen[0, -6:-4]).max() > 0.005, "it swings"


@given(st.floats(0.2, 0.8), st.floats(0.0, 0.06), st.floats(0.03, 0.08), st.floats(0.15, 0.5))
def test_feedback_adds_its_damping_ratio(share: float, delay: float, lag: float, length: float) -> None:
    """A tip whose speed follows that of the offset with delay and lag: it decays at about ζ + ζ_a, for ζ_a below its bound."""
    pendulum, dt = Pendulum(length, 0.02), 1e-3
    w = pendulum.frequency
    added = share * 0.5 * w * lag
    damper = SwingDamper(pendulum, added, delay + lag)
    late = round(delay / dt)
    offsets = np.zeros(late + 2)
    d, v, speed = 0.05, 0.0, 0.0
    seconds = 2.0 * pendulum.period
    for _ in range(round(seconds / dt)):
        offsets[1:] = offsets[:-1]
        offsets[0] = damper.offset(np.array([[d, 0.0, -length]]), np.array([[v, 0.0, 0.0]]))[0, 0]
        pull = ((offsets[late] - offsets[late + 1]) / dt - speed) / lag
        speed += dt * pull
        v += dt * (-2.0 * pendulum.damping_ratio * w * v - w * w * d - pull)
        d += dt * v
    found = -math.log(math.hypot(d, v / w) / 0.05) / (w * seconds)
    assert found == pytest.approx(0.02 + added, rel=0.5)


def test_a_tool_at_rest_moves_nothing() -> None:
    damper = SwingDamper(Pendulum(0.2, 0.0), 0.2, 0.1)
    np.testing.assert_array_equal(damper.offset(np.array([[0.0, 0.0, -0.2]]), np.zeros((1, 3))), np.zeros((1, 3)))
