"""DDPG with action feedback: Algorithm 1 of the paper, for any number of machine copies side by side.

For each episode and step: draw candidates ``a_p = μ(s) + N_p``; let the forward model say where each would lead; execute the
one that comes nearest to the target; keep (s, a, r, s'); update critic, actor and targets from random batches.

What the recipe can change: :mod:`sysid.rl.recipe`. What an update is: :mod:`sysid.rl.agent`. Between two steps a trainer is
exactly what :meth:`Trainer.state` says: saved and restored, it goes on to the bits it would have reached anyway.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError
from sysid.rl.agent import Agent, Space
from sysid.rl.environment import Environment
from sysid.rl.noise import OrnsteinUhlenbeck
from sysid.rl.recipe import TrainingRecipe
from sysid.rl.replay import Replay
from sysid.rl.task import ObservationSlices

Array = npt.NDArray[np.float64]

#: Updates between two looks at whether the loss is still a number.
LOOK = 200
#: Steps until the actor alone has to be there, on the full path.
SETTLE = 300

#: How far away the first targets of a curriculum are, as a share of the way to anywhere within reach.
NEAREST = 0.1

#: ``told(kind, step, figures)``: an ``episode`` or ``evaluation`` that is over.
Callback = Callable[[str, int, Mapping[str, float]], None]


@dataclass(frozen=True)
class Generators:
    """Random numbers, one generator a purpose, so that asking one for more leaves the others as they are."""

    weights: np.random.Generator
    noise: np.random.Generator
    actions: np.random.Generator
    batches: np.random.Generator

    @staticmethod
    def of(seed: int) -> Generators:
        return Generators(*(np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(4)))


class Trainer:
    """One policy under way.

    Args:
        environment: ``recipe.setting.copies`` copies; it is reset.
        evaluate: another one, of the same machine (:func:`sysid.rl.training.environments`), for the actor alone.
        recipe: how.
    """

    def __init__(self, environment: Environment, evaluation: Environment, recipe: TrainingRecipe) -> None:
        import torch

        learning, exploration = recipe.learning, recipe.exploration
        if recipe.device.startswith("cuda") and not torch.cuda.is_available():
            found = f"device = {recipe.device!r}, which torch does not find"
            raise SettingsError(f"recipe {recipe.name}", found, "a GPU", "Use device = 'cpu'.")
        if evaluation.steps <= 2 * SETTLE:
            raise SettingsError("evaluation environment", f"episodes of {evaluation.steps} steps", f"more than {2 * SETTLE}")
        self.environment, self.evaluation, self.recipe = environment, evaluation, recipe
        self.parts = ObservationSlices.of(environment.actions)
        rngs = Generators.of(recipe.seed)
        self._actions, self._batches = rngs.actions, rngs.batches
        self.agent = Agent(_space(environment, self.parts, recipe), recipe.networks, learning, rngs.weights, recipe.device)
        self.noise = OrnsteinUhlenbeck(
            (environment.size, exploration.candidates, environment.actions),
            exploration.theta, exploration.sigma, exploration.time_step, rngs.noise,
        )  # fmt: skip
        self.replay = Replay(learning.buffer, environment.observations, environment.actions, recipe.device)
        self._batch = torch.empty((learning.batch, self.replay.width), device=recipe.device)
        #: Steps made, of all copies together.
        self.turn = 0
        #: One entry an episode and an evaluation: ``(step of a copy times copies, figures)``.
        self.episodes: list[dict[str, float]] = []
        self.evaluations: list[dict[str, float]] = []
        self._returns, self._away = np.zeros(environment.size), np.zeros(environment.size)
        self._begin = evaluation.reset()
        self._task = evaluation.state()
        environment.spread = self._spread()
        self._now = environment.reset()

    @property
    def is_done(self) -> bool:
        return self.turn >= self.recipe.turns

    def train(self, told: Callback | None = None) -> Iterator[int]:
        """Train to the end; yields after every step, where it may be saved or left."""
        with _threads(self.recipe.threads):
            while not self.is_done:
                self._turn(told or _nobody)
                yield self.turn

    def explored(self) -> Array:
        """The action to execute in each copy, (n, A) [SI]: the best of its candidates."""
        environment, candidates = self.environment, self.recipe.exploration.candidates
        size, acts = environment.size, environment.actions
        noise = self.noise.step(self._sigma_share())
        if self.turn < self.recipe.exploration.random_steps:
            shares = self._actions.uniform(-1.0, 1.0, (size, candidates, acts))
        else:
            shares = np.clip(self.agent.act(self._now)[:, None] + noise, -1.0, 1.0)
        if not np.isfinite(shares).all():
            self.check()
        actions = self._setpoints(shares)
        if candidates == 1:
            return np.asarray(actions[:, 0])
        seen = np.repeat(self._now, candidates, axis=0)
        ends = environment.predicted(seen, actions.reshape(-1, acts))
        away = np.linalg.norm(ends - environment.targets(seen), axis=1).reshape(size, candidates)
        return np.asarray(actions[np.arange(size), away.argmin(axis=1)])

    def evaluate(self) -> dict[str, float]:
        """The actor alone: from random poses to random targets (``reach``), and then staying there (``hold``) [m]."""
        evaluation = self.evaluation
        evaluation.restore(self._task)
        observations, wanted = self._begin, evaluation.targets(self._begin)
        found: dict[str, float] = {}
        settle = SETTLE if self.recipe.setting.full else 1
        for phase in ("reach", "hold"):
            for _ in range(settle):
                observations, _, _ = evaluation.step(self.greedy(observations))
            error = evaluation.final[:, self.parts.ee] - wanted
            for axis, name in enumerate("xyz"):
                found[f"{phase}_rmse_{name}"] = float(np.sqrt(np.mean(error[:, axis] ** 2)))
            found[f"{phase}_max"] = float(np.linalg.norm(error, axis=1).max())
        return found

    def greedy(self, observations: Array) -> Array:
        """What the actor does without noise, (n, A) [SI]."""
        return self._setpoints(self.agent.act(observations))

    def state(self) -> dict[str, Any]:
        """Everything that the future depends on but the replay buffer, which has files of its own: nested, arrays and JSON."""
        return {
            "turn": self.turn,
            "rows": self.replay.count,
            "now": self._now.copy(),
            "returns": self._returns.copy(),
            "away": self._away.copy(),
            "episodes": self.episodes,
            "evaluations": self.evaluations,
            "agent": self.agent.state(),
            "noise": self.noise.state(),
            "environment": self.environment.state(),
            "actions": self._actions.bit_generator.state,
            "batches": self._batches.bit_generator.state,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on exactly where :meth:`state` was taken; the replay buffer is loaded apart."""
        self.turn = int(state["turn"])
        self._now, self._returns, self._away = (np.array(state[key]) for key in ("now", "returns", "away"))
        self.episodes, self.evaluations = list(state["episodes"]), list(state["evaluations"])
        self.agent.restore(state["agent"])
        self.noise.restore(state["noise"])
        self.environment.restore(state["environment"])
        self._actions.bit_generator.state = state["actions"]
        self._batches.bit_generator.state = state["batches"]

    def check(self) -> None:
        """Raises SettingsError where a network holds what is no number."""
        if not (math.isfinite(float(self.agent.loss)) and self.agent.is_finite()):
            raise SettingsError(
                f"training {self.recipe.name}, seed {self.recipe.seed}",
                f"a network holds NaN or infinity after {self.agent.updates} updates",
                "finite weights",
                "Lower learning.actor_rate and critic_rate; the last checkpoint is from before that.",
            )

    def _turn(self, told: Callback) -> None:
        """One step of all copies, and the updates that belong to it."""
        learning, environment = self.recipe.learning, self.environment
        actions = self.explored()
        environment.spread = self._spread()
        following, rewards, truncated = environment.step(actions)
        final = environment.final
        self.replay.add(self._now, actions, rewards, final)
        self._now = following
        self.turn += 1
        if self.replay.count >= learning.start and self.turn % learning.every == 0:
            for _ in range(learning.updates):
                self._update()
        self._keep_books(rewards, final, truncated, told)

    def _setpoints(self, shares: Array) -> Array:
        """Shares of half the range in SI; clipped, since a rounding beyond a limit would be punished like a mile."""
        space = self.agent.space
        return np.clip(space.action_centre + shares * space.action_half, space.action_low, space.action_high)

    def _update(self) -> None:
        rows, parts = self.replay.sample(self.recipe.learning.batch, self._batches, self._batch), self.replay.parts
        observations, actions, rewards, following = (rows[:, part] for part in parts)
        if self.recipe.learning.hindsight > 0.0:
            self._aim_elsewhere(observations, rewards, following)
        self.agent.update(observations, actions, rewards[:, 0], following, self._rate())
        if self.agent.updates % LOOK == 0:
            self.check()

    def _aim_elsewhere(self, observations: Any, rewards: Any, following: Any) -> None:
        """Put other targets into a share of a batch, and the rewards that they would have given."""
        import torch

        learning, ee, target = self.recipe.learning, self.parts.ee, self.parts.target
        count = round(learning.hindsight * len(rewards))
        near = count // 2
        reached = following[:count, ee]
        moved = self._batches.standard_normal((near, 3), dtype=np.float32) * np.float32(learning.hindsight_near)
        aims = torch.cat([reached[:near] + torch.from_numpy(moved).to(reached.device), reached[near:].roll(1, 0)])
        before, after = ((reached - aim).norm(dim=1, keepdim=True) for aim in (following[:count, target], aims))
        rewards[:count] += before - after
        observations[:count, target] = aims
        following[:count, target] = aims

    def _keep_books(self, rewards: Array, final: Array, truncated: npt.NDArray[np.bool_], told: Callback) -> None:
        size = self.environment.size
        self._returns += rewards
        self._away += np.linalg.norm(final[:, self.parts.ee] - final[:, self.parts.target], axis=1)
        if truncated.any():
            self.noise.begin(truncated)
            steps = self.environment.steps
            figures = {
                "return": float(self._returns[truncated].mean()),
                "distance": float(self._away[truncated].mean()) / steps,
            }
            self.episodes.append({"step": self.turn * size, **figures})
            self._returns[truncated] = self._away[truncated] = 0.0
            told("episode", self.turn * size, figures)
        if self.turn == self.recipe.turns or self.turn * self.recipe.evaluations % self.recipe.turns < self.recipe.evaluations:
            self.check()
            figures = {**self.evaluate(), "loss": float(self.agent.loss), "value": float(self.agent.value)}
            self.evaluations.append({"step": self.turn * size, "updates": self.agent.updates, **figures})
            told("evaluation", self.turn * size, figures)

    def _sigma_share(self) -> float:
        exploration = self.recipe.exploration
        if exploration.sigma_end is None or exploration.sigma == 0.0:
            return 1.0
        return float((exploration.sigma_end / exploration.sigma) ** (self.turn / self.recipe.turns))

    def _spread(self) -> float:
        """How far away targets are by now."""
        part = self.recipe.setting.curriculum * self.recipe.turns
        return min(1.0, NEAREST + (1.0 - NEAREST) * self.turn / part) if part else 1.0

    def _rate(self) -> float:
        if self.recipe.learning.schedule == "constant":
            return 1.0
        return 0.5 * (1.0 + math.cos(math.pi * self.turn / self.recipe.turns))


def _space(environment: Environment, parts: ObservationSlices, recipe: TrainingRecipe) -> Space:
    revolute = getattr(environment.forward, "revolute", None)
    if revolute is None and recipe.networks.critic_features == "sincos":
        found = "'sincos', and the forward model does not say which joints are angles"
        raise SettingsError(f"recipe {recipe.name}: networks.critic_features", found, "'plain'")
    return Space(
        low=environment.observation_low,
        high=environment.observation_high,
        action_low=environment.action_low,
        action_high=environment.action_high,
        angles=tuple(bool(angle) for angle in revolute or (False,) * environment.actions),
        ee=(parts.ee.start, parts.ee.stop),
        target=(parts.target.start, parts.target.stop),
    )


@contextmanager
def _threads(count: int) -> Iterator[None]:
    """Torch's own threads, which the bits of its sums depend on."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _nobody(kind: str, step: int, figures: Mapping[str, float]) -> None:
    """Who does not listen."""
