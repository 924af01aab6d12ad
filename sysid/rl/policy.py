"""Policies of the registry: ``load_policy(registry.load("autolog-feedback")).act(observations)``, without torch."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid.errors import StoreError
from sysid.networks.forward import ForwardModel
from sysid.networks.policy import PolicyNetwork, policy_from_files
from sysid.registry import ModelVersion
from sysid.rl.task import ObservationSlices

Array = npt.NDArray[np.float64]


def load_policy(version: ModelVersion) -> PolicyNetwork:
    """The policy in a version whose files are loaded (``Registry.load``).

    Raises:
        StoreError: it is a version of another kind, or its files are no policy.
    """
    if version.kind != "policy":
        raise StoreError(f"model {version.reference}", f"is of kind {version.kind!r}", "a policy")
    return policy_from_files(version.files, version.reference)


class CandidateSearchPolicy:
    """A policy with a choice at run time: of candidates around its answer, the one nearest to the target by the forward model.

    This is a random search over inverse kinematics with a policy as its first guess, no property of the policy: its figures
    belong in a row of their own. The answer itself is among the candidates.

    Args:
        policy: joints, end effector and target first among what it sees.
        forward: joints (n, A) → end effector (n, 3) [m].
        candidates: besides the policy's own answer.
        sigma: how far they scatter, of half the range of each setpoint.
        seed: of the scatter.
    """

    def __init__(
        self, policy: PolicyNetwork, forward: ForwardModel, candidates: int = 10, sigma: float = 0.01, seed: int = 0
    ) -> None:
        self.policy, self.forward, self.candidates, self.sigma = policy, forward, candidates, sigma
        self._rng = np.random.default_rng(seed)
        self._target = ObservationSlices.of(len(policy.outputs)).target

    @property
    def inputs(self) -> tuple[str, ...]:
        """What it observes: what the policy does."""
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
