"""The full path: what is observed, exact resume, candidates evaluated by the plant, the same in PyBullet."""

from __future__ import annotations

import json

import numpy as np
import pytest
from crane_model import Perfect, crane_plant

from sysid.errors import InputError, SettingsError
from sysid.machine import KnownEffect
from sysid_rl.train.driven import DrivenEnvironment
from sysid_rl.train.task import Task

PLANT = crane_plant(KnownEffect("gripper_sway", "tool", {"length": 0.22, "damping_ratio": 0.04}))
FORWARD = Perfect(PLANT)


def environment(size: int = 2, seed: int = 0, **settings: object) -> DrivenEnvironment:
    task = settings.pop("task", Task(steps=50))
    return DrivenEnvironment(PLANT, FORWARD, size=size, seed=seed, task=task, **settings)  # type: ignore[arg-type]


def test_the_observation_begins_as_in_the_papers_setting_and_goes_on() -> None:
    env = environment()
    seen = env.reset()
    assert seen.shape == (2, env.observations) == (2, len(env.names))
    points = [f"{what}.{axis}" for what in ("ee", "target") for axis in "xyz"]
    assert list(env.names[:10]) == ["slew.joint", "boom.joint", "stick.joint", "telescope.joint", *points]
    np.testing.assert_allclose(seen[:, 4:7], FORWARD.predict(seen[:, :4]), atol=1e-9)
    np.testing.assert_array_equal(seen[:, 10 : 10 + 4 * env.history], 0.0)
    wanted = seen[:, :4] + [0.2, 0.05, 0.1, 0.02]
    for _ in range(10):
        seen, _, _ = env.step(wanted)
    by_name = dict(zip(env.names, seen.T, strict=True))
    np.testing.assert_array_equal(by_name["slew.command[-1]"], env.commands[:, 0])
    assert (by_name["slew.command[-1]"] > 0.1).all()
    assert (env.observation_low < env.observation_high).all()
    assert env.history == 12  # the longest dead time, 104 ms, in steps of 10 ms


def test_joints_come_late_but_they_come() -> None:
    env = environment(size=1, task=Task(steps=400))
    begin = np.array([0.0, 0.4, -1.2, 0.1])
    env.begin(begin, [0.8, 0.0, 0.3])
    wanted = begin + np.array([0.2, 0.1, 0.1, 0.05])
    seen, _, _ = env.step(wanted[None])
    np.testing.assert_allclose(seen[0, :4], begin, atol=1e-9)  # dead time
    for _ in range(300):
        seen, _, _ = env.step(wanted[None])
    np.testing.assert_allclose(seen[0, :4], wanted, atol=2e-3)


def test_the_tool_sways_below_the_tip() -> None:
    env = environment(size=1, task=Task(steps=400))
    env.begin([0.0, 0.4, -1.2, 0.1], [0.8, 0.0, 0.3])
    below = []
    for k in range(200):
        seen, _, _ = env.step(np.array([[0.3 if k < 60 else 0.0, 0.4, -1.2, 0.1]]))
        by_name = dict(zip(env.names, seen[0], strict=True))
        below.append([by_name[f"tool.below.{axis}"] for axis in "xyz"])
        np.testing.assert_allclose(below[-1], env.tool[0] - seen[0, 4:7], atol=1e-12)
    assert np.ptp(np.array(below)[:, 1]) > 0.01
    np.testing.assert_allclose(np.linalg.norm(below, axis=1), 0.22, atol=1e-3)


@pytest.mark.parametrize("feedback", ["static", "plant"])
def test_a_restored_environment_goes_on_to_the_last_bit(feedback: str) -> None:
    one, other = (environment(seed=seed, task=Task(steps=8, targets=2), feedback=feedback) for seed in (3, 5))
    rng = np.random.default_rng(1)
    actions = one.reset()[:, :4] + 0.1 * rng.standard_normal((20, 2, 4))
    for action in actions[:11]:
        one.step(action)
    state = one.state()
    state["generator"] = json.loads(json.dumps(state["generator"]))
    other.restore(state)
    for action in actions[11:]:
        candidates = np.repeat(action, 3, axis=0)
        np.testing.assert_array_equal(one.predicted(candidates, candidates), other.predicted(candidates, candidates))
        for a, b in zip(one.step(action), other.step(action), strict=True):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(one.final, other.final)


