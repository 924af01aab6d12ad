"""Setpoints within their limits, whatever is asked for; limits of recipes that are refused."""

from __future__ import annotations

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from runner_case import DT, MIDDLE, PLANT

from sysid.errors import SettingsError
from sysid_rl.control import tune
from sysid_rl.run.limits import AxisLimits, LimitSettings, SetpointLimiter, limits_of
from sysid_rl.run.valves import axis_valves

VALVES = axis_valves(tune(PLANT), DT)
LIMITS = limits_of(PLANT, VALVES, LimitSettings(), "runner.toml")


@given(st.lists(st.tuples(*[st.floats(-10.0, 10.0)] * 4), min_size=1, max_size=30), st.integers(1, 20))
@settings(max_examples=50)
def test_nothing_leaves_position_speed_and_acceleration(requested: list[tuple[float, ...]], hold: int) -> None:
    limiter = SetpointLimiter(LIMITS, DT)
    limiter.reset(MIDDLE)
    path = [MIDDLE, MIDDLE]
    path += [limiter.step(np.array(wanted))[0] for wanted in requested for _ in range(hold)]
    places = np.array(path)
    speeds = np.diff(places, axis=0) / DT
    assert (places >= LIMITS.low - 1e-12).all()
    assert (places <= LIMITS.high + 1e-12).all()
    assert (np.abs(speeds) <= LIMITS.speed * (1.0 + 1e-9)).all()
    rising = np.diff(np.abs(speeds), axis=0) / DT  # a hard end may brake harder than planned, nothing speeds up harder
    assert (rising <= LIMITS.acceleration * (1.0 + 1e-9)).all()


def test_what_keeps_the_limits_passes_to_the_last_bit_and_a_jump_arrives_without_overshoot() -> None:
    limiter = SetpointLimiter(LIMITS, DT)
    limiter.reset(MIDDLE)
    smooth = MIDDLE + np.outer(0.5 - 0.5 * np.cos(0.5 * np.arange(400) * DT), [0.2, 0.1, 0.1, 0.02])
    for wanted in smooth:
        passed, broken = limiter.step(wanted)
        np.testing.assert_array_equal(passed, wanted)
        assert not broken
    limiter.reset(MIDDLE)
    goal = MIDDLE + np.array([0.5, -0.2, 0.3, 0.05])
    path = np.array([limiter.step(goal)[0] for _ in range(600)])
    share = (path - MIDDLE) / (goal - MIDDLE)
    assert share.max() < 1.001
    np.testing.assert_allclose(path[-1], goal, atol=1e-5)


def test_whoever_stands_outside_may_come_back_and_no_further_out() -> None:
    limiter = SetpointLimiter(LIMITS, DT)
    outside = LIMITS.high + 0.02
    limiter.reset(outside)
    assert (limiter.step(outside + 1.0)[0] <= outside).all()
    path = np.array([limiter.step(MIDDLE)[0] for _ in range(900)])
    np.testing.assert_allclose(path[-1], MIDDLE, atol=1e-4)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (LimitSettings(axes={"boon": AxisLimits()}), r"unknown axis 'boon'; expected 'boom'\?"),
        (LimitSettings(axes={"slew": AxisLimits(high=9.0)}), r"low = -2.618, high = 9; expected within -2.618 … 2.618"),
        (LimitSettings(axes={"slew": AxisLimits(speed=0.0)}), r"slew.speed: 0.0; expected a positive number"),
        (LimitSettings(axes={"slew": AxisLimits(command=1.5)}), r"slew.command: 1.5; expected at most 1"),
        (LimitSettings(fence={"w": (0.0, 1.0)}), r"unknown coordinate 'w'; expected x, y or z"),
        (LimitSettings(fence={"z": (0.0, 0.05)}), r"limits.fence.z: \[0.0, 0.05\]; expected a range above two margins"),
        (LimitSettings(margin=0.5), "a margin that leaves no range"),
    ],
)
def test_limits_that_cannot_be_are_refused(settings: LimitSettings, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        limits_of(PLANT, VALVES, settings, "runner.toml")


def test_no_number_asks_for_nothing() -> None:
    limiter = SetpointLimiter(LIMITS, DT)
    limiter.reset(MIDDLE)
    passed, broken = limiter.step(np.array([np.nan, np.inf, MIDDLE[2], -np.inf]))
    np.testing.assert_array_equal(passed, MIDDLE)
    assert [(check, axis) for check, axis, *_ in broken] == [("position", 0), ("position", 1), ("position", 3)]


@pytest.mark.parametrize("behind", [0.002, -0.01])
def test_a_setpoint_that_fell_behind_catches_up_with_a_target_that_speeds_up(behind: float) -> None:
    """It stayed behind by a step and more for as long as the target moved."""
    limiter = SetpointLimiter(LIMITS, DT)
    limiter.reset(MIDDLE + behind)
    smooth = MIDDLE + np.outer(0.5 - 0.5 * np.cos(1.2 * np.arange(400) * DT), [0.2, 0.1, 0.1, 0.02])
    path = np.array([limiter.step(wanted)[0] for wanted in smooth])
    assert np.abs(path[:100] - smooth[:100]).max() > 0.5 * abs(behind)
    np.testing.assert_array_equal(path[250:], smooth[250:])
