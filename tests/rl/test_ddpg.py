"""The algorithm: updates beside autograd, candidates, noise, hindsight; that it learns; that a seed decides everything."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from crane_model import Perfect
from training_case import FORWARD, PLANT, recipe, steps, trainer

from sysid.errors import SettingsError
from sysid.networks.batch import unpack
from sysid_rl.train.agent import Agent
from sysid_rl.train.ddpg import Trainer
from sysid_rl.train.kinematic import KinematicEnvironment
from sysid_rl.train.noise import OrnsteinUhlenbeck
from sysid_rl.train.recipe import TrainingRecipe
from sysid_rl.train.repeated import Repeated
from sysid_rl.train.task import Task

SEEN = ("turn", "now", "agent", "noise", "environment", "episodes", "evaluations", "actions", "batches")


def trained(settings: TrainingRecipe) -> Trainer:
    found = trainer(settings)
    for _ in found.train():
        pass
    return found


def assert_same(one: Any, other: Any) -> None:
    """Equal to the bit, arrays within nested tables too."""
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            assert_same(one[key], other[key])
    elif isinstance(one, list):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    else:
        np.testing.assert_array_equal(one, other)


class Reference:
    """Two updates in the words of a textbook: autograd, torch.optim, torch.nn.functional."""

    def __init__(self, agent: Agent) -> None:
        self.agent, self.space, self.learning = agent, agent.space, agent.learning
        self.layers = {name: self._layers(name) for name in agent.models}
        trained = ("actor", agent.learning.actor_rate), ("critic", agent.learning.critic_rate)
        self.adams = {name: torch.optim.Adam(self.layers[name], lr=rate) for name, rate in trained}

    def _layers(self, name: str) -> list[torch.Tensor]:
        sizes = self.agent.sizes[name.removeprefix("target_")]
        weights, biases = unpack(sizes, self.agent.models[name].parameters.row(0))
        made = [torch.tensor(v, dtype=torch.float64) for pair in zip(weights, biases, strict=True) for v in pair]
        return [layer.requires_grad_(not name.startswith("target")) for layer in made]

    def mlp(self, name: str, x: torch.Tensor) -> torch.Tensor:
        layers = self.layers[name]
        for weight, bias in zip(layers[:-2:2], layers[1:-2:2], strict=True):
            x = torch.relu(x @ weight + bias)
        return x @ layers[-2] + layers[-1]

    def mu(self, name: str, s: torch.Tensor) -> torch.Tensor:
        return torch.tanh(self.mlp(name, (s - t(self.space.centre)) / t(self.space.half)))

    def q(self, name: str, s: torch.Tensor, a: torch.Tensor) -> torch.Tensor:
        """Of an action in shares of half the range."""
        angle = (
            a[:, self.agent.angles] * t(self.space.action_half)[self.agent.angles]
            + t(self.space.action_centre)[self.agent.angles]
        )
        out = self.mlp(name, torch.cat([(s - t(self.space.centre)) / t(self.space.half), a, angle.sin(), angle.cos()], dim=1))
        if out.shape[1] == 1:
            return out[:, 0]
        offset = self.agent.networks.critic_head == "offset"
        begin = s[:, slice(*self.space.ee)] if offset else t(self.space.centre)[slice(*self.space.target)]
        aim = (s[:, slice(*self.space.target)] - begin) / self.space.reach
        return out[:, 3] - self.space.reach * (out[:, :3] - aim).norm(dim=1)

    def update(self, s: torch.Tensor, a: torch.Tensor, r: torch.Tensor, following: torch.Tensor) -> float:
        shares = (a - t(self.space.action_centre)) / t(self.space.action_half)
        with torch.no_grad():
            y = r + self.learning.discount * self.q("target_critic", following, self.mu("target_actor", following))
        loss = (self.q("critic", s, shares) - y).square().mean()
        self._step("critic", loss)
        self._step("actor", -self.q("critic", s, self.mu("actor", s)).mean())
        with torch.no_grad():
            for name in ("actor", "critic"):
                for target, layer in zip(self.layers[f"target_{name}"], self.layers[name], strict=True):
                    target.mul_(1.0 - self.learning.tau).add_(self.learning.tau * layer)
        return float(loss.detach())

    def _step(self, name: str, loss: torch.Tensor) -> None:
        self.adams[name].zero_grad()
        loss.backward()
        self.adams[name].step()


def t(values: Any) -> torch.Tensor:
    return torch.tensor(np.asarray(values), dtype=torch.float64)


@pytest.mark.parametrize("head", ["value", "distance", "offset"])
@pytest.mark.parametrize("features", ["plain", "sincos"])
def test_an_update_is_that_of_the_textbook(head: str, features: str) -> None:
    agent = trainer(recipe(networks={"critic_head": head, "critic_features": features}, learning={"discount": 0.9})).agent
    assert (len(agent.angles) > 0) == (features == "sincos")
    reference, rng, space = Reference(agent), np.random.default_rng(0), agent.space
    for _ in range(2):
        s, following = (torch.from_numpy(rng.uniform(space.low, space.high, (16, 10)).astype(np.float32)) for _ in range(2))
        a = torch.from_numpy(rng.uniform(space.action_low, space.action_high, (16, 4)).astype(np.float32))
        r = torch.from_numpy(rng.normal(size=16).astype(np.float32))
        agent.update(s, a, r, following)
        loss = reference.update(s.double(), a.double(), r.double(), following.double())
        assert float(agent.loss) == pytest.approx(loss, rel=1e-4)
    for name in agent.models:
        weights, biases = unpack(agent.sizes[name.removeprefix("target_")], agent.models[name].parameters.row(0))
        for mine, theirs in zip(
            (v for pair in zip(weights, biases, strict=True) for v in pair), reference.layers[name], strict=True
        ):
            np.testing.assert_allclose(mine, theirs.detach().numpy(), atol=2e-5)


def test_without_discount_there_is_nothing_to_look_up() -> None:
    """γ = 0: targets are not asked, and not moved."""
    found = trainer(recipe(learning={"discount": 0.0}))
    before = found.agent.models["target_critic"].parameters.flat.clone()
    for _ in found.train():
        pass
    assert found.agent.updates > 100
    assert torch.equal(before, found.agent.models["target_critic"].parameters.flat)


def test_the_best_candidate_is_executed() -> None:
    many, one = (
        trainer(recipe(exploration={"candidates": 40, "sigma": 0.5})),
        trainer(recipe(exploration={"candidates": 1, "sigma": 0.5})),
    )
    away = []
    for each in (many, one):
        found = []
        for _ in range(20):
            actions = each.explore()
            assert (actions >= each.environment.action_low).all()
            assert (actions <= each.environment.action_high).all()
            found.append(np.linalg.norm(FORWARD.predict(actions) - each.environment.targets(each.observations), axis=1))
        away.append(np.mean(found))
    assert away[0] < 0.85 * away[1]


def test_candidates_are_judged_by_the_forward_model_and_not_by_the_plant(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that sees everything mirrored chooses otherwise."""
    mine, other = (
        trainer(recipe(exploration={"candidates": 20, "sigma": 0.5})),
        trainer(recipe(exploration={"candidates": 20, "sigma": 0.5})),
    )
    monkeypatch.setattr(other.environment, "predicted", lambda seen, actions: -FORWARD.predict(actions))
    assert not np.array_equal(mine.explore(), other.explore())