def test_the_plant_says_where_a_candidate_will_be_and_is_not_moved_by_the_question() -> None:
    env = environment(size=2, feedback="plant")
    seen = env.reset()
    for _ in range(5):
        seen, _, _ = env.step(seen[:, :4] + 0.05)
    before = env.state()
    wanted = np.concatenate([seen[:1, :4] + d for d in (0.0, 0.1)] + [seen[1:, :4] + d for d in (0.0, 0.1)])
    said = env.predicted(seen, wanted)
    after = env.state()
    assert all(np.array_equal(before[key], after[key], equal_nan=True) for key in before if key != "generator")
    for _ in range(env.horizon):
        seen, _, _ = env.step(wanted[[1, 3]])
    np.testing.assert_allclose(said[[1, 3]], seen[:, 4:7], atol=1e-12)
    static = FORWARD.predict(np.clip(wanted, env.action_low, env.action_high))
    assert np.linalg.norm(static - said, axis=1).max() > 0.01
    with pytest.raises(InputError, match="3 candidates; expected as many for each of 2 copies"):
        env.predicted(seen, wanted[:3])


def test_an_episode_ends_at_rest_elsewhere() -> None:
    env = environment(task=Task(steps=5))
    seen = env.reset()
    for _ in range(5):
        last = seen
        seen, _, truncated = env.step(seen[:, :4] + 0.1)
    assert truncated.all()
    assert np.abs(env.final[:, :4] - last[:, :4]).max() < 0.1
    assert np.abs(seen[:, :4] - last[:, :4]).max() > 0.1
    np.testing.assert_array_equal(seen[:, 10 : 10 + 4 * env.history], 0.0)


@pytest.mark.parametrize("noise", [False, True])
def test_an_action_may_stay_for_several_samples(noise: bool) -> None:
    """One step of it is as many of the others with the same action; its reward is that of the last of them."""
    each, held = environment(noise=noise, task=Task(steps=30)), environment(noise=noise, task=Task(steps=6), repeat=5)
    assert (each.rate_hz, held.rate_hz) == (100.0, 20.0)
    assert each.history == held.history
    actions = each.reset()[:, :4] + 0.1 * np.random.default_rng(1).standard_normal((6, 2, 4))
    held.reset()
    for action in actions:
        for _ in range(5):
            _, rewards, over = each.step(action)
        _, found, truncated = held.step(action)
        np.testing.assert_array_equal(held.final, each.final)
        np.testing.assert_array_equal(found, rewards)
        np.testing.assert_array_equal(truncated, over)
    assert truncated.all()


def test_the_plant_judges_a_candidate_as_long_as_it_stays() -> None:
    env = environment(size=2, feedback="plant", repeat=40)
    assert env.repeat > env.horizon
    seen = env.reset()
    actions = seen[:, :4] + 0.05
    predicted = env.predicted(seen, actions)
    env.step(actions)
    np.testing.assert_array_equal(predicted, env.final[:, 4:7])


def test_in_pybullet_it_moves_the_same() -> None:
    pytest.importorskip("pybullet")
    compiled, world = environment(size=1), environment(size=1, mover="pybullet")
    start = np.array([0.1, 0.4, -1.2, 0.1])
    for env in (compiled, world):
        env.begin(start, [0.8, 0.0, 0.3])
    state = world.state()
    for k in range(30):
        wanted = (start + 0.1 * np.sin(0.1 * k))[None]
        (a, reward, _), (b, same, _) = compiled.step(wanted), world.step(wanted)
        np.testing.assert_allclose(a[:, :7], b[:, :7], atol=2e-4)
        np.testing.assert_allclose(reward, same, atol=2e-4)
    with pytest.raises(SettingsError, match="the middle of an episode; expected the beginning of one"):
        world.state()
    world.restore(state)
    np.testing.assert_allclose(world.aim([0.8, 0.0, 0.3])[0, :4], start, atol=1e-6)


def test_sensor_noise_reaches_the_controller_and_nothing_else() -> None:
    quiet, noisy = environment(size=1), environment(size=1, noise=True)
    for env in (quiet, noisy):
        env.begin([0.0, 0.4, -1.2, 0.1], [0.8, 0.0, 0.3])
    for _ in range(20):
        for env in (quiet, noisy):
            seen, _, _ = env.step(np.array([[0.0, 0.4, -1.2, 0.1]]))
            np.testing.assert_allclose(seen[0, :4], [0.0, 0.4, -1.2, 0.1], atol=2e-3)
    assert np.abs(quiet.commands).max() < 1e-4
    assert 1e-4 < np.abs(noisy.commands).max() < 0.2


def test_unknown_settings_suggest_the_nearest() -> None:
    with pytest.raises(SettingsError, match="feedback = 'plan'; expected 'plant'"):
        environment(feedback="plan")
    with pytest.raises(SettingsError, match="mover = 'bullet'; expected 'pybullet'"):
        environment(mover="bullet")
    with pytest.raises(SettingsError, match="repeat = 0; expected one sample or more"):
        environment(repeat=0)
