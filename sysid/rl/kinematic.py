"""The paper's setting: joints follow the action at once, the gripper is detached. Ten numbers are then the whole state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError
from sysid.networks.forward import ForwardModel
from sysid.plant import Plant
from sysid.rl.motion import follow
from sysid.rl.reach import Reach, tips
from sysid.rl.task import Flags, Task
from sysid.rl.vector_environment import VectorEnvironment

Array = npt.NDArray[np.float64]


class KinematicEnvironment(VectorEnvironment):
    """Observation: joints (A,), end effector (3,), target (3,). Action: joint setpoints (A,) in SI, clipped to their limits.

    Args:
        plant: where the end effector goes when the joints go somewhere.
        forward: evaluates candidate actions.
        size: copies side by side.
        seed: of starts and targets.
        reach: limits, starts and targets; else those of plant and forward model.

    Raises:
        SettingsError: plant and forward model do not fit, or ``size`` is below one.
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
        self._now = np.full((size, self.parts.width), np.nan)
        self._final = self._now.copy()

    @property
    def observations(self) -> int:
        return self.parts.width

    @property
    def observation_low(self) -> Array:
        return np.concatenate([self.reach.low, self.reach.ee_low, self.reach.ee_low])

    @property
    def observation_high(self) -> Array:
        return np.concatenate([self.reach.high, self.reach.ee_high, self.reach.ee_high])

    @property
    def final(self) -> Array:
        """Observations (n, O) to which the last step led, before any copy was reset."""
        return self._final.copy()

    def reset(self) -> Array:
        """Random joints and targets in all copies; the observations (n, O)."""
        self._reset(np.ones(self.size, dtype=np.bool_))
        return self._now.copy()

    def step(self, actions: npt.ArrayLike) -> tuple[Array, Array, Flags]:
        """Put the joints where ``actions`` (n, A) want them.

        Returns:
            Observations (n, O) that the next actions are for, rewards (n,), whether the episode ended (n,); where it did,
            the observation is that of the next episode and :attr:`final` holds the last one.

        Raises:
            InputError: another shape, or a setpoint that is no number.
        """
        rewards = self._move(self._checked(actions))
        truncated = self._count >= self.task.steps
        fresh = ~truncated & (self._count % self.task.hold == 0) if self.task.targets > 1 else None
        self._final[:] = self._now
        if fresh is not None and fresh.any():
            self._now[fresh, self.parts.target] = self._aims(self._now[fresh, self.parts.joints])
        if truncated.any():
            self._reset(truncated)
        return self._now.copy(), rewards, truncated

    @property
    def names(self) -> tuple[str, ...]:
        """What the columns of an observation are."""
        return self.parts.names(self.plant.machine.axis_names)

    def predicted(self, observations: Array, actions: Array) -> Array:
        """Where the forward model says that candidate ``actions`` (m, A) lead, (m, 3)."""
        return self.forward.predict(np.clip(actions, self.reach.low, self.reach.high))

    def begin(self, joints: npt.ArrayLike, targets: npt.ArrayLike) -> Array:
        """Put all copies at ``joints`` (A,) or (n, A) with ``targets`` (3,) or (n, 3); an episode begins."""
        self._put(np.ones(self.size, dtype=np.bool_), np.asarray(joints, dtype=float), np.asarray(targets, dtype=float))
        return self._now.copy()

    def aim(self, targets: npt.ArrayLike) -> Array:
        """Replace the targets, (3,) or (n, 3)."""
        self._now[:, self.parts.target] = np.asarray(targets, dtype=np.float64)
        return self._now.copy()

    def state(self) -> dict[str, Any]:
        """Everything that the future depends on: arrays, and the generator as plain JSON values."""
        return {
            "now": self._now.copy(),
            "final": self._final.copy(),
            "count": self._count.copy(),
            "generator": self._rng.bit_generator.state,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on exactly where :meth:`state` was taken.

        Raises:
            InputError: it was taken from another number of copies.
        """
        now = np.asarray(state["now"], dtype=np.float64)
        if now.shape != self._now.shape:
            raise InputError("environment", f"a state of shape {now.shape}", f"one of shape {self._now.shape}")
        self._now[:], self._final[:] = now, state["final"]
        self._count[:] = state["count"]
        self._rng.bit_generator.state = state["generator"]

    def _move(self, wanted: Array) -> Array:
        rewards = np.empty(self.size)
        task = self.task
        finite = follow(
            self.model.theta, self.model.arrays, wanted, self.reach.low, self.reach.high, self._now, self._count, rewards,
            task.step_reward + task.near_reward, task.outside_reward,
        )  # fmt: skip
        if not finite:
            raise InputError("environment", "an action that is no finite number", "joint setpoints [rad or m]")
        return rewards

    def _put(self, which: Flags, joints: Array, targets: Array) -> None:
        self._now[which, self.parts.joints] = np.clip(joints, self.reach.low, self.reach.high)
        self._now[which, self.parts.ee] = tips(self.model, self._now[which, self.parts.joints])
        self._now[which, self.parts.target] = targets
        self._count[which] = 0
