"""A residual policy on a machine: inverse kinematics at every sample, and the offset of a network, held as in its training."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError
from sysid.networks.policy import PolicyNetwork
from sysid.plant import Plant
from sysid_rl.control.pendulum import pendulum_of
from sysid_rl.control.swing_estimator import SwingEstimator
from sysid_rl.train.inverse_kinematics import InverseKinematics
from sysid_rl.train.observation import DrivenObservation, dead_steps
from sysid_rl.train.residual_observation import Residual, ResidualObservation
from sysid_rl.train.task import ObservationSlices

Array = npt.NDArray[np.float64]


class ResidualPolicy:
    """Setpoints (1, A) for observations of the full path, (1, …), at every sample of one machine.

    Args:
        network: trained with ``setting.residual``.
        plant: of the machine, with the identified pendulum.
        inverse: target → joints.
        measured: the tool is measured; else its swing is estimated from the motion of the tip.

    Raises:
        SettingsError: a network that sets joints, one of another machine, or a plant without a hanging tool.
    """

    def __init__(self, network: PolicyNetwork, plant: Plant, inverse: InverseKinematics, measured: bool = True) -> None:
        where, setting = f"residual policy for {plant.machine.name}", network.residual
        if setting is None:
            raise SettingsError(where, "a policy that sets joints", "one that was trained with setting.residual")
        self.network, self.inverse = network, inverse
        self.repeat = int(setting["repeat"])
        residual = Residual(setting["share"], setting["full_swing"])
        self._slices = ObservationSlices.of(len(inverse.low))
        names = plant.machine.axis_names
        self._view = ResidualObservation(names, pendulum_of(plant), residual, inverse.high - inverse.low)
        own = (*self._slices.names(names), *self._view.names)
        if network.inputs != own:
            different = next((a for a, b in zip(network.inputs, own, strict=False) if a != b), f"{len(network.inputs)} numbers")
            raise SettingsError(where, f"observes {different}", f"{', '.join(own)}", "It was trained for another machine.")
        rate = plant.machine.rate_hz
        #: Names of the observations, and of the setpoints.
        self.inputs = DrivenObservation(names, dead_steps(plant, rate), rate).names
        self.outputs = network.outputs
        self._estimator = None if measured else SwingEstimator(self._view.pendulum, rate)
        self._solved: Array | None = None
        self._last, self._offset, self._count = (np.zeros((1, len(names))), np.zeros((1, len(names))), 0)

    def rest(self) -> None:
        """Begin anew with the next observations."""
        self._solved = None

    def reset(self, observations: Array) -> None:
        """Search from the measured joints, without an offset."""
        self._solved = np.array(observations[:, self._slices.joints], dtype=np.float64)
        self._last[:], self._offset[:], self._count = 0.0, 0.0, 0
        if self._estimator is not None:
            self._estimator.reset(observations[:, self._slices.ee])

    def act(self, observations: Array) -> Array:
        if self._solved is None:
            self.reset(observations)
        assert self._solved is not None
        if self._estimator is not None:
            swing = self._estimator.step(observations[:, self._slices.ee])
            observations = np.concatenate([observations[:, :-6], *swing], axis=1)
        target = observations[:, self._slices.target]
        self._solved, _ = self.inverse.solve(target, self._solved)
        if self._count % self.repeat == 0:
            self._last = self.network.act(self._view.of(observations, target, self._solved, self._last))
            self._offset = self._view.offset(self._last, observations)
        self._count += 1
        return np.clip(self._solved + self._offset, self.inverse.low, self.inverse.high)
