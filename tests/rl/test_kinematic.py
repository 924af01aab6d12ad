"""The paper's setting: observations, rewards, episodes, exact resume, refusals."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from crane_model import Perfect, crane_plant

from sysid.errors import InputError, SettingsError
from sysid_rl.train.kinematic import KinematicEnvironment
from sysid_rl.train.reach import joint_limits
from sysid_rl.train.task import Task

PLANT = crane_plant()
FORWARD = Perfect(PLANT)


def environment(size: int = 3, seed: int = 0, **task: int) -> KinematicEnvironment:
    return KinematicEnvironment(PLANT, FORWARD, size=size, seed=seed, task=Task(**task))


def test_an_observation_is_joints_end_effector_and_target() -> None:
    env = environment()
    seen = env.reset()
    assert seen.shape == (3, 10)
    assert (env.observations, env.actions, env.steps) == (10, 4, 1000)
    np.testing.assert_allclose(seen[:, 4:7], FORWARD.predict(seen[:, :4]), atol=1e-12)
    np.testing.assert_array_equal(env.targets(seen), seen[:, 7:])
    assert (seen >= env.observation_low - 0.02).all()
    assert (seen <= env.observation_high + 0.02).all()


def test_joints_follow_at_once_and_the_reward_is_the_papers() -> None:
    env = environment()
    target = env.targets(env.reset())
    wanted = np.array([[0.3, 0.5, -1.2, 0.1], [0.0, 0.2, -0.9, 0.2], [0.1, 0.4, -1.0, 5.0]])
    seen, rewards, truncated = env.step(wanted)
    clipped = np.minimum(wanted, env.action_high)
    np.testing.assert_array_equal(seen[:, :4], clipped)
    np.testing.assert_allclose(seen[:, 4:7], FORWARD.predict(clipped), atol=1e-12)
    away = np.linalg.norm(target - seen[:, 4:7], axis=1)
    np.testing.assert_allclose(rewards, 0.001 - away + 0.002 - np.array([0.0, 0.0, 0.0005]), atol=1e-15)
    np.testing.assert_allclose(rewards, env.task.reward(seen[:, 4:7], target, [False, False, True]), atol=1e-15)
    assert not truncated.any()


def test_an_episode_ends_and_the_next_one_begins_elsewhere() -> None:
    env = environment(steps=3, targets=1)
    first = env.reset()
    for _ in range(2):
        seen, _, truncated = env.step(first[:, :4])
        assert not truncated.any()
        np.testing.assert_array_equal(env.targets(seen), env.targets(first))
    seen, _, truncated = env.step(first[:, :4])
    assert truncated.all()
    np.testing.assert_array_equal(env.targets(env.final), env.targets(first))
    np.testing.assert_array_equal(env.final[:, :4], first[:, :4])
    assert (np.abs(env.targets(seen) - env.targets(first)).max(axis=1) > 1e-3).all()


def test_an_episode_may_have_several_targets() -> None:
    env = environment(steps=6, targets=3)
    seen = env.reset()
    aims = [env.targets(seen)]
    for _ in range(5):
        seen, _, truncated = env.step(seen[:, :4])
        assert not truncated.any()
        aims.append(env.targets(seen))
    changed = [not np.array_equal(a, b) for a, b in itertools.pairwise(aims)]
    assert changed == [False, True, False, True, False]


def test_targets_are_where_the_machine_can_be() -> None:
    env = environment(size=200)
    aims = env.targets(env.reset())
    reach = env.reach
    assert (aims >= reach.ee_low - 0.02).all()
    assert (aims <= reach.ee_high + 0.02).all()
    assert np.ptp(aims, axis=0).min() > 0.5


def test_a_restored_environment_goes_on_to_the_last_bit() -> None:
    one, other = environment(seed=4, steps=5, targets=2), environment(seed=9, steps=5, targets=2)
    rng = np.random.default_rng(1)
    one.reset()
    actions = rng.uniform(one.action_low, one.action_high, (12, 3, 4))
    for action in actions[:7]:
        one.step(action)
    state = one.state()
    state["generator"] = json.loads(json.dumps(state["generator"]))
    other.restore(state)
    for action in actions[7:]:
        for a, b in zip(one.step(action), other.step(action), strict=True):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(one.final, other.final)


def test_a_state_of_other_copies_is_refused() -> None:
    one = environment(size=2)
    one.reset()
    with pytest.raises(InputError, match=r"a state of shape \(2, 10\); expected one of shape \(3, 10\)"):
        environment(size=3).restore(one.state())


def test_a_setpoint_that_is_no_number_moves_nothing() -> None:
    env = environment()
    before = env.reset()
    bad = before[:, :4].copy()
    bad[1, 2] = np.nan
    with pytest.raises(InputError, match="no finite number"):
        env.step(bad)
    np.testing.assert_array_equal(env.aim(env.targets(before)), before)
    with pytest.raises(InputError, match=r"actions of shape \(3, 3\); expected \(3, 4\)"):
        env.step(before[:, :3])


def test_limits_are_the_narrowest_of_urdf_and_stroke() -> None:
    low, high = joint_limits(PLANT)
    boom = PLANT.linkages["boom"].joint(np.array([0.0, 0.1010]))
    assert low[1] == pytest.approx(max(boom.min(), -0.436332))
    assert high[1] == pytest.approx(min(boom.max(), 1.396263))
    assert (low[3], high[3]) == (0.0, 0.25)


def test_a_forward_model_of_other_joints_is_refused() -> None:
    class Other(Perfect):
        @property
        def joints(self) -> tuple[str, ...]:
            return ("slew.joint", "boom.joint", "stick.joint", "wrist.joint")

    with pytest.raises(SettingsError, match="has no joint 'wrist'"):
        KinematicEnvironment(PLANT, Other(PLANT))
    with pytest.raises(SettingsError, match="at least one copy"):
        environment(size=0)
