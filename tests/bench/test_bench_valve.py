"""Valve: static map of the overlap, delay, lag, flow at either sign."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulated_bench.recipe import ValveSettings
from simulated_bench.valve import delayed, drive_speed, flow_fluctuation, freed, metered, opening, piloted_step, spool_step

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


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(0.0, 0.3), st.floats(0.2, 20.0))
def test_pilot_bounds_the_spool_and_is_integrated_exactly(start: float, target: float, lag: float, fastest: float) -> None:
    whole, mean = piloted_step(start, target, 0.01, lag, fastest)
    position, area = start, 0.0
    for _ in range(10):
        before = position
        position, part = piloted_step(position, target, 0.001, lag, fastest)
        area += part * 0.001
        assert abs(position - before) <= fastest * 0.001 + 1e-12
    assert position == pytest.approx(whole, abs=1e-12)
    assert area == pytest.approx(mean * 0.01, abs=1e-12)
    free = spool_step(start, target, 0.01, lag)
    assert abs(whole - start) <= abs(free[0] - start) + 1e-12
    assert piloted_step(start, target, 0.01, lag, math.inf) == free


@given(st.floats(-1.0, 1.0), st.floats(0.01, 1.0))
def test_notches_open_with_the_square_and_then_the_whole_edge(spool: float, notch: float) -> None:
    area = metered(spool, notch, 0.0)
    assert metered(-spool, notch, 0.0) == -area
    assert abs(area) <= abs(spool) + 1e-12
    assert metered(1.0, notch, 0.0) == pytest.approx(1.0)
    assert metered(0.5 * notch, notch, 0.0) == pytest.approx(metered(notch, notch, 0.0) / 4.0)
    slope = (metered(1.0, notch, 0.0) - metered(1.0 - 1e-6, notch, 0.0)) / 1e-6
    assert slope == pytest.approx(1.0 / (1.0 - 0.5 * notch), rel=1e-4)
    assert metered(spool, 0.0, 0.0) == spool


@given(st.floats(0.0, 1.0), st.floats(-0.9, 0.9))
def test_a_tapered_edge_widens_evenly(spool: float, taper: float) -> None:
    assert metered(-spool, 0.0, taper) == -metered(spool, 0.0, taper)
    assert metered(1.0, 0.0, taper) == pytest.approx(1.0)
    assert metered(1e-9, 0.0, taper) == pytest.approx((1.0 - taper) * 1e-9)
    step = 1e-4
    widths = [(metered(x + step, 0.0, taper) - metered(x, 0.0, taper)) / step for x in (0.2, 0.4, 0.6)]
    assert widths[1] - widths[0] == pytest.approx(widths[2] - widths[1], abs=1e-8)
    assert min(widths) > 0.0


def test_silt_locks_a_spool_at_rest_and_no_other() -> None:
    assert freed(0.2, 0.0, 0.25) == 0.0
    assert freed(-0.2, 0.0, 0.25) == 0.0
    assert freed(0.3, 0.0, 0.25) == 0.3
    assert freed(0.2, 0.1, 0.25) == 0.2
    assert freed(0.2, 0.0, 0.0) == 0.2


def test_direction_ratio_scales_the_negative_side_only() -> None:
    assert drive_speed(0.5, 0.03, 1.5, 0.0) == pytest.approx(0.015)
    assert drive_speed(-0.5, 0.03, 1.5, 0.0) == pytest.approx(-0.0225)


def test_flow_disturbance_has_the_stated_size_and_memory() -> None:
    settings = ValveSettings(gain=1.0, disturbance=0.05, disturbance_time=0.2)
    values = flow_fluctuation(settings, 400_000, 0.001, np.random.default_rng(3))
    assert np.std(values) == pytest.approx(0.05, rel=0.1)
    assert np.corrcoef(values[:-200], values[200:])[0, 1] == pytest.approx(math.exp(-1.0), abs=0.06)
    assert not flow_fluctuation(replace(settings, disturbance=0.0), 1000, 0.001, np.random.default_rng(3)).any()