def test_noise_spreads_as_its_equation_says() -> None:
    theta, sigma, dt = 0.15, 0.1, 1.0
    noise = OrnsteinUhlenbeck((4000,), theta, sigma, dt, np.random.default_rng(0))
    for _ in range(60):
        before, now = noise.value, noise.step()
    spread = sigma / np.sqrt(2.0 * theta - theta**2 * dt)
    assert now.std() == pytest.approx(spread, rel=0.04)
    assert np.corrcoef(before, now)[0, 1] == pytest.approx(1.0 - theta * dt, abs=0.02)


def test_the_time_step_of_the_noise_counts() -> None:
    """One step at dt = 0.01 is a tenth of one at dt = 1: the σ of the paper means ten times as much without a dt."""
    steps = [OrnsteinUhlenbeck((5,), 0.15, 0.1, dt, np.random.default_rng(0)).step() for dt in (1.0, 0.01)]
    np.testing.assert_allclose(steps[0], 10.0 * steps[1])


def test_noise_starts_anew_with_an_episode() -> None:
    noise = OrnsteinUhlenbeck((2, 3), 0.15, 0.1, 1.0, np.random.default_rng(0))
    noise.step()
    noise.begin(np.array([True, False]))
    assert not noise.value[0].any()
    assert noise.value[1].all()


