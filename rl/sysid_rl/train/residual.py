"""The environment of a residual policy: inverse kinematics plus a learned offset brings a hanging tool to its target."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.networks.forward import ForwardModel
from sysid.plant import Plant
from sysid_rl.control.pendulum import pendulum_of
from sysid_rl.train.driven import DrivenEnvironment
from sysid_rl.train.environment import Environment
from sysid_rl.train.inverse_kinematics import InverseKinematics, chain_of_forward, chain_of_plant
from sysid_rl.train.reach import Reach
from sysid_rl.train.residual_observation import Residual, ResidualObservation
from sysid_rl.train.task import Flags, Task

Array = npt.NDArray[np.float64]

#: Distance of the seed of swings from that of starts and targets.
SWING_SEED = 2**33


class ResidualEnvironment(Environment):
    """Action: offset (A,) in shares of its bound, [−1, 1]; held for ``repeat`` samples.

    Args:
        plant, forward, size, seed, task, reach: as of :class:`sysid_rl.train.environment.Environment`; the plant has a
            hanging tool.
        residual: the offset.
        settings: further ones of :class:`sysid_rl.train.driven.DrivenEnvironment`.

    Raises:
        SettingsError: plant and forward model do not fit, or nothing hangs at the tip.
    """

    def __init__(
        self,
        plant: Plant,
        forward: ForwardModel,
        *,
        size: int = 1,
        seed: int = 0,
        task: Task | None = None,
        reach: Reach | None = None,
        residual: Residual | None = None,
        **settings: Any,
    ) -> None:
        super().__init__(plant, forward, size, seed, task, reach)
        forever = Task(steps=2**62)
        self.machine = DrivenEnvironment(
            plant, forward, size=size, seed=seed + SWING_SEED, task=forever, reach=self.reach, **settings
        )
        self.rate_hz, low, high = self.machine.rate_hz, self.reach.low, self.reach.high
        self.inverse = InverseKinematics.of(chain_of_forward(forward) or chain_of_plant(plant), low, high)
        names = plant.machine.axis_names
        self.view = ResidualObservation(names, pendulum_of(plant), residual or Residual(), high - low)
        self.names = (*self.slices.names(names), *self.view.names)
        self.observations = len(self.names)
        acts = self.actions
        ones, bound, speed = np.ones(acts), self.view.bound, self.machine.observation_high[-acts - 6 : -6]
        top = np.concatenate([bound, speed, ones, ones, [2.0 * self.view.residual.full_swing], np.ones(4)])
        self.observation_low = np.concatenate([low, self.reach.ee_low, self.reach.ee_low, -top])
        self.observation_high = np.concatenate([high, self.reach.ee_high, self.reach.ee_high, top])
        self._target = np.full((size, 3), np.nan)
        self._solved = np.full((size, acts), np.nan)
        self._last = np.zeros((size, acts))
        self._final = np.full((size, self.observations), np.nan)

    @property
    def action_low(self) -> Array:
        return -np.ones(self.actions)

    @property
    def action_high(self) -> Array:
        return np.ones(self.actions)

    def seed(self, seed: int) -> None:
        super().seed(seed)
        self.machine.seed(seed + SWING_SEED)

    def step(self, actions: npt.ArrayLike) -> tuple[Array, Array, Flags]:
        shares = self._checked(actions)
        self._require_finite(bool(np.isfinite(shares).all()))
        self._last = np.clip(shares, -1.0, 1.0)
        self._solved, _ = self.inverse.solve(self._target, self._solved)
        offset = self.view.offset(self._last, self.machine.look())
        self.machine.step(np.clip(self._solved + offset, self.reach.low, self.reach.high))
        seen = self._observe()
        outside = (np.abs(shares) > 1.0).any(axis=1)
        rewards = self.task.reward(seen[:, self.slices.ee], self._target, outside)
        self._count += 1
        observations, truncated = self._end_of_step(seen[:, self.slices.joints])
        return observations, rewards, truncated

    def predicted(self, observations: Array, actions: Array) -> Array:
        """Raised tools (m, 3) at the end of the dead time, or of ``repeat`` if that is longer, with actions (m, A) held."""
        each = len(actions) // self.size
        solved, seen = (np.repeat(values, each, axis=0) for values in (self._solved, self.machine.look()))
        offset = self.view.offset(np.clip(actions, -1.0, 1.0), seen)
        tools = self.machine.predicted_tool(np.clip(solved + offset, self.reach.low, self.reach.high))
        return np.asarray(tools + np.array([0.0, 0.0, self.view.pendulum.length]))

    def state(self) -> dict[str, Any]:
        own = {"target": self._target, "solved": self._solved, "last": self._last, "final": self._final, "count": self._count}
        return {
            **{name: values.copy() for name, values in own.items()},
            "machine": self.machine.state(),
            "generator": self._rng.bit_generator.state,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        self.machine.restore(state["machine"])
        self._target[:], self._count[:] = state["target"], state["count"]
        self._solved, self._last, self._final = (np.array(state[name]) for name in ("solved", "last", "final"))
        self._rng.bit_generator.state = state["generator"]

    def _observe(self) -> Array:
        return self.view.of(self.machine.look(), self._target, self._solved, self._last)

    def _put(self, which: Flags, joints: Array, targets: Array) -> None:
        self.machine.put(which, joints, targets)
        self._target[which], self._last[which], self._count[which] = targets, 0.0, 0
        starts = np.clip(joints, self.reach.low, self.reach.high)
        self._solved[which], _ = self.inverse.solve(np.atleast_2d(self._target[which]), starts)
