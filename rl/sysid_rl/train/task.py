"""The task of an episode and its columns in an observation. Source: the paper's DDPG components."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.config import Strict
from sysid.errors import SettingsError
from sysid.networks.forward import ForwardModel
from sysid.plant import Plant
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Task(Strict):
    """The task of an episode; its reward is ``step_reward + (near_reward − ‖target − ee‖) + outside_reward·[outside]``.

    Args:
        steps: of an episode.
        targets: number of targets of an episode, one after the other for equal times; the paper has one.
        step_reward: for every step.
        near_reward: the distance [m] at which the distance term is zero.
        outside_reward: penalty of a step in which any setpoint leaves its limits (below zero).
        saturation: s [m] where the distance term levels off: a distance d counts as ``d/(1 + d/s)``; 0: as d, as in the paper.
    """

    steps: int = 1000
    targets: int = 1
    step_reward: float = 0.001
    near_reward: float = 0.002
    outside_reward: float = -0.0005
    saturation: float = 0.0

    def __post_init__(self) -> None:
        if not 1 <= self.targets <= self.steps:
            raise SettingsError("task", f"{self.targets} targets in {self.steps} steps", "at least a step for each target")

    @property
    def hold(self) -> int:
        """Steps for each target."""
        return -(-self.steps // self.targets)

    def reward(self, ee: npt.ArrayLike, target: npt.ArrayLike, outside: npt.ArrayLike) -> Array:
        """Rewards (n,) of end effectors and targets (n, 3) [m], ``outside`` (n,): whether a setpoint left its limits."""
        distance = np.linalg.norm(np.asarray(target, dtype=np.float64) - np.asarray(ee, dtype=np.float64), axis=-1)
        if self.saturation > 0.0:
            distance = distance / (1.0 + distance / self.saturation)
        return np.asarray(
            self.step_reward + self.near_reward - distance + self.outside_reward * np.asarray(outside, dtype=float)
        )


@dataclass(frozen=True)
class ObservationSlices:
    """Columns of an observation; every observation begins with these three parts."""

    joints: slice
    ee: slice
    target: slice

    @staticmethod
    def of(axes: int) -> ObservationSlices:
        return ObservationSlices(slice(0, axes), slice(axes, axes + 3), slice(axes + 3, axes + 6))

    def names(self, axes: Sequence[str]) -> tuple[str, ...]:
        """Names of the columns."""
        points = (f"{what}.{axis}" for what in ("ee", "target") for axis in "xyz")
        return (*(axis_signal(axis, "joint") for axis in axes), *points)

    @property
    def width(self) -> int:
        """Columns of the three parts."""
        return int(self.target.stop)


def check_pair(plant: Plant, forward: ForwardModel, name: str = "forward model") -> None:
    """Check that a plant has kinematics, and that the forward model has the same joints.

    Raises:
        SettingsError: naming the joint.
    """
    where = f"plant {plant.reference or plant.machine.name}"
    own = tuple(axis_signal(axis, "joint") for axis in plant.machine.axis_names)
    missing = [signal for signal in forward.joints if signal not in own]
    if missing:
        raise SettingsError(
            where, f"has no joint {missing[0].removesuffix('.joint')!r}", f"the joints of {name}: {', '.join(forward.joints)}"
        )
    if forward.joints != own:
        extra = ", ".join(signal for signal in own if signal not in forward.joints) or "in another order"
        raise SettingsError(name, f"takes {', '.join(forward.joints)}", f"the joints of {where} ({extra})", "Fit it again.")
    if plant.machine.kinematics() is None:
        raise SettingsError(where, "its machine has no URDF", "kinematics: urdf = … and tip = … in machine.toml")
