"""Valve: static map of the overlap, delay, lag, flow at either sign."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sysid.bench.recipe import ValveSettings
from sysid.bench.valve import delayed, drive_speed, flow_fluctuation, opening, spool_step

commands = st.floats(-1.0, 1.0)
overlaps = st.floats(0.0, 0.4)


@given(commands, overlaps, overlaps)
def test_overlap_takes_its_share_and_leaves_the_slope(u: float, positive: float, negative: float) -> None:
    expected = max(u - positive, 0.0) + min(u + negative, 0.0)
    assert opening(u, positive, negative, math.inf) == pytest.approx(expected, abs=1e-12)


def test_saturation_limits_what_the_overlap_left() -> None:
    assert opening(1.0, 0.1, 0.2, 0.5) == 0.5
    assert opening(-1.0, 0.1, 0.2, 0.5) == -0.5
    assert opening(0.4, 0.1, 0.2, 0.5) == pytest.approx(0.3)


@pytest.mark.parametrize("delay", [0.0, 0.0004, 0.0313, 0.04])
def test_delay_shifts_the_held_command_by_any_time(delay: float) -> None:
    """The step at 0.05 s arrives ``delay`` later; the step of the simulation in which it falls gets its share of it."""
    held = np.where(np.arange(20) >= 5, 1.0, 0.0)
    seen = np.array([delayed(held, 0.01, k * 0.001, 0.001, delay) for k in range(150)])
    assert np.sum(1.0 - seen) * 0.001 == pytest.approx(0.05 + delay, abs=1e-9)
    assert np.count_nonzero((seen > 1e-9) & (seen < 1.0 - 1e-9)) <= 1


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(0.005, 0.3))
def test_spool_is_integrated_exactly(start: float, target: float, time_constant: float) -> None:
    """Ten small steps end where one large one does, and cover the same area."""
    whole, mean = spool_step(start, target, 0.01, time_constant)
    position, area = start, 0.0
    for _ in range(10):
        position, part = spool_step(position, target, 0.001, time_constant)
        area += part * 0.001
    assert position == pytest.approx(whole, abs=1e-12)
    assert area == pytest.approx(mean * 0.01, abs=1e-12)


def test_spool_without_lag_is_at_its_target() -> None:
    assert spool_step(0.3, -0.7, 0.001, 0.0) == (-0.7, -0.7)


def test_direction_ratio_scales_the_negative_side_only() -> None:
    assert drive_speed(0.5, 0.03, 1.5, 0.0) == pytest.approx(0.015)
    assert drive_speed(-0.5, 0.03, 1.5, 0.0) == pytest.approx(-0.0225)


def test_flow_disturbance_has_the_stated_size_and_memory() -> None:
    settings = ValveSettings(gain=1.0, disturbance=0.05, disturbance_time=0.2)
    values = flow_fluctuation(settings, 400_000, 0.001, np.random.default_rng(3))
    assert np.std(values) == pytest.approx(0.05, rel=0.1)
    assert np.corrcoef(values[:-200], values[200:])[0, 1] == pytest.approx(math.exp(-1.0), abs=0.06)
    assert not flow_fluctuation(replace(settings, disturbance=0.0), 1000, 0.001, np.random.default_rng(3)).any()
