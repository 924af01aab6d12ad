"""The spherical pendulum against theory and against a reference integration of its equations."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipk

from simulated_bench.gripper import GRAVITY, swing

Array = npt.NDArray[np.float64]
STEP = 0.001


def let_go(angle: float, length: float, damping_ratio: float, seconds: float) -> Array:
    """Horizontal deflection of a pendulum that starts at rest at ``angle`` below a fixed pivot, (n,)."""
    pivot = np.zeros(3)
    tool = length * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    velocity = np.zeros(3)
    out = np.empty(round(seconds / STEP))
    for k in range(len(out)):
        out[k] = tool[0]
        swing(tool, velocity, pivot, pivot, length, damping_ratio, STEP)
        assert np.linalg.norm(tool) == pytest.approx(length, rel=1e-9)
    return out


def crossings(signal: Array) -> Array:
    """Times of falling zero crossings [s]."""
    k = np.flatnonzero((signal[:-1] > 0.0) & (signal[1:] <= 0.0))
    return np.asarray((k + signal[k] / (signal[k] - signal[k + 1])) * STEP)


@pytest.mark.parametrize("length", [0.20, 0.22, 0.30])
@pytest.mark.parametrize("angle", [0.02, 0.8])
def test_period_is_that_of_a_pendulum_of_any_amplitude(length: float, angle: float) -> None:
    expected = 4.0 * np.sqrt(length / GRAVITY) * float(ellipk(np.sin(0.5 * angle) ** 2))
    assert np.diff(crossings(let_go(angle, length, 0.0, 6.0))).mean() == pytest.approx(expected, rel=1e-4)


def test_undamped_swing_keeps_its_height() -> None:
    deflection = let_go(0.5, 0.22, 0.0, 30.0)
    assert np.abs(deflection[-1500:]).max() == pytest.approx(np.abs(deflection[:1500]).max(), rel=1e-3)


@pytest.mark.parametrize("damping_ratio", [0.01, 0.04, 0.08])
def test_small_swings_decay_with_the_damping_ratio(damping_ratio: float) -> None:
    deflection = let_go(0.02, 0.22, damping_ratio, 8.0)
    peaks = [k for k in range(1, len(deflection) - 1) if deflection[k - 1] < deflection[k] >= deflection[k + 1]]
    decrement = np.mean(np.diff(np.log(deflection[peaks])))
    expected = -2.0 * np.pi * damping_ratio / np.sqrt(1.0 - damping_ratio**2)
    assert decrement == pytest.approx(expected, rel=0.02)


def test_moving_pivot_gives_the_motion_of_the_full_equations() -> None:
    """r̈ = g − ẍ_pivot − 2ζω₀ṙ + tension along r, integrated by an independent method of high order."""
    length, damping_ratio, seconds = 0.22, 0.04, 10.0
    drag = 2.0 * damping_ratio * np.sqrt(GRAVITY / length)

    def pivot(t: float) -> Array:
        return np.array([0.05 * np.sin(3.0 * t), 0.04 * np.sin(2.0 * t) ** 2, 0.03 * np.sin(4.0 * t)])

    def acceleration(t: float) -> Array:
        return np.array([-0.45 * np.sin(3.0 * t), 0.32 * np.cos(4.0 * t), -0.48 * np.sin(4.0 * t)])

    def equations(t: float, state: Array) -> Array:
        rod, velocity = state[:3], state[3:]
        free = np.array([0.0, 0.0, -GRAVITY]) - acceleration(t) - drag * velocity
        return np.concatenate([velocity, free - rod * (velocity @ velocity + free @ rod) / (rod @ rod)])

    start = np.array([0.0, 0.0, -length, -0.15, 0.0, 0.0])
    reference = solve_ivp(equations, (0.0, seconds), start, rtol=1e-9, atol=1e-11, t_eval=np.arange(0.0, seconds, 0.1))
    tool, velocity, rods = np.array([0.0, 0.0, -length]), np.array([0.0, 0.0, 0.12]), []
    for k in range(round(seconds / STEP)):
        if k % 100 == 0:
            rods.append(tool - pivot(k * STEP))
        swing(tool, velocity, pivot(k * STEP), pivot((k + 1) * STEP), length, damping_ratio, STEP)
    assert np.ptp(reference.y[0]) > 0.03
    assert np.abs(np.array(rods) - reference.y[:3].T).max() < 1e-4


def test_hangs_still_below_a_still_pivot() -> None:
    assert not let_go(0.0, 0.22, 0.04, 1.0).any()


def test_length_zero_is_a_tool_at_the_tip() -> None:
    tool, velocity = np.zeros(3), np.zeros(3)
    swing(tool, velocity, np.zeros(3), np.array([0.01, 0.02, 0.03]), 0.0, 0.04, STEP)
    assert tool.tolist() == [0.01, 0.02, 0.03]
