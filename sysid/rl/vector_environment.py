"""What the environments have in common: copies of one machine side by side, their limits, starts and targets."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError, SettingsError
from sysid.networks.forward import ForwardModel
from sysid.plant import Plant, compile_plant
from sysid.rl.reach import Reach, reach_of, tips
from sysid.rl.task import ObservationSlices, Task, check_pair

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


class VectorEnvironment(ABC):
    """``size`` copies of a plant, each with a task of its own; how they move is what environments differ in.

    Raises:
        SettingsError: plant and forward model do not fit, or ``size`` is below one.
    """

    def __init__(
        self, plant: Plant, forward: ForwardModel, size: int, seed: int, task: Task | None, reach: Reach | None
    ) -> None:
        if size < 1:
            raise SettingsError("environment", f"size = {size}", "at least one copy")
        check_pair(plant, forward)
        self.plant, self.forward, self.size, self.task = plant, forward, size, task or Task()
        self.reach = reach or reach_of(plant, forward)
        self.model = compile_plant(plant)
        self.rate_hz = plant.machine.rate_hz
        self.parts = ObservationSlices.of(self.actions)
        #: How far from where a copy stands its targets lie: 1, anywhere within reach; less, on the way there.
        self.spread = 1.0
        self._rng = np.random.default_rng(seed)
        self._count = np.zeros(size, dtype=np.int64)

    @property
    def actions(self) -> int:
        return self.model.axes

    @property
    def steps(self) -> int:
        return self.task.steps

    @property
    def action_low(self) -> Array:
        return self.reach.low.copy()

    @property
    def action_high(self) -> Array:
        return self.reach.high.copy()

    def seed(self, seed: int) -> None:
        """Starts and targets from now on."""
        self._rng = np.random.default_rng(seed)

    def targets(self, observations: Array) -> Array:
        """Targets (m, 3) inside observations (m, O)."""
        return np.asarray(observations)[:, self.parts.target]

    def _checked(self, actions: npt.ArrayLike) -> Array:
        wanted = np.ascontiguousarray(actions, dtype=np.float64)
        if wanted.shape != (self.size, self.actions):
            raise InputError("environment", f"actions of shape {wanted.shape}", f"({self.size}, {self.actions})")
        return wanted

    def _reset(self, which: Flags) -> None:
        """Random joints and targets."""
        joints = self.reach.draw(int(which.sum()), self._rng)
        self._put(which, joints, self._aims(joints))

    def _aims(self, joints: Array) -> Array:
        """Targets (n, 3) for copies that stand at ``joints`` (n, A): end effectors of random ones within :attr:`spread`."""
        aims = self.reach.draw(len(joints), self._rng)
        if self.spread < 1.0:
            aims = joints + self.spread * (aims - joints)
        return tips(self.model, aims)

    @abstractmethod
    def _put(self, which: Flags, joints: Array, targets: Array) -> None:
        """These copies at these joints, with these targets; an episode begins."""
