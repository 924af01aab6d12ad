"""Gymnasium's own checkers are content."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from crane_model import Perfect, crane_plant
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from sysid.errors import SettingsError
from sysid_rl.train.driven import DrivenEnvironment
from sysid_rl.train.gym import MachineEnv, MachineVectorEnv
from sysid_rl.train.kinematic import KinematicEnvironment
from sysid_rl.train.task import Task

PLANT = crane_plant()
FORWARD = Perfect(PLANT)


#: What the checker would like and a machine in SI units, bare of a registration, does not have.
WISHES = ("Box action spaces", "not having a spec", "infinity")


def check(env: MachineEnv) -> None:
    """Gymnasium's checker; every warning but :data:`WISHES` is an error."""
    with warnings.catch_warnings():
        for wish in WISHES:
            warnings.filterwarnings("ignore", message=f"(?s).*{wish}")
        check_env(env, skip_render_check=True)


@pytest.mark.parametrize("normalised", [False, True])
def test_one_copy_passes_the_checker(normalised: bool) -> None:
    check(MachineEnv(KinematicEnvironment(PLANT, FORWARD), normalised))


def test_the_full_path_passes_the_checker() -> None:
    check(MachineEnv(DrivenEnvironment(PLANT, FORWARD)))


def test_episodes_are_truncated_and_show_their_last_observation() -> None:
    env = MachineEnv(KinematicEnvironment(PLANT, FORWARD, task=Task(steps=2)))
    first, _ = env.reset(seed=1)
    for last in (False, True):
        seen, reward, terminated, truncated, _ = env.step(first[:4])
        assert (terminated, truncated) == (False, last)
        np.testing.assert_array_equal(seen[7:], first[7:])
        assert isinstance(reward, float)
    joints = np.array([0.1, 0.4, -1.0, 0.1])
    seen, _ = env.reset(options={"joints": joints, "target": [0.8, 0.0, 0.3]})
    np.testing.assert_allclose(seen[:4], joints, rtol=1e-6)
    with pytest.raises(SettingsError, match="joints and target, or none"):
        env.reset(options={"joint": joints})


def test_many_copies_begin_again_in_the_same_step() -> None:
    env = MachineVectorEnv(KinematicEnvironment(PLANT, FORWARD, size=4, task=Task(steps=2)), normalised=True)
    assert env.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    seen, _ = env.reset(seed=3)
    again, _ = env.reset(seed=3)
    np.testing.assert_array_equal(seen, again)
    assert env.observation_space.contains(seen)
    actions = np.zeros((4, 4), dtype=np.float32)
    first, rewards, terminated, truncated, infos = env.step(actions)
    assert not terminated.any()
    assert not truncated.any()
    assert not infos
    assert rewards.shape == (4,)
    second, _, _, truncated, infos = env.step(actions)
    assert truncated.all()
    np.testing.assert_array_equal(infos["_final_obs"], truncated)
    np.testing.assert_array_equal(infos["final_obs"][:, 7:], first[:, 7:])
    assert np.abs(second[:, 7:] - first[:, 7:]).max() > 1e-3


def test_one_copy_is_one_copy() -> None:
    with pytest.raises(SettingsError, match="2 copies; expected one; MachineVectorEnv takes several"):
        MachineEnv(KinematicEnvironment(PLANT, FORWARD, size=2))
