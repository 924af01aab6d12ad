"""Search around the action of a policy at run time, without torch."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid.networks.forward import ForwardModel
from sysid.networks.policy import PolicyNetwork
from sysid_rl.train.task import ObservationSlices

Array = npt.NDArray[np.float64]


class CandidateSearchPolicy:
    """Search at run time: of candidates around the policy's action, the one nearest to the target by the forward model.

    This is a random search with the policy's action as its first candidate; report its figures separately from the policy's.

    Args:
        policy: its observations begin with joints, end effector and target.
        forward: joints (n, A) → end effector (n, 3) [m].
        candidates: besides the policy's own action.
        sigma: standard deviation of the candidates, in half ranges of each setpoint.
        seed: of the candidates.
    """

    def __init__(
        self, policy: PolicyNetwork, forward: ForwardModel, candidates: int = 10, sigma: float = 0.01, seed: int = 0
    ) -> None:
        self.policy, self.forward, self.candidates, self.sigma = policy, forward, candidates, sigma
        self._rng = np.random.default_rng(seed)
        self._target = ObservationSlices.of(len(policy.outputs)).target

    @property
    def inputs(self) -> tuple[str, ...]:
        """Observations of the policy."""
        return self.policy.inputs

    def act(self, observations: npt.ArrayLike) -> Array:
        """Setpoints (n, A) for observations (n, O)."""
        seen = np.atleast_2d(np.asarray(observations, dtype=np.float64))
        own, policy = self.policy.act(seen), self.policy
        scatter = self._rng.standard_normal((len(own), self.candidates + 1, own.shape[1]))
        scatter[:, 0] = 0.0
        found = own[:, None] + scatter * (self.sigma * 0.5 * (policy.high - policy.low))
        found = np.clip(found, policy.low, policy.high)
        ends = self.forward.predict(found.reshape(-1, own.shape[1])).reshape(len(own), -1, 3)
        best = np.linalg.norm(ends - seen[:, None, self._target], axis=2).argmin(axis=1)
        return np.asarray(found[np.arange(len(own)), best])
