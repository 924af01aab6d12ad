"""Coordinated motion: fastest within its limits, straight, from rest to rest, and slowed by a shared pump."""

from __future__ import annotations

import math

import numpy as np
import pytest
from crane_model import crane_plant
from hypothesis import given
from hypothesis import strategies as st

from sysid.machine import KnownEffect
from sysid_rl.control import tune
from sysid_rl.control.coordinated_motion import RISE_S, SHARE, MotionLimits, coordinated_motion, motion_limits

ways = st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).filter(lambda way: max(map(abs, way)) > 1e-3)
LIMITS = MotionLimits(np.array([0.4, 0.03, 0.1]), np.array([2.0, 0.2, 0.4]), np.array([0.5, 0.05, 0.1]), 1.2)


@given(ways)
def test_within_all_limits_and_at_one_of_them(way: list[float]) -> None:
    begin = np.array([0.1, 0.2, 0.3])
    motion = coordinated_motion(begin, begin + way, LIMITS)
    dt = motion.duration / 2000.0
    path = np.array([motion.at(k * dt) for k in range(2001)])
    np.testing.assert_allclose(path[0], begin)
    np.testing.assert_allclose(path[-1], begin + way)
    speed = np.diff(path, axis=0) / dt
    acceleration = np.diff(speed, axis=0) / dt
    shares = (
        (np.abs(speed) / LIMITS.speed).max(),
        (np.abs(speed) / LIMITS.gain).sum(axis=1).max() / LIMITS.flow,
        (np.abs(acceleration) / LIMITS.acceleration).max(),
    )
    assert max(shares) < 1.0 + 1e-6
    assert max(shares) > 0.99
    across = (path - begin) - np.outer((path - begin) @ way, way) / np.dot(way, way)
    assert np.abs(across).max() < 1e-9, "the path is straight"


def test_a_shared_pump_slows_only_what_needs_more_than_it_feeds() -> None:
    free = MotionLimits(LIMITS.speed, LIMITS.acceleration, LIMITS.gain)
    alone, together = np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.1, 0.25])
    assert coordinated_motion(np.zeros(3), alone, LIMITS).duration == coordinated_motion(np.zeros(3), alone, free).duration
    slowed, fast = (coordinated_motion(np.zeros(3), together, limits) for limits in (LIMITS, free))
    flow = np.sum(together / LIMITS.gain) * fast.rate
    assert flow > LIMITS.flow
    assert slowed.rate == pytest.approx(fast.rate * LIMITS.flow / flow)


def test_no_way_takes_no_time() -> None:
    motion = coordinated_motion(np.ones(3), np.ones(3), LIMITS)
    assert motion.duration == 0.0
    np.testing.assert_array_equal(motion.at(0.0), 1.0)


def test_limits_of_a_plant() -> None:
    plant = crane_plant(KnownEffect("pump_flow_limit", "machine", {"limit": 1.5}))
    limits = motion_limits(plant, tune(plant))
    assert limits.flow == pytest.approx(SHARE * 1.5)
    np.testing.assert_allclose(limits.speed, [SHARE * item.fastest for item in tune(plant)])
    np.testing.assert_allclose(limits.acceleration * RISE_S, limits.speed)
    assert math.isinf(motion_limits(plant, tune(plant), with_pump=False).flow)
    assert math.isinf(motion_limits(crane_plant(), tune(crane_plant())).flow)
