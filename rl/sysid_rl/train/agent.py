"""Actor, critic and their target networks: inference, and one update of all of them with explicit gradients.

Actor ``μ(s) = tanh(perceptron)`` in shares of half the range; critic ``Q(s, a)``; from a batch of N transitions (s, a, r, s')::

    y = r + γ·Q'(s', μ'(s'))                     critic: minimise L = 1/N·Σ (Q(s, a) − y)²
    ∇J = 1/N·Σ ∇_a Q(s, a)|a=μ(s) · ∇_θ μ(s)     actor: maximise J = 1/N·Σ Q(s, μ(s))
    θ' ← τ·θ + (1 − τ)·θ'                        of actor and critic

Source: Lillicrap et al. 2015; Algorithm 1 of the paper. The perceptrons are those of :mod:`sysid.networks.batch`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sysid.networks.batch import BatchedAdam, BatchedMlp, Floats, Stack, pack, padded, unpack
from sysid_rl.train.recipe import Learning, Networks
from sysid_rl.train.repeated import Repeated

if TYPE_CHECKING:
    import torch

Array = npt.NDArray[np.float64]

#: Names of the four networks, and of the two that are trained.
NETWORKS = ("actor", "critic", "target_actor", "target_critic")
TRAINED = ("actor", "critic")
#: The last layer of the actor starts within this, so that tanh is not saturated (Lillicrap et al. 2015).
ACTOR_START = 3e-3


@dataclass(frozen=True)
class Space:
    """Ranges of observations and actions, for the normalisation inside the networks.

    Args:
        low, high: of observations, (O,) [SI].
        action_low, action_high: of actions, (A,) [SI].
        angles: which actions are angles, (A,).
        ee, target: columns of end effector and target in an observation, (first, last + 1).
    """

    low: Array
    high: Array
    action_low: Array
    action_high: Array
    angles: tuple[bool, ...]
    ee: tuple[int, int]
    target: tuple[int, int]

    @property
    def centre(self) -> Array:
        return np.asarray(0.5 * (self.low + self.high))

    @property
    def half(self) -> Array:
        return np.asarray(0.5 * (self.high - self.low))

    @property
    def action_centre(self) -> Array:
        return np.asarray(0.5 * (self.action_low + self.action_high))

    @property
    def action_half(self) -> Array:
        return np.asarray(0.5 * (self.action_high - self.action_low))

    @property
    def reach(self) -> float:
        """Largest half range of the target [m]: the unit of the critic's points."""
        return float(self.half[slice(*self.target)].max())


