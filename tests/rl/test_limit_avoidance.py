"""Gradient projection: joints leave their limits while the end effector stays where it is."""

from __future__ import annotations

import numpy as np
import pytest
from crane_model import crane_plant

from sysid.errors import SettingsError
from sysid.rl.clearance import Sphere, clearance, link_ends
from sysid.rl.inverse_kinematics import InverseKinematics, KinematicChain, chain_of_plant
from sysid.rl.limit_avoidance import LimitAvoidingPolicy
from sysid.rl.reach import joint_limits

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


def test_links_are_lines_between_the_joints() -> None:
    rng = np.random.default_rng(1)
    joints = INVERSE.low + SPAN * rng.uniform(0.0, 1.0, (20, 4))
    ends = link_ends(CHAIN, joints)
    np.testing.assert_allclose(ends[:, -1], CHAIN.predict(joints))
    lengths = np.linalg.norm(np.diff(ends, axis=1), axis=2)
    assert np.ptp(lengths[:, 1], axis=0) < 1e-9, "the boom has one length"
    sphere = Sphere(np.array([0.6, 0.1, 0.5]), 0.05)
    points = ends[:, :-1, None] + np.linspace(0.0, 1.0, 2001)[:, None] * np.diff(ends, axis=1)[:, :, None]
    expected = np.linalg.norm(points - sphere.centre, axis=-1).min(axis=(1, 2)) - sphere.radius
    np.testing.assert_allclose(clearance(CHAIN, joints, sphere), expected, atol=1e-5)


def test_a_link_leaves_an_obstacle_and_the_tip_stays() -> None:
    joints = INVERSE.low + SPAN * [0.5, 0.5, 0.4, 0.4]
    target = CHAIN.predict(joints)[0]
    elbow = link_ends(CHAIN, joints[None])[0, 2]
    obstacle = Sphere(elbow + np.array([0.0, 0.0, 0.07]), 0.05)
    seen = np.concatenate([joints, target, target])[None]
    with_it, without = (LimitAvoidingPolicy(INVERSE, CHAIN, 100.0, given) for given in ((obstacle,), ()))
    paths = []
    for policy in (with_it, without):
        policy.reset(seen)
        paths.append(np.array([policy.act(seen)[0] for _ in range(600)]))
    assert np.linalg.norm(CHAIN.predict(paths[0]) - target, axis=1).max() < 1e-5
    away, other = (clearance(CHAIN, path, obstacle) for path in paths)
    assert clearance(CHAIN, joints[None], obstacle)[0] == pytest.approx(0.02, abs=2e-3)
    assert away[-1] > 0.05
    assert away[-1] > other[-1] + 0.02


def test_without_redundancy_it_is_refused() -> None:
    three = InverseKinematics(KinematicChain(CHAIN.rows[:3], CHAIN.last), INVERSE.low[:3], INVERSE.high[:3])
    with pytest.raises(SettingsError, match="a redundant machine"):
        LimitAvoidingPolicy(three, CHAIN, 100.0)
