"""The environment of a policy: n copies of a machine, joint setpoints in, observations and rewards out.

An observation begins with the joints, the end effector and its target; the reward is that of :class:`sysid_rl.train.task.Task`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError, SettingsError
from sysid.networks.forward import ForwardModel
from sysid.plant import Plant, compile_plant
from sysid_rl.train.reach import Reach, reach_of, tips
from sysid_rl.train.task import Flags, ObservationSlices, Task, check_pair

Array = npt.NDArray[np.float64]


class Policy(Protocol):
    """Observations (n, O) → joint setpoints (n, A) in SI."""

    def act(self, observations: Array) -> Array: ...


class NamedPolicy(Policy, Protocol):
    """A policy with the names of its observations."""

    @property
    def inputs(self) -> tuple[str, ...]: ...


class Environment(ABC):
    """``size`` independent copies of a plant, each with its own start and target. Arrays that it returns are copies.

    Args:
        plant: moves the end effector.
        forward: predicts where candidate actions lead.
        seed: of starts and targets.
        task: of an episode; by default the paper's.
        reach: limits, starts and targets; by default those of plant and forward model.

    Raises:
        SettingsError: plant and forward model do not fit each other, or ``size`` is below one.
    """

    #: Number and names of an observation's columns, and bounds (O,) to scale networks.
    observations: int
    names: tuple[str, ...]
    observation_low: Array
    observation_high: Array
    #: Targets, (n, 3), and the last observations, (n, O).
    _target: Array
    _final: Array

    def __init__(
        self, plant: Plant, forward: ForwardModel, size: int, seed: int, task: Task | None, reach: Reach | None
    ) -> None:
        if size < 1:
            raise SettingsError("environment", f"size = {size}", "at least one copy")
        check_pair(plant, forward)
        self.plant, self.forward, self.size, self.task = plant, forward, size, task or Task()
        self.reach = reach or reach_of(plant, forward)
        self.model = compile_plant(plant)
        self.rate_hz, self.actions, self.steps = plant.machine.rate_hz, self.model.axes, self.task.steps
        self.slices = ObservationSlices.of(self.actions)
        #: Distance of targets from the joints of a copy: 1, anywhere within reach; less, that share of the way there.
        self.spread = 1.0
        self._rng = np.random.default_rng(seed)
        self._count = np.zeros(size, dtype=np.int64)

    @property
    def action_low(self) -> Array:
        return self.reach.low.copy()

    @property
    def action_high(self) -> Array:
        return self.reach.high.copy()

    @property
    def final(self) -> Array:
        """Observations (n, O) after the last step, before any copy was reset."""
        return self._final.copy()

    def seed(self, seed: int) -> None:
        """Seed of starts and targets from now on."""
        self._rng = np.random.default_rng(seed)

    def reset(self) -> Array:
        """Put all copies at rest at random joints, with random targets; the observations (n, O)."""
        self._reset(np.ones(self.size, dtype=np.bool_))
        return self._observe()

    @abstractmethod
    def step(self, actions: npt.ArrayLike) -> tuple[Array, Array, Flags]:
        """Apply the joint setpoints ``actions`` (n, A).

        Returns:
            Observations (n, O) for the next actions, rewards (n,), whether the episode ended (n,). Where it did, the
            observation is that of the next episode and :attr:`final` holds the last one.

        Raises:
            InputError: another shape, or a setpoint that is not finite.
        """

    def targets(self, observations: Array) -> Array:
        """Targets (m, 3) inside observations (m, O)."""
        return np.asarray(observations)[:, self.slices.target]

    @abstractmethod
    def predicted(self, observations: Array, actions: Array) -> Array:
        """End effectors (m, 3) to which candidate ``actions`` (m, A) lead."""

    def begin(self, joints: npt.ArrayLike, targets: npt.ArrayLike) -> Array:
        """Begin an episode in all copies, at rest at ``joints`` (A,) or (n, A) with ``targets`` (3,) or (n, 3)."""
        rows = np.broadcast_to(np.asarray(joints, dtype=np.float64), (self.size, self.actions))
        self._put(np.ones(self.size, dtype=np.bool_), rows, np.asarray(targets, dtype=np.float64))
        return self._observe()

    def aim(self, targets: npt.ArrayLike) -> Array:
        """Replace the targets, (3,) or (n, 3)."""
        self._target[:] = np.asarray(targets, dtype=np.float64)
        return self._observe()

    @abstractmethod
    def state(self) -> dict[str, Any]:
        """Everything that the future depends on: arrays, and the generator as plain JSON values."""

    @abstractmethod
    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue exactly where :meth:`state` was taken.

        Raises:
            InputError, SettingsError: it was taken from another environment.
        """

    @abstractmethod
    def _observe(self) -> Array:
        """Observations (n, O), a copy."""

    @abstractmethod
    def _put(self, which: Flags, joints: Array, targets: Array) -> None:
        """Begin an episode in these copies at these joints, with these targets."""

    def _checked(self, actions: npt.ArrayLike) -> Array:
        wanted = np.ascontiguousarray(actions, dtype=np.float64)
        if wanted.shape != (self.size, self.actions):
            raise InputError("environment", f"actions of shape {wanted.shape}", f"({self.size}, {self.actions})")
        return wanted

    def _require_finite(self, finite: bool) -> None:
        if not finite:
            raise InputError("environment", "an action that is no finite number", "joint setpoints [rad or m]")

    def _end_of_step(self, joints: Array) -> tuple[Array, Flags]:
        """Replace the targets that are due, begin the next episode where one ended; observations and which ended."""
        truncated = self._count >= self.task.steps
        self._final = self._observe()
        changed = bool(truncated.any())
        if self.task.targets > 1:
            due = ~truncated & (self._count % self.task.hold == 0)
            if due.any():
                self._target[due], changed = self._random_targets(joints[due]), True
        if truncated.any():
            self._reset(truncated)
        return self._observe() if changed else self._final.copy(), truncated

    def _reset(self, which: Flags) -> None:
        """Random joints and targets."""
        joints = self.reach.draw(int(which.sum()), self._rng)
        self._put(which, joints, self._random_targets(joints))

    def _random_targets(self, joints: Array) -> Array:
        """Targets (n, 3) for copies at ``joints`` (n, A): end effectors of random joints within :attr:`spread`."""
        drawn = self.reach.draw(len(joints), self._rng)
        if self.spread < 1.0:
            drawn = joints + self.spread * (drawn - joints)
        return tips(self.model, drawn)