class Agent:
    """The four networks of one policy and their optimisers.

    Args:
        networks, learning: of the recipe.
        rng: of the initial weights.
        device: of torch.
    """

    def __init__(
        self, space: Space, networks: Networks, learning: Learning, rng: np.random.Generator, device: torch.device | str
    ) -> None:
        import torch

        self.space, self.networks, self.learning, self.device = space, networks, learning, torch.device(device)
        wide, acts = len(space.low), len(space.action_low)
        sincos = networks.critic_features == "sincos"
        angles = [number for number, angle in enumerate(space.angles) if angle] if sincos else []
        self.angles = torch.tensor(angles, dtype=torch.long, device=self.device)
        self.sizes = {
            "actor": (wide, *networks.actor, acts),
            "critic": (wide + acts + 2 * len(self.angles), *networks.critic, 1 if networks.critic_head == "value" else 4),
        }
        rows = {name: _first_weights(self.sizes[name], rng, ACTOR_START if name == "actor" else None) for name in TRAINED}
        self.models = {
            name: BatchedMlp.of_rows(padded(self.sizes[base]), [rows[base]], self.device)
            for name in NETWORKS
            for base in (name.removeprefix("target_"),)
        }
        self.adams = {name: self._adam(name, 0) for name in TRAINED}
        #: Updates made; whoever calls :meth:`update` counts them.
        self.updates = 0

        def constant(values: npt.ArrayLike) -> torch.Tensor:
            return torch.from_numpy(np.asarray(values, dtype=np.float32)).to(self.device)

        self._centre, self._per_half = constant(space.centre), constant(1.0 / space.half)
        self._action_centre, self._action_per_half = constant(space.action_centre), constant(1.0 / space.action_half)
        self._angle_centre, self._angle_half = (constant(values[angles]) for values in (space.action_centre, space.action_half))
        self._target_centre = constant(space.centre[slice(*space.target)])
        self._buffers: dict[tuple[str, int], torch.Tensor] = {}
        #: By number of observations: inputs, outputs, and the actor from the ones to the others.
        self._acts: dict[int, tuple[torch.Tensor, torch.Tensor, Repeated]] = {}
        #: Of the last update: critic loss L, and mean Q of the actor's actions.
        self.loss = self.value = torch.zeros((), device=self.device)

    def act(self, observations: Array) -> Array:
        """The actor's actions (n, A) in shares of half the range, within ±1, for observations (n, O)."""
        import torch

        count = len(observations)
        if count not in self._acts:
            seen = torch.zeros((count, len(self.space.low)), device=self.device)
            found = torch.zeros((count, len(self.space.action_low)), device=self.device)
            self._acts[count] = (seen, found, Repeated(lambda: self._act(seen, found), self.device))
        seen, found, act = self._acts[count]
        seen.copy_(torch.from_numpy(observations.astype(np.float32)))
        act()
        return found.cpu().numpy().astype(np.float64)

    def _act(self, seen: torch.Tensor, found: torch.Tensor) -> None:
        import torch

        with torch.no_grad():
            s = self._normalised(seen)
            found.copy_(torch.tanh(self.models["actor"].predict(self._padded("act", s))[0, :, : len(self.space.action_low)]))

    def update(
        self, s: torch.Tensor, a: torch.Tensor, r: torch.Tensor, following: torch.Tensor, rate: float | torch.Tensor = 1.0
    ) -> None:
        """One update from a batch: observations (N, O), actions (N, A) [SI], rewards (N,), next observations (N, O).

        It does not wait for the device and changes nothing but tensors, so that it can be part of a CUDA graph.

        Args:
            rate: share of both learning rates.
        """
        import torch

        learning, models = self.learning, self.models
        with torch.no_grad():
            target = self._critic_target(s)
            s, a = self._normalised(s), (a - self._action_centre) * self._action_per_half
            # Target values of the critic.
            if learning.discount > 0.0:
                s_next, target_next = self._normalised(following), self._critic_target(following)
                mu = torch.tanh(models["target_actor"].forward(self._padded("actor", s_next))[0, :, : a.shape[1]])
                value, _ = self._q("target_critic", s_next, mu, target_next)
                r = r + learning.discount * value
            # Critic.
            q, way = self._q("critic", s, a, target)
            error = q - r
            self.loss = error.square().mean()
            models["critic"].backward(self._buffer("critic", s), self._output_gradient(way, error * (2.0 / len(s))))
            self.adams["critic"].step(models["critic"], [rate * learning.critic_rate])
            # Actor: ascent along the critic's gradient.
            x = self._padded("actor", s)
            mu = torch.tanh(models["actor"].forward(x)[0, :, : a.shape[1]])
            q, way = self._q("critic", s, mu, target)
            self.value = q.mean()
            slope = models["critic"].backward(
                self._buffer("critic", s), self._output_gradient(way, torch.full_like(q, -1.0 / len(s))), of="inputs"
            )
            delta = torch.zeros_like(self._buffer("delta", s, models["actor"].sizes[-1]))
            delta[0, :, : a.shape[1]] = self._action_gradient(slope, s.shape[1], mu) * (1.0 - mu.square())
            models["actor"].backward(x, delta)
            self.adams["actor"].step(models["actor"], [rate * learning.actor_rate])
            # Target networks.
            if learning.discount > 0.0:
                for name in TRAINED:
                    models[f"target_{name}"].parameters.flat.lerp_(models[name].parameters.flat, learning.tau)

    def is_finite(self) -> bool:
        """Whether all weights are finite."""
        import torch

        return all(bool(torch.isfinite(model.parameters.flat).all()) for model in self.models.values())

    def layers(self) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        """Weights and biases of the actor, without padding."""
        return unpack(self.sizes["actor"], self.models["actor"].parameters.row(0))

    def state(self) -> dict[str, Any]:
        """All weights, optimiser states and the number of updates."""
        found: dict[str, Any] = {"updates": self.updates}
        for name, model in self.models.items():
            found[name] = model.parameters.flat.cpu().numpy().copy()
        for name, adam in self.adams.items():
            found[f"{name}.first"] = adam.first.flat.cpu().numpy().copy()
            found[f"{name}.second"] = adam.second.flat.cpu().numpy().copy()
        return found

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue exactly where :meth:`state` was taken."""
        import torch

        self.updates = int(state["updates"])
        for name, model in self.models.items():
            model.parameters.flat.copy_(torch.from_numpy(np.array(state[name])))
        for name in TRAINED:
            self.adams[name] = self._adam(name, self.updates)
            self.adams[name].first.flat.copy_(torch.from_numpy(np.array(state[f"{name}.first"])))
            self.adams[name].second.flat.copy_(torch.from_numpy(np.array(state[f"{name}.second"])))

    def _adam(self, name: str, steps: int) -> BatchedAdam:
        sizes = self.models[name].sizes
        return BatchedAdam(Stack.zeros(sizes, 1, self.device), Stack.zeros(sizes, 1, self.device), steps)

    def _normalised(self, observations: torch.Tensor) -> torch.Tensor:
        return (observations - self._centre) * self._per_half

    def _critic_target(self, observations: torch.Tensor) -> torch.Tensor:
        """Targets (N, 3) in the critic's unit, relative to the end effector or to the middle of their range."""
        begin = observations[:, slice(*self.space.ee)] if self.networks.critic_head == "offset" else self._target_centre
        return (observations[:, slice(*self.space.target)] - begin) / self.space.reach

    def _buffer(self, name: str, like: torch.Tensor, width: int = 0) -> torch.Tensor:
        """A reusable buffer (1, N, width), zero where nothing is written."""
        import torch

        key = (name, len(like))
        if key not in self._buffers:
            self._buffers[key] = torch.zeros((1, len(like), width), device=self.device)
        return self._buffers[key]

    def _padded(self, name: str, s: torch.Tensor) -> torch.Tensor:
        buffer = self._buffer(name, s, self.models["actor"].sizes[0])
        buffer[0, :, : s.shape[1]] = s
        return buffer

    def _q(self, name: str, s: torch.Tensor, a: torch.Tensor, target: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor | None]:
        """Q (N,) of observations and actions, both normalised; with the distance head also (p − target)/‖p − target‖."""
        wide, acts, turns = s.shape[1], a.shape[1], len(self.angles)
        x = self._buffer("critic", s, self.models[name].sizes[0])
        x[0, :, :wide] = s
        x[0, :, wide : wide + acts] = a
        if turns:
            angle = a[:, self.angles] * self._angle_half + self._angle_centre
            x[0, :, wide + acts : wide + acts + turns] = angle.sin()
            x[0, :, wide + acts + turns : wide + acts + 2 * turns] = angle.cos()
        out = self.models[name].forward(x)[0]
        if self.networks.critic_head == "value":
            return out[:, 0], None
        away = out[:, :3] - target
        distance = away.norm(dim=1, keepdim=True).clamp_min_(1e-9)
        return out[:, 3] - self.space.reach * distance[:, 0], away / distance

    def _output_gradient(self, way: torch.Tensor | None, slope: torch.Tensor) -> torch.Tensor:
        """From the gradient with respect to Q, (N,), to that of the critic's last layer, (1, N, padded)."""
        import torch

        delta = torch.zeros_like(self._buffer("critic_delta", slope, self.models["critic"].sizes[-1]))
        if way is None:
            delta[0, :, 0] = slope
        else:
            delta[0, :, :3] = (-self.space.reach * slope)[:, None] * way
            delta[0, :, 3] = slope
        return delta

    def _action_gradient(self, inputs: torch.Tensor, wide: int, a: torch.Tensor) -> torch.Tensor:
        """From the gradient of the critic's inputs to that of the normalised action, (N, A)."""
        acts, turns = a.shape[1], len(self.angles)
        found = inputs[0, :, wide : wide + acts].clone()
        if turns:
            angle = a[:, self.angles] * self._angle_half + self._angle_centre
            along_sin = inputs[0, :, wide + acts : wide + acts + turns]
            along_cos = inputs[0, :, wide + acts + turns : wide + acts + 2 * turns]
            found[:, self.angles] += self._angle_half * (along_sin * angle.cos() - along_cos * angle.sin())
        return found


def _first_weights(sizes: tuple[int, ...], rng: np.random.Generator, last: float | None) -> Floats:
    """Uniform within ``±1/√d_in`` a layer, the last one within ``±last`` where it is given."""
    weights, biases = [], []
    for number, (d_in, d_out) in enumerate(itertools.pairwise(sizes)):
        bound = last if last is not None and number == len(sizes) - 2 else 1.0 / math.sqrt(d_in)
        weights.append(rng.uniform(-bound, bound, (d_in, d_out)).astype(np.float32))
        biases.append(rng.uniform(-bound, bound, d_out).astype(np.float32))
    return pack(sizes, weights, biases)
