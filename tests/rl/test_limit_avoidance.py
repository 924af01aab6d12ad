"""Gradient projection: joints leave their limits while the end effector stays where it is."""

from __future__ import annotations

import numpy as np
import pytest
from crane_model import crane_plant

from sysid.errors import SettingsError
from sysid_rl.train.inverse_kinematics import InverseKinematics, KinematicChain, chain_of_plant
from sysid_rl.train.limit_avoidance import LimitAvoidingPolicy
from sysid_rl.train.reach import joint_limits

PLANT = crane_plant()
CHAIN = chain_of_plant(PLANT)
INVERSE = InverseKinematics(CHAIN, *joint_limits(PLANT))
SPAN = INVERSE.high - INVERSE.low


def test_a_joint_near_its_limit_moves_away_and_the_tip_stays() -> None:
    joints = INVERSE.low + SPAN * [0.5, 0.5, 0.5, 0.02]
    target = CHAIN.predict(joints)[0]
    policy = LimitAvoidingPolicy(INVERSE, CHAIN, 100.0)
    seen = np.concatenate([joints, target, target])[None]
    policy.reset(seen)
    path = np.array([policy.act(seen)[0] for _ in range(600)])
    assert np.linalg.norm(CHAIN.predict(path) - target, axis=1).max() < 1e-5
    margin = INVERSE.margin(path)
    assert INVERSE.margin(joints[None])[0] == pytest.approx(0.02)
    assert margin[-1] > 0.15
    assert np.abs(np.diff(path, axis=0) / SPAN).max() < 0.1 / 100.0 * 1.1, "not faster than its rate"
    assert np.abs(path[-1] - path[-2]).max() < 1e-3 * np.abs(path[1] - path[0]).max() + 1e-4, "it comes to rest"


def test_a_step_is_along_the_null_space() -> None:
    policy = LimitAvoidingPolicy(INVERSE, CHAIN, 100.0)
    rng = np.random.default_rng(0)
    for _ in range(50):
        joints = INVERSE.low + SPAN * rng.uniform(0.05, 0.95, 4)
        step = policy.away(joints) - joints
        moved = np.linalg.norm(CHAIN.predict((joints + step)[None]) - CHAIN.predict(joints[None]))
        assert moved < 1e-5, "second order in a step of a thousandth"


def test_without_redundancy_it_is_refused() -> None:
    three = InverseKinematics(KinematicChain(CHAIN.rows[:3], CHAIN.last), INVERSE.low[:3], INVERSE.high[:3])
    with pytest.raises(SettingsError, match="a redundant machine"):
        LimitAvoidingPolicy(three, CHAIN, 100.0)
