"""Whether the networks extrapolate."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sysid.errors import SettingsError
from sysid.networks import ActuatorNetwork
from sysid.networks.forward import ForwardModel
from sysid_rl.run.state_estimator import StateEstimate


class TrainingDomains:
    """Training domains of a forward model and actuator networks. Motion back towards the data is no violation.

    Kinematics without a network have no training data to leave.

    Args:
        forward: joints → end effector.
        actuators: axis → network.
        axes: names, in order.

    Raises:
        SettingsError: the forward version has no training domain.
    """

    def __init__(self, forward: ForwardModel, actuators: Mapping[str, ActuatorNetwork], axes: tuple[str, ...]) -> None:
        known = forward.uncertainty
        if known is None and forward.members:
            raise SettingsError(
                "checks.domain",
                "the forward version has no training domain",
                "one that was fitted by this release",
                'Fit it again, or disable the check: [checks.without] domain = "why".',
            )
        columns = [(axis, axes.index(axis), network.uncertainty.get("to_joint")) for axis, network in actuators.items()]
        self._forward = None if known is None else known.domain
        self._actuators = [(axis, i, uncertainty.domain) for axis, i, uncertainty in columns if uncertainty is not None]
        self._before: dict[str, float] = {}

    def __call__(self, estimate: StateEstimate) -> str:
        """A text about the network that extrapolates, and farther than before; "" if none does."""
        queries = [] if self._forward is None else [("forward", self._forward, estimate.joints[None])]
        queries += [(f"actuator of {axis}", domain, estimate.drive[i : i + 1, None]) for axis, i, domain in self._actuators]
        for name, domain, query in queries:
            if not np.isfinite(query).all() or domain.inside(query)[0]:
                self._before[name] = 0.0
                continue
            distance = float(domain.distance(query)[0])
            before = self._before.get(name, 0.0)
            self._before[name] = distance
            if distance >= before:
                return f"network {name} extrapolates: {distance:.1f} times the usual distance between its training data"
        return ""