def test_other_targets_give_the_rewards_that_they_would_have_given() -> None:
    each = trainer(recipe(learning={"hindsight": 0.75}))
    steps(each, 12)
    parts, task = each.slices, Task()
    rows = each.replay.rows[: len(each.replay)].clone()
    observations, _, rewards, following = (rows[:, part] for part in each.replay.columns)
    before = following[:, parts.target].clone()
    each.relabel(observations, rewards, following, torch.zeros(round(0.75 * len(rows)) // 2, 3))
    count = round(0.75 * len(rows))
    moved = (following[:, parts.target] != before).any(dim=1)
    assert moved[:count].all()
    assert not moved[count:].any()
    torch.testing.assert_close(observations[:, parts.target], following[:, parts.target])
    inside = rewards[:, 0].numpy() > -10.0  # clipped candidates are never outside
    expected = task.reward(following[:, parts.ee].numpy(), following[:, parts.target].numpy(), ~inside)
    np.testing.assert_allclose(rewards[:, 0].numpy(), expected, atol=2e-6)


def test_the_end_of_an_episode_is_no_end_of_the_world() -> None:
    """What is kept is where the step led, not where the next episode begins."""
    each = trainer(recipe(learning={"start": 300}))
    steps(each, 15)
    assert len(each.episodes) == 1
    ee = each.replay.rows[56:60, each.replay.columns[3]][:, each.slices.ee]
    actions = each.replay.rows[56:60, each.replay.columns[1]]
    np.testing.assert_allclose(ee, FORWARD.predict(actions.double().numpy()), atol=1e-5)


@pytest.mark.parametrize("full", [False, True])
def test_targets_of_a_curriculum_move_away_until_they_are_anywhere(full: bool) -> None:
    """From where an episode begins, and from where the copy is when an episode shows another target."""
    setting = {"copies": 64, "full": full, "curriculum": 0.5, "task": {"steps": 4, "targets": 2}}
    each = trainer(recipe(setting=setting, learning={"episodes": 64 * 20, "start": 100_000, "buffer": 200_000}))
    asked: list[float] = []
    parts = each.slices

    def mean_way() -> float:
        return float(np.linalg.norm(each.observations[:, parts.target] - each.observations[:, parts.ee], axis=1).mean())

    asked.append(mean_way())
    for _ in each.train():
        asked.append(mean_way() if each.step_count % 2 == 0 else np.nan)
    way = np.array(asked)
    anywhere = np.nanmean(way[48:])
    assert way[0] < 0.25 * anywhere
    assert np.nanmean(way[1:10]) < np.nanmean(way[18:28]) < 0.9 * anywhere
    assert each.environment.spread == 1.0


def test_it_learns() -> None:
    networks = {"actor": [32, 32], "critic": [32, 32], "critic_head": "distance", "critic_features": "sincos"}
    learning = {"episodes": 640, "batch": 128, "buffer": 20000, "discount": 0.0, "updates": 4, "schedule": "cosine",
                "actor_rate": 3e-3, "critic_rate": 3e-3, "hindsight": 0.75}  # fmt: skip
    found = trained(recipe(setting={"copies": 32, "task": {"steps": 15}}, networks=networks, learning=learning))
    first, last = found.evaluations[0], found.evaluations[-1]
    for axis in "xyz":
        assert last[f"hold_rmse_{axis}"] < 0.08
    assert last["hold_max"] < 0.5 * first["hold_max"]
    assert found.episodes[-1]["return"] > found.episodes[0]["return"]


@pytest.mark.slow
def test_a_seed_decides_everything_and_another_one_too() -> None:
    one, same, other = (trained(recipe(seed=seed)).state() for seed in (3, 3, 4))
    for key in SEEN:
        assert_same(one[key], same[key])
    assert not np.array_equal(one["agent"]["actor"], other["agent"]["actor"])


def test_a_network_that_is_no_number_stops_it() -> None:
    each = trainer(recipe())
    run = each.train()
    while each.agent.updates < 50:
        next(run)
    each.agent.models["critic"].parameters.flat[3] = float("nan")
    with pytest.raises(SettingsError, match=r"training small, seed 0: a network holds NaN or infinity after .*Lower"):
        list(run)


def test_angles_have_to_be_known() -> None:
    settings = recipe(networks={"critic_features": "sincos"})
    environments = [KinematicEnvironment(PLANT, Perfect(PLANT), size=size) for size in (4, 16)]
    with pytest.raises(SettingsError, match=r"networks.critic_features: 'sincos'.*does not say which joints are angles"):
        Trainer(environments[0], environments[1], settings)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_gpu_that_is_not_there_is_named() -> None:
    with pytest.raises(SettingsError, match=r"recipe small: device = 'cuda', which torch does not find; expected a GPU"):
        trainer(recipe(device="cuda"))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_gpu_runs_the_same_code() -> None:
    settings = recipe(device="cuda")
    assert_same(trained(settings).state()["agent"], trained(settings).state()["agent"])


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("schedule", ["constant", "cosine"])
def test_a_graph_of_an_update_does_what_its_kernels_do(schedule: str, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = recipe(device="cuda", learning={"hindsight": 0.75, "discount": 0.9, "schedule": schedule})
    by_graph = trained(settings).state()["agent"]
    monkeypatch.setattr(Repeated, "_capture", lambda self: None)
    assert_same(trained(settings).state()["agent"], by_graph)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_training_on_a_gpu_continues_to_the_same_bits() -> None:
    settings = recipe(device="cuda", learning={"hindsight": 0.75, "discount": 0.9})
    whole, first, second = (trainer(settings) for _ in range(3))
    steps(whole, 60)
    steps(first, 30)
    second.restore(first.state())
    second.replay.rows.copy_(first.replay.rows)
    second.replay.count = first.replay.count
    steps(second, 30)
    assert_same(second.state()["agent"], whole.state()["agent"])


def test_a_judge_whose_episodes_are_too_short_is_refused() -> None:
    """It would evaluate the next episode's targets."""
    each = trainer(recipe())
    with pytest.raises(SettingsError, match=r"evaluation environment: episodes of 15 steps; expected more than 600"):
        Trainer(each.environment, each.environment, recipe())
