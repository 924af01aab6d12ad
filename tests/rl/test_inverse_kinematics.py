"""Inverse kinematics: right where the target can be reached, bounded where it cannot, the same as scipy's solver."""

from __future__ import annotations

import numpy as np
import pytest
from crane_model import Perfect, crane_plant
from scipy.optimize import least_squares

from sysid.errors import InputError
from sysid.machine import KnownEffect
from sysid.plant import compile_plant
from sysid_rl.train.inverse_kinematics import InverseKinematics, KinematicChain, chain_of_forward, chain_of_plant
from sysid_rl.train.reach import joint_limits, tips

PLANT = crane_plant(
    KnownEffect("joint_offset", "boom", {"offset": 0.02}),
    KnownEffect("link_length_error", "stick", {"error": 0.01}),
    KnownEffect("tip_offset", "ee", {"translation": [0.01, -0.02, 0.015]}),
    KnownEffect("base_misalignment", "base", {"translation": [0.01, -0.02, 0.005], "rotation": [0.02, 0.01, -0.03]}),
)
LOW, HIGH = joint_limits(PLANT)
CHAIN = chain_of_plant(PLANT)


def poses(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    joints = np.random.default_rng(seed).uniform(LOW, HIGH, (count, 4))
    return joints, tips(compile_plant(PLANT), joints)


def test_the_chain_is_the_plants_kinematics() -> None:
    joints, ends = poses(200)
    np.testing.assert_allclose(CHAIN.predict(joints), ends, atol=1e-13)


def test_what_can_be_reached_is_reached_within_bounds() -> None:
    joints, ends = poses(300)
    inverse = InverseKinematics.of(CHAIN, LOW, HIGH)
    near = np.clip(joints + 0.2 * np.random.default_rng(1).standard_normal(joints.shape), LOW, HIGH)
    found, left = inverse.solve(ends, near)
    assert np.mean(left < 1e-6) > 0.98  # a few beginnings lead into a corner of the bounds
    assert (found >= LOW).all()
    assert (found <= HIGH).all()
    good = left < 1e-6
    np.testing.assert_allclose(tips(compile_plant(PLANT), found[good]), ends[good], atol=2e-6)


def test_out_of_reach_it_stays_as_near_as_scipys_bounded_solver() -> None:
    inverse = InverseKinematics.of(CHAIN, LOW, HIGH)
    targets = np.array([[2.0, 0.3, 0.5], [0.9, 1.2, 0.2], [0.6, 0.0, -0.6], [0.4, 0.1, 1.6]])
    middle = 0.5 * (LOW + HIGH)
    for target in targets:
        joints, mine = inverse.reach(target, np.random.default_rng(0))
        theirs = least_squares(lambda q, target=target: CHAIN.predict(q)[0] - target, middle, bounds=(LOW, HIGH), xtol=1e-12)
        assert mine <= np.linalg.norm(theirs.fun) + 1e-6
        assert mine == pytest.approx(float(np.linalg.norm(CHAIN.predict(joints)[0] - target)))


def test_a_path_is_followed_without_jumps() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 400)
    path = np.array([0.85, 0.0, 0.3]) + 0.2 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    inverse = InverseKinematics.of(CHAIN, LOW, HIGH)
    begin, left = inverse.reach(path[0], np.random.default_rng(0))
    assert left < 1e-6
    joints, away = inverse.follow(path, begin)
    assert away.max() < 1e-6
    assert np.abs(np.diff(joints, axis=0)).max() < 0.02


def test_any_forward_model_will_do() -> None:
    """The plant as a black box: slopes by differences instead of the compiled chain."""
    forward = Perfect(PLANT)
    assert chain_of_forward(forward) is None
    joints, ends = poses(40, seed=3)
    near = np.clip(joints + 0.1, LOW, HIGH)
    found, left = InverseKinematics.of(forward, LOW, HIGH).solve(ends, near)
    compiled, exact = InverseKinematics.of(CHAIN, LOW, HIGH).solve(ends, near)
    assert np.median(left) < 1e-6
    both = (left < 1e-6) & (exact < 1e-6)
    assert both.mean() > 0.9
    np.testing.assert_allclose(found[both], compiled[both], atol=0.03)  # nearly the same one out of a line of them
    path = CHAIN.predict(np.linspace(joints[0], joints[0] + 0.05, 5))
    followed, away = InverseKinematics.of(forward, LOW, HIGH).follow(path, joints[0])
    assert away.max() < 1e-6
    assert followed.shape == (5, 4)


def test_shapes_and_numbers_are_checked() -> None:
    inverse = InverseKinematics.of(CHAIN, LOW, HIGH)
    with pytest.raises(InputError, match="targets of shape"):
        inverse.solve(np.zeros((2, 3)), LOW)
    with pytest.raises(InputError, match="no finite number"):
        inverse.solve([[np.nan, 0.0, 0.0]], [LOW])
    assert isinstance(inverse.model, KinematicChain)
