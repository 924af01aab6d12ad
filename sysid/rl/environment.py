"""What a policy learns in: n copies of a machine side by side, joint setpoints in, observations and rewards out.

Source: the paper's DDPG components. An observation begins with the joints, the end effector and its target; the reward of a
step is ``0.001 + (0.002 − ‖target − ee‖) − 0.0005·[a setpoint outside its limits]`` [m].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from sysid.config import STRICT
from sysid.errors import SettingsError, StoreError
from sysid.networks.forward import ForwardModel
from sysid.plant import Plant, plant_from_files
from sysid.signals import axis_signal

if TYPE_CHECKING:
    from sysid.registry import ModelVersion, Registry

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Task:
    """What is asked in an episode.

    Args:
        steps: of an episode.
        targets: how many targets an episode has, one after the other for equal times; the paper has one.
        step_reward: for every step.
        near_reward: the distance [m] at which the reward of being near is zero.
        outside_reward: of a step in which any setpoint leaves its limits (below zero).
    """

    __pydantic_config__ = STRICT

    steps: int = 1000
    targets: int = 1
    step_reward: float = 0.001
    near_reward: float = 0.002
    outside_reward: float = -0.0005

    def __post_init__(self) -> None:
        if not 1 <= self.targets <= self.steps:
            raise SettingsError("task", f"{self.targets} targets in {self.steps} steps", "at least a step for each target")

    @property
    def hold(self) -> int:
        """Steps for which a target stays."""
        return -(-self.steps // self.targets)

    def reward(self, ee: npt.ArrayLike, target: npt.ArrayLike, outside: npt.ArrayLike) -> Array:
        """Rewards (n,) of end effectors and targets (n, 3) [m], ``outside`` (n,): whether a setpoint left its limits."""
        away = np.linalg.norm(np.asarray(target, dtype=np.float64) - np.asarray(ee, dtype=np.float64), axis=-1)
        return np.asarray(self.step_reward + self.near_reward - away + self.outside_reward * np.asarray(outside, dtype=float))


class Environment(Protocol):
    """``size`` copies that know nothing of each other; all arrays are fresh, so they may be kept.

    ``spread``: how far from where a copy stands its next target lies, as a share of the way to anywhere within reach.
    """

    spread: float

    @property
    def size(self) -> int: ...

    @property
    def observations(self) -> int: ...

    @property
    def actions(self) -> int: ...

    @property
    def action_low(self) -> Array: ...

    @property
    def action_high(self) -> Array: ...

    @property
    def observation_low(self) -> Array: ...

    @property
    def observation_high(self) -> Array: ...

    @property
    def steps(self) -> int: ...

    @property
    def forward(self) -> ForwardModel: ...

    @property
    def final(self) -> Array: ...

    @property
    def rate_hz(self) -> float: ...

    @property
    def names(self) -> tuple[str, ...]: ...

    def seed(self, seed: int) -> None: ...

    def reset(self) -> Array: ...

    def step(self, actions: Array) -> tuple[Array, Array, Flags]: ...

    def targets(self, observations: Array) -> Array: ...

    def predicted(self, observations: Array, actions: Array) -> Array: ...

    def begin(self, joints: npt.ArrayLike, targets: npt.ArrayLike) -> Array: ...

    def aim(self, targets: npt.ArrayLike) -> Array: ...

    def state(self) -> dict[str, Any]: ...

    def restore(self, state: Mapping[str, Any]) -> None: ...


@dataclass(frozen=True)
class Parts:
    """Where the parts of an observation stand, (first, last + 1); every environment begins with these three."""

    joints: slice
    ee: slice
    target: slice

    @staticmethod
    def of(axes: int) -> Parts:
        return Parts(slice(0, axes), slice(axes, axes + 3), slice(axes + 3, axes + 6))

    def names(self, axes: Sequence[str]) -> tuple[str, ...]:
        """What the columns are."""
        points = (f"{what}.{axis}" for what in ("ee", "target") for axis in "xyz")
        return (*(axis_signal(axis, "joint") for axis in axes), *points)

    @property
    def width(self) -> int:
        """Of an observation that has nothing else."""
        return int(self.target.stop)


def from_versions(
    registry: Registry,
    plant: str,
    forward: str,
    *,
    size: int = 1,
    seed: int = 0,
    task: Task | None = None,
    full: bool = False,
    **settings: Any,
) -> Environment:
    """The environment of a registered plant, judged by a registered forward model.

    Args:
        plant, forward: ``name``, ``name@3`` or ``name@champion``.
        size: copies side by side.
        full: joint setpoints pass actuator networks, cylinder controller, valves and plant; else joints follow at once.
        settings: of :class:`sysid.rl.driven.DrivenEnvironment` (``full`` only).

    Raises:
        StoreError: no such version, or one of another kind.
        SettingsError: the plant lacks a joint, or the forward model belongs to another machine.
    """
    from sysid.rl.driven import DrivenEnvironment
    from sysid.rl.kinematic import KinematicEnvironment

    machine, model = load_versions(registry, plant, forward)
    if full:
        return DrivenEnvironment(machine, model, size=size, seed=seed, task=task, **settings)
    if settings:
        found = f"settings {', '.join(sorted(settings))}"
        raise SettingsError("environment", found, "none: they belong to the full path (full = true)")
    return KinematicEnvironment(machine, model, size=size, seed=seed, task=task)


def load_versions(registry: Registry, plant: str, forward: str) -> tuple[Plant, ForwardModel]:
    """A plant and a forward model that fit each other.

    Raises:
        StoreError, SettingsError: as :func:`from_versions`.
    """
    from sysid.networks.artifacts import from_files

    plants, models = registry.load(plant), registry.load(forward)
    for version, kind in ((plants, "plant"), (models, "forward")):
        if version.kind != kind:
            raise StoreError(f"model {version.reference}", f"is of kind {version.kind!r}", f"a version of kind {kind!r}")
    found = plant_from_files(plants.files, plants.reference)
    model = from_files(models.files, models.reference)
    assert not isinstance(model, Mapping)
    check_pair(found, model, models.reference)
    _check_lineage(registry, plants, models)
    return found, model


def check_pair(plant: Plant, forward: ForwardModel, name: str = "forward model") -> None:
    """Refuse a plant that cannot be posed, and a forward model of other joints.

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


def _check_lineage(registry: Registry, plant: ModelVersion, forward: ModelVersion) -> None:
    """Refuse a forward model that was not trained on a dataset that the plant, or what it was made of, comes from."""
    from sysid.registry.lineage import made_of

    trained_on = str(forward.lineage.get("dataset", "")).partition("@")[0]
    sources = [plant, *made_of(registry.list(), plant)]
    known = {str(version.lineage[key]).partition("@")[0] for version in sources for key in ("dataset", "machine")
             if version.lineage.get(key)}  # fmt: skip
    if trained_on and known and trained_on not in known:
        raise SettingsError(
            f"forward model {forward.reference}",
            f"was trained on another machine (dataset {forward.lineage['dataset']})",
            f"a dataset of the machine of plant {plant.reference}: {', '.join(sorted(known))}",
            "Name a forward version of that machine, or fit one.",
        )
