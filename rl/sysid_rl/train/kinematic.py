"""The paper's setting: joints follow the action at once, the gripper is detached. Ten numbers are then the whole state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError, SettingsError
from sysid.networks.forward import ForwardModel
from sysid.plant import Plant
from sysid_rl.train.environment import Environment
from sysid_rl.train.motion import move_copies
from sysid_rl.train.reach import Reach, tips
from sysid_rl.train.task import Flags, Task

Array = npt.NDArray[np.float64]


class KinematicEnvironment(Environment):
    """Observation: joints (A,), end effector (3,), target (3,). Action: joint setpoints (A,) in SI, clipped to their limits.

    Args, errors: see :class:`sysid_rl.train.environment.Environment`.
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
    ) -> None:
        super().__init__(plant, forward, size, seed, task, reach)
        if self.task.saturation > 0.0:
            found = f"task.saturation = {self.task.saturation:g} where joints follow at once"
            raise SettingsError("environment", found, "0, or the full path")
        self.observations, self.names = self.slices.width, self.slices.names(plant.machine.axis_names)
        self.observation_low = np.concatenate([self.reach.low, self.reach.ee_low, self.reach.ee_low])
        self.observation_high = np.concatenate([self.reach.high, self.reach.ee_high, self.reach.ee_high])
        self._now = np.full((size, self.observations), np.nan)
        self._target = self._now[:, self.slices.target]  # a view
        self._final = self._now.copy()

    def step(self, actions: npt.ArrayLike) -> tuple[Array, Array, Flags]:
        rewards, task = np.empty(self.size), self.task
        finite = move_copies(
            self.model.theta, self.model.arrays, self._checked(actions), self.reach.low, self.reach.high, self._now,
            self._count, rewards, task.step_reward + task.near_reward, task.outside_reward,
        )  # fmt: skip
        self._require_finite(finite)
        observations, truncated = self._end_of_step(self._now[:, self.slices.joints])
        return observations, rewards, truncated

    def predicted(self, observations: Array, actions: Array) -> Array:
        return self.forward.predict(np.clip(actions, self.reach.low, self.reach.high))

    def state(self) -> dict[str, Any]:
        return {
            "now": self._now.copy(),
            "final": self._final.copy(),
            "count": self._count.copy(),
            "generator": self._rng.bit_generator.state,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        now = np.asarray(state["now"], dtype=np.float64)
        if now.shape != self._now.shape:
            raise InputError("environment", f"a state of shape {now.shape}", f"one of shape {self._now.shape}")
        self._now[:], self._final[:] = now, state["final"]
        self._count[:] = state["count"]
        self._rng.bit_generator.state = state["generator"]

    def _observe(self) -> Array:
        return self._now.copy()

    def _put(self, which: Flags, joints: Array, targets: Array) -> None:
        self._now[which, self.slices.joints] = np.clip(joints, self.reach.low, self.reach.high)
        self._now[which, self.slices.ee] = tips(self.model, self._now[which, self.slices.joints])
        self._target[which] = targets
        self._count[which] = 0
