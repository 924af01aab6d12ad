"""Whether the networks are asked where their data were."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sysid.errors import SettingsError
from sysid.networks import ActuatorNetwork
from sysid.networks.forward import ForwardModel
from sysid.runner.state_estimator import StateEstimate


class TrainingDomains:
    """Of a forward model and the networks of cylinders. Motion that leads back to the data is not objected to.

    Args:
        forward: joints → end effector.
        actuators: axis → network.
        axes: names, in order.

    Raises:
        SettingsError: the forward version does not know where its data were.
    """

    def __init__(self, forward: ForwardModel, actuators: Mapping[str, ActuatorNetwork], axes: tuple[str, ...]) -> None:
        if forward.trust is None:
            raise SettingsError(
                "checks.domain",
                "the forward version does not know where its data were",
                "one that was fitted by this release",
                'Fit it again, or leave the check out: [checks.without] domain = "why".',
            )
        self._forward = forward.trust.domain
        columns = [(axis, axes.index(axis), network.trust.get("to_joint")) for axis, network in actuators.items()]
        self._actuators = [(axis, i, trust.domain) for axis, i, trust in columns if trust is not None]
        self._before: dict[str, float] = {}

    def __call__(self, estimate: StateEstimate) -> str:
        """Which network is asked beyond its data, and further than before; "" where none is."""
        asked = [("forward", self._forward, estimate.joints[None])]
        asked += [(f"actuator of {axis}", domain, estimate.drive[i : i + 1, None]) for axis, i, domain in self._actuators]
        for name, domain, query in asked:
            if not np.isfinite(query).all() or domain.inside(query)[0]:
                self._before[name] = 0.0
                continue
            away = float(domain.distance(query)[0])
            before = self._before.get(name, 0.0)
            self._before[name] = away
            if away >= before:
                return f"network {name} is asked {away:.1f} times as far from its data as is usual among them"
        return ""
