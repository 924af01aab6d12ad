"""DDPG with action feedback: Algorithm 1 of the paper, for any number of machine copies side by side.

In each step: draw candidates ``a_p = μ(s) + N_p``; predict the end effector of each with the forward model; execute the one
nearest to the target; store (s, a, r, s'); update critic, actor and targets from random batches (:mod:`sysid_rl.train.agent`).

Between two steps, :meth:`Trainer.state` is the complete state of a training: restored, it continues to the same bits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError
from sysid_rl.train.agent import Agent, Space
from sysid_rl.train.environment import Environment
from sysid_rl.train.noise import OrnsteinUhlenbeck
from sysid_rl.train.recipe import TrainingRecipe
from sysid_rl.train.repeated import Repeated
from sysid_rl.train.replay import Replay
from sysid_rl.train.task import ObservationSlices

if TYPE_CHECKING:
    import torch

Array = npt.NDArray[np.float64]

#: Updates between two checks that the loss is finite.
CHECK_INTERVAL = 200
#: Steps that the actor alone has to reach a target, on the full path.
SETTLE_STEPS = 300
#: Distance of the first targets of a curriculum, as a share of the distance to targets anywhere within reach.
CURRICULUM_START = 0.1

#: ``callback(kind, step, figures)`` after an ``episode`` or ``evaluation``.
TrainingCallback = Callable[[str, int, Mapping[str, float]], None]


class Trainer:
    """The training of one policy.

    Args:
        environment: of ``recipe.setting.copies`` copies; it is reset.
        evaluation: a second environment of the same machine for the actor alone (:func:`sysid_rl.train.training.environments`).

    Raises:
        SettingsError: a GPU that torch does not find, or evaluation episodes that are too short.
    """

    def __init__(self, environment: Environment, evaluation: Environment, recipe: TrainingRecipe) -> None:
        import torch

        learning, exploration = recipe.learning, recipe.exploration
        if recipe.device.startswith("cuda") and not torch.cuda.is_available():
            found = f"device = {recipe.device!r}, which torch does not find"
            raise SettingsError(f"recipe {recipe.name}", found, "a GPU", "Use device = 'cpu'.")
        if evaluation.steps <= 2 * SETTLE_STEPS:
            raise SettingsError(
                "evaluation environment", f"episodes of {evaluation.steps} steps", f"more than {2 * SETTLE_STEPS}"
            )
        self.environment, self.evaluation, self.recipe = environment, evaluation, recipe
        self.slices = ObservationSlices.of(environment.actions)
        # Independent generators for each purpose.
        seeds = np.random.SeedSequence(recipe.seed).spawn(4)
        weights, noise, self._actions, self._batches = (np.random.default_rng(seed) for seed in seeds)
        self.agent = Agent(_space(environment, self.slices, recipe), recipe.networks, learning, weights, recipe.device)
        self.noise = OrnsteinUhlenbeck(
            (environment.size, exploration.candidates, environment.actions),
            exploration.theta, exploration.sigma, exploration.time_step, noise,
        )  # fmt: skip
        self.replay = Replay(learning.buffer, environment.observations, environment.actions, recipe.device)
        #: Of an update, on the device: rows of the buffer, their content, moves of replaced targets, share of the rates.
        self._chosen = torch.zeros(learning.batch, dtype=torch.long, device=recipe.device)
        self._batch = torch.empty((learning.batch, self.replay.width), device=recipe.device)
        self._moves = torch.zeros((round(learning.hindsight * learning.batch) // 2, 3), device=recipe.device)
        self._rate_share = torch.ones((), device=recipe.device)
        self._learn = self._repeated_update()
        #: Steps made; all copies together make one.
        self.step_count = 0
        #: One entry for each episode and evaluation: ``step`` (steps times copies) and figures.
        self.episodes: list[dict[str, float]] = []
        self.evaluations: list[dict[str, float]] = []
        self._returns, self._distance = np.zeros(environment.size), np.zeros(environment.size)
        evaluation.spread = recipe.setting.spread
        self._begin = evaluation.reset()
        self._task = evaluation.state()
        environment.spread = self._target_spread()
        self.observations = environment.reset()

    @property
    def is_done(self) -> bool:
        return self.step_count >= self.recipe.total_steps

    def train(self, callback: TrainingCallback = lambda kind, step, figures: None) -> Iterator[int]:
        """Train to the end; yields the step count after every step, where the training may be saved or left."""
        with _threads(self.recipe.threads):
            while not self.is_done:
                self._step(callback)
                yield self.step_count

    def explore(self) -> Array:
        """The action to execute in each copy, (n, A) [SI]: the best of its candidates by the forward model."""
        environment, candidates = self.environment, self.recipe.exploration.candidates
        size, acts = environment.size, environment.actions
        noise = self.noise.step(self._sigma_share())
        if self.step_count < self.recipe.exploration.random_steps:
            shares = self._actions.uniform(-1.0, 1.0, (size, candidates, acts))
        else:
            shares = np.clip(self.agent.act(self.observations)[:, None] + noise, -1.0, 1.0)
        if not np.isfinite(shares).all():
            self.check()
        actions = self._setpoints(shares)
        if candidates == 1:
            return np.asarray(actions[:, 0])
        seen = np.repeat(self.observations, candidates, axis=0)
        ends = environment.predicted(seen, actions.reshape(-1, acts))
        distances = np.linalg.norm(ends - environment.targets(seen), axis=1).reshape(size, candidates)
        return np.asarray(actions[np.arange(size), distances.argmin(axis=1)])

    def evaluate(self) -> dict[str, float]:
        """Errors [m] of the actor alone: from random poses to random targets (``reach``), then staying there (``hold``)."""
        evaluation = self.evaluation
        evaluation.restore(self._task)
        observations, wanted = self._begin, evaluation.targets(self._begin)
        found: dict[str, float] = {}
        setting = self.recipe.setting
        settle = SETTLE_STEPS // (setting.repeat if setting.residual is not None else 1) if setting.full else 1
        for phase in ("reach", "hold"):
            for _ in range(settle):
                observations, _, _ = evaluation.step(self.greedy(observations))
            error = evaluation.final[:, self.slices.ee] - wanted
            for axis, name in enumerate("xyz"):
                found[f"{phase}_rmse_{name}"] = float(np.sqrt(np.mean(error[:, axis] ** 2)))
            found[f"{phase}_max"] = float(np.linalg.norm(error, axis=1).max())
        return found

    def greedy(self, observations: Array) -> Array:
        """The actor's actions without noise, (n, A) [SI], for observations (n, O)."""
        return self._setpoints(self.agent.act(observations))

    def state(self) -> dict[str, Any]:
        """Everything that the future depends on except the replay buffer, which has its own files: nested arrays and JSON."""
        return {
            "turn": self.step_count,
            "rows": self.replay.count,
            "now": self.observations.copy(),
            "returns": self._returns.copy(),
            "away": self._distance.copy(),
            "episodes": self.episodes,
            "evaluations": self.evaluations,
            "agent": self.agent.state(),
            "noise": self.noise.state(),
            "environment": self.environment.state(),
            "actions": self._actions.bit_generator.state,
            "batches": self._batches.bit_generator.state,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue exactly where :meth:`state` was taken; the replay buffer is loaded separately."""
        self.step_count = int(state["turn"])
        self.observations, self._returns, self._distance = (np.array(state[key]) for key in ("now", "returns", "away"))
        self.episodes, self.evaluations = list(state["episodes"]), list(state["evaluations"])
        self.agent.restore(state["agent"])
        self._learn = self._repeated_update()
        self.noise.restore(state["noise"])
        self.environment.restore(state["environment"])
        self._actions.bit_generator.state = state["actions"]
        self._batches.bit_generator.state = state["batches"]

    def check(self) -> None:
        """Check the networks.

        Raises:
            SettingsError: a network holds NaN or infinity.
        """
        if not (math.isfinite(float(self.agent.loss)) and self.agent.is_finite()):
            raise SettingsError(
                f"training {self.recipe.name}, seed {self.recipe.seed}",
                f"a network holds NaN or infinity after {self.agent.updates} updates",
                "finite weights",
                "Lower learning.actor_rate and critic_rate; the last checkpoint is from before that.",
            )

    def _step(self, callback: TrainingCallback) -> None:
        """One step of all copies, and its updates."""
        learning, environment = self.recipe.learning, self.environment
        actions = self.explore()
        environment.spread = self._target_spread()
        following, rewards, truncated = environment.step(actions)
        final = environment.final
        self.replay.add(self.observations, actions, rewards, final)
        self.observations = following
        self.step_count += 1
        if self.replay.count >= learning.start and self.step_count % learning.every == 0:
            for _ in range(learning.updates):
                self._update()
        self._record(rewards, final, truncated, callback)

    def _setpoints(self, shares: Array) -> Array:
        """Shares of half the range in SI; clipped, because a rounding error beyond a limit would get the whole penalty."""
        space = self.agent.space
        return np.clip(space.action_centre + shares * space.action_half, space.action_low, space.action_high)

    def _update(self) -> None:
        """Draw a batch on the CPU, learn from it on the device."""
        import torch

        self._chosen.copy_(self.replay.draw(self.recipe.learning.batch, self._batches))
        if len(self._moves):
            drawn = self._batches.standard_normal(tuple(self._moves.shape), dtype=np.float32)
            self._moves.copy_(torch.from_numpy(drawn * np.float32(self.recipe.learning.hindsight_near)))
        self._rate_share.fill_(self._rate())
        self._learn()
        self.agent.updates += 1
        if self.agent.updates % CHECK_INTERVAL == 0:
            self.check()

    def _repeated_update(self) -> Repeated:
        """One update from the chosen rows; to be renewed when the agent's tensors are replaced."""

        def update() -> None:
            rows = self.replay.take(self._chosen, self._batch)
            observations, actions, rewards, following = (rows[:, part] for part in self.replay.columns)
            if self.recipe.learning.hindsight > 0.0:
                self.relabel(observations, rewards, following, self._moves)
            rate = self._rate_share if self.agent.device.type == "cuda" else self._rate()
            self.agent.update(observations, actions, rewards[:, 0], following, rate)

        return Repeated(update, self.agent.device)

    def relabel(self, observations: torch.Tensor, rewards: torch.Tensor, following: torch.Tensor, moves: torch.Tensor) -> None:
        """Replace the targets of a share of a batch, and recompute its rewards (hindsight).

        Args:
            moves: of the first new targets from the reached end effectors, (n, 3) [m]; the others are of other transitions.
        """
        import torch

        ee, target = self.slices.ee, self.slices.target
        count, near = round(self.recipe.learning.hindsight * len(rewards)), len(moves)
        reached = following[:count, ee]
        aims = torch.cat([reached[:near] + moves, reached[near:].roll(1, 0)])
        before, after = ((reached - aim).norm(dim=1, keepdim=True) for aim in (following[:count, target], aims))
        rewards[:count] += before - after
        observations[:count, target] = aims
        following[:count, target] = aims

    def _record(self, rewards: Array, final: Array, truncated: npt.NDArray[np.bool_], callback: TrainingCallback) -> None:
        size = self.environment.size
        self._returns += rewards
        self._distance += np.linalg.norm(final[:, self.slices.ee] - final[:, self.slices.target], axis=1)
        if truncated.any():
            self.noise.begin(truncated)
            steps = self.environment.steps
            figures = {
                "return": float(self._returns[truncated].mean()),
                "distance": float(self._distance[truncated].mean()) / steps,
            }
            self.episodes.append({"step": self.step_count * size, **figures})
            self._returns[truncated] = self._distance[truncated] = 0.0
            callback("episode", self.step_count * size, figures)
        evaluations, total = self.recipe.evaluations, self.recipe.total_steps
        if self.is_done or self.step_count * evaluations % total < evaluations:
            self.check()
            figures = {**self.evaluate(), "loss": float(self.agent.loss), "value": float(self.agent.value)}
            self.evaluations.append({"step": self.step_count * size, "updates": self.agent.updates, **figures})
            callback("evaluation", self.step_count * size, figures)

    def _sigma_share(self) -> float:
        exploration = self.recipe.exploration
        if exploration.sigma_end is None or exploration.sigma == 0.0:
            return 1.0
        return float((exploration.sigma_end / exploration.sigma) ** (self.step_count / self.recipe.total_steps))

    def _target_spread(self) -> float:
        """Distance of new targets, as a share of that of targets anywhere within reach."""
        part, whole = self.recipe.setting.curriculum * self.recipe.total_steps, self.recipe.setting.spread
        grown = CURRICULUM_START + (1.0 - CURRICULUM_START) * self.step_count / part if part else 1.0
        return whole * min(1.0, grown)

    def _rate(self) -> float:
        if self.recipe.learning.schedule == "constant":
            return 1.0
        return 0.5 * (1.0 + math.cos(math.pi * self.step_count / self.recipe.total_steps))


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
    """Torch's number of threads inside the context; the bits of its sums depend on it."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
