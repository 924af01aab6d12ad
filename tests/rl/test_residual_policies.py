"""Residual policies: inverse kinematics plus an offset that fades with the swing; training, resume, use on a machine."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from pathlib import Path as File
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from crane_model import Perfect, crane_plant

from sysid.errors import SettingsError
from sysid.machine import KnownEffect
from sysid.networks.mlp import Mlp, Normalisation
from sysid.networks.policy import PolicyNetwork, policy_from_files, policy_to_files
from sysid_rl.control.pendulum import pendulum_of
from sysid_rl.train.factory import make_environment
from sysid_rl.train.kinematic import KinematicEnvironment
from sysid_rl.train.paths import Path
from sysid_rl.train.residual import ResidualEnvironment
from sysid_rl.train.residual_observation import Residual, ResidualObservation
from sysid_rl.train.residual_policy import ResidualPolicy
from sysid_rl.train.task import Task
from sysid_rl.train.tracking import track, track_environment

Array = npt.NDArray[np.float64]
PLANT = crane_plant(KnownEffect("gripper_sway", "tool", {"length": 0.22, "damping_ratio": 0.04}))
FORWARD = Perfect(PLANT)
BEGIN, TARGET = np.array([-0.2, 0.5, -1.3, 0.1]), FORWARD.predict(np.array([[0.3, 0.4, -1.1, 0.15]]))[0]


def environment(size: int = 1, **settings: Any) -> ResidualEnvironment:
    settings = {"repeat": 10, "task": Task(steps=60, saturation=0.1), **settings}
    made = make_environment(PLANT, FORWARD, full=True, size=size, residual=Residual(), **settings)
    assert isinstance(made, ResidualEnvironment)
    return made


def random_network(env: ResidualEnvironment, scale: float = 1.0) -> PolicyNetwork:
    rng = np.random.default_rng(3)
    sizes = (env.observations, 16, env.actions)
    weights = tuple(scale * rng.normal(size=(a, b)) / np.sqrt(a) for a, b in itertools.pairwise(sizes))
    centre, half = 0.5 * (env.observation_low + env.observation_high), 0.5 * (env.observation_high - env.observation_low)
    mlp = Mlp(
        weights,
        tuple(np.zeros(len(w.T)) for w in weights),
        Normalisation(centre, half),
        Normalisation(np.zeros(env.actions), np.ones(env.actions)),
    )
    outputs = FORWARD.joints
    setting = {"share": 0.05, "full_swing": 0.05, "repeat": 10.0}
    return PolicyNetwork(env.names, outputs, mlp, env.action_low, env.action_high, full=True, residual=setting)


def test_without_an_offset_it_is_inverse_kinematics_and_the_raised_tool_arrives() -> None:
    env = environment(task=Task(steps=200, saturation=0.1))
    seen = env.begin(BEGIN, TARGET)
    assert seen.shape == (1, env.observations) == (1, len(env.names))
    np.testing.assert_allclose(seen[0, 4:7], FORWARD.predict(BEGIN[None])[0], atol=1e-6)
    for _ in range(150):
        seen, rewards, _ = env.step(np.zeros((1, 4)))
    np.testing.assert_allclose(seen[0, 4:7], TARGET, atol=0.01)
    away = np.linalg.norm(seen[0, 4:7] - TARGET)
    assert rewards[0] == pytest.approx(0.003 - away / (1.0 + away / 0.1), abs=1e-9)


def test_an_offset_fades_with_the_swing_and_is_bounded() -> None:
    view = environment().view
    driven = np.zeros((3, 10 + 48 + 4 + 6))
    driven[:, -6] = 0.0, 0.01, 1.0
    offsets = view.offset(np.tile([1.0, -1.0, 0.5, 0.0], (3, 1)), driven)
    np.testing.assert_array_equal(offsets[0], 0.0)
    np.testing.assert_allclose(offsets[1], 0.2 * offsets[2])
    np.testing.assert_allclose(offsets[2], view.bound * [1.0, -1.0, 0.5, 0.0])
    np.testing.assert_allclose(view.bound, 0.05 * (FORWARD.high - FORWARD.low))


@pytest.mark.parametrize("angle", [0.4, -2.0])
def test_a_swing_looks_the_same_in_every_direction_of_the_slew(angle: float) -> None:
    view = ResidualObservation(PLANT.machine.axis_names, pendulum_of(PLANT), Residual(), FORWARD.high - FORWARD.low)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    rng = np.random.default_rng(0)
    driven = rng.normal(size=(1, 10 + 48 + 10))
    turned = driven.copy()
    for part in (slice(4, 7), slice(-6, -3), slice(-3, None)):
        turned[0, part] = turn @ driven[0, part]
    one, other = (view.of(each, TARGET[None], np.zeros((1, 4)), np.zeros((1, 4))) for each in (driven, turned))
    np.testing.assert_allclose(one[0, -5:], other[0, -5:], atol=1e-12)
    assert one[0, -5] == pytest.approx(
        np.hypot(np.hypot(*driven[0, -6:-4]), np.hypot(*driven[0, -3:-1]) / view.pendulum.frequency)
    )


def test_a_tool_may_swing_from_the_beginning() -> None:
    env = environment(size=400, start_swing=0.1)
    env.reset()
    below, speed = env.view.swing(env.machine.look())
    away = np.hypot(*below[:, :2].T)
    assert 0.095 < away.max() <= 0.1 + 1e-9
    assert away.mean() == pytest.approx(0.05, abs=0.005)
    assert np.abs(below[:, :2].mean(axis=0)).max() < 0.01, "in every direction"
    np.testing.assert_allclose(np.linalg.norm(below, axis=1), 0.22, atol=1e-6)
    np.testing.assert_array_equal(speed, 0.0)
    again = environment(size=400, start_swing=0.1)
    again.seed(5), env.seed(5)
    np.testing.assert_array_equal(env.reset(), again.reset())
    with pytest.raises(SettingsError, match="start_swing with PyBullet"):
        environment(start_swing=0.1, mover="pybullet", feedback="static")


def test_it_goes_on_exactly_where_its_state_was_taken() -> None:
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1.0, 1.0, (90, 3, 4))
    one, other = environment(size=3, seed=1, task=Task(steps=40, saturation=0.1)), environment(size=3, seed=9)
    one.reset(), other.reset()
    for k in range(30):
        one.step(actions[k])
    state = one.state()
    json.dumps(state["generator"])
    other.task = one.task
    other.restore(state)
    for k in range(30, 90):  # over the end of the episode
        for a, b in zip(one.step(actions[k]), other.step(actions[k]), strict=True):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(one.final, other.final)


def test_candidates_are_the_tools_that_a_step_leads_to() -> None:
    env = environment(size=2, repeat=14)  # longer than the dead time, for which candidates are simulated
    env.reset()
    for _ in range(8):
        env.step(np.zeros((2, 4)))
    actions = np.array([[1.0, -1.0, 0.5, 0.2], [-0.3, 0.3, -1.0, 1.0]])
    expected = env.predicted(env.step(np.zeros((2, 4)))[0], actions)
    env.step(actions)
    np.testing.assert_allclose(env.final[:, env.slices.ee], expected, atol=1e-9)


def test_a_policy_does_the_same_on_a_machine_as_in_its_training() -> None:
    """The deployed policy observes what the runner observes, at every sample, and holds its offsets as in training."""
    env = environment()
    network = random_network(env, 2.0)
    again = policy_from_files(policy_to_files(network, {}), "test")
    assert again.residual == network.residual
    policy = ResidualPolicy(again, PLANT, env.inverse)
    path = Path("move", 100.0, np.repeat(TARGET[None], 501, axis=0))
    run = track(track_environment(PLANT, FORWARD, path, full=True, reach=env.reach), policy, path, BEGIN)
    seen = env.begin(BEGIN, TARGET)
    tools = []
    for _ in range(50):
        seen, _, _ = env.step(network.act(seen))
        tools.append(env.machine.tool[0])
    np.testing.assert_allclose(run.tool[9::10], tools, atol=1e-5)  # inverse kinematics ends within 1e-7 m
    still = track(track_environment(PLANT, FORWARD, path, full=True, reach=env.reach), Still(env), path, BEGIN)
    assert np.abs(run.tool - still.tool).max() > 0.01, "the offsets do something"


class Still:
    """Inverse kinematics alone."""

    def __init__(self, env: ResidualEnvironment) -> None:
        self.inverse = env.inverse

    def act(self, observations: Array) -> Array:
        return self.inverse.solve(observations[:, 7:10], observations[:, :4])[0]


def test_what_does_not_fit_is_refused() -> None:
    env = environment()
    network = random_network(env)
    with pytest.raises(SettingsError, match="sets joints"):
        ResidualPolicy(replace(network, residual=None), PLANT, env.inverse)
    with pytest.raises(SettingsError, match="observes swing"):
        ResidualPolicy(replace(network, inputs=("swing", *network.inputs[1:])), PLANT, env.inverse)
    with pytest.raises(SettingsError, match="gripper_sway"):
        ResidualPolicy(network, crane_plant(), env.inverse)
    with pytest.raises(SettingsError, match="gripper_sway"):
        make_environment(crane_plant(), FORWARD, full=True, residual=Residual())
    with pytest.raises(SettingsError, match="saturation"):
        KinematicEnvironment(PLANT, FORWARD, task=Task(saturation=0.1))


@pytest.mark.parametrize(
    ("setting", "learning", "message"),
    [
        ({"residual": {}}, {}, "full path"),
        ({"residual": {}, "full": True}, {}, "feedback = 'plant'"),
        ({"residual": {"share": 0.0}, "full": True, "feedback": "plant"}, {}, "share"),
        ({"task": {"saturation": 0.1}}, {}, "full path"),
        ({"task": {"saturation": 0.1}, "full": True}, {"hindsight": 0.5}, "hindsight"),
        ({"spread": 1.5}, {}, "spread"),
        ({"start_swing": 0.1}, {}, "full path"),
    ],
)
def test_recipes_that_contradict_themselves(setting: dict[str, Any], learning: dict[str, Any], message: str) -> None:
    from sysid_rl.train.recipe import parse_training

    values = {"name": "r", "plant": "p", "forward": "f", "setting": setting, "learning": learning}
    with pytest.raises(SettingsError, match=message):
        parse_training(values, "recipe")


def test_the_recipe_of_the_tool_is_valid() -> None:
    from sysid_rl.train.recipe import load_training

    recipe = load_training(File(__file__).parents[2] / "rl" / "autolog" / "tool.toml")
    assert recipe.setting.residual == Residual()


def test_training_goes_on_to_the_same_bits(tmp_path: File) -> None:
    pytest.importorskip("torch")
    from sysid_rl.train.checkpoint import TrainingFiles
    from sysid_rl.train.ddpg import Trainer
    from sysid_rl.train.recipe import parse_training
    from sysid_rl.train.training import environments, policy_of

    residual = {"share": 0.05, "full_swing": 0.05}
    setting = {"copies": 4, "full": True, "feedback": "plant", "repeat": 10, "spread": 0.3, "residual": residual}
    values = {
        "name": "r", "plant": "p", "forward": "f", "evaluations": 1,
        "setting": {**setting, "task": {"steps": 12, "saturation": 0.1}},
        "exploration": {"candidates": 2},
        "networks": {"actor": [16], "critic": [16]},
        "learning": {"episodes": 12, "batch": 16, "start": 16, "buffer": 100},
    }  # fmt: skip
    recipe = parse_training(values, "recipe")

    def trainer() -> Trainer:
        return Trainer(*environments(recipe, PLANT, FORWARD, evaluation_copies=2), recipe)

    whole = trainer()
    for _ in whole.train():
        pass
    part = trainer()
    files = TrainingFiles(tmp_path, 0.0)
    for step in part.train():
        if step == 17:
            files.save(part)
            break
    rest = trainer()
    files.load(rest)
    assert rest.step_count == 17
    for _ in rest.train():
        pass
    for a, b in zip(policy_of(whole).mlp.weights, policy_of(rest).mlp.weights, strict=True):
        np.testing.assert_array_equal(a, b)
    assert policy_of(whole).residual == {**residual, "repeat": 10.0}
    assert policy_of(whole).inputs[-1] == "swing.speed.t"
    assert whole.evaluations == rest.evaluations
