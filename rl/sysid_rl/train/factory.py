"""Make an environment: joints that follow at once, or the full path through controller, valves and plant."""

from __future__ import annotations

from typing import Any

from sysid.errors import SettingsError
from sysid.networks.forward import ForwardModel
from sysid.plant import Plant
from sysid.registry import Registry
from sysid_rl.train.driven import DrivenEnvironment
from sysid_rl.train.environment import Environment
from sysid_rl.train.kinematic import KinematicEnvironment
from sysid_rl.train.reach import Reach
from sysid_rl.train.residual import ResidualEnvironment
from sysid_rl.train.residual_observation import Residual
from sysid_rl.train.task import Task
from sysid_rl.train.versions import load_versions


def make_environment(
    plant: Plant,
    forward: ForwardModel,
    *,
    full: bool = False,
    size: int = 1,
    seed: int = 0,
    task: Task | None = None,
    reach: Reach | None = None,
    residual: Residual | None = None,
    **settings: Any,
) -> Environment:
    """An environment of ``size`` copies.

    Args:
        full: joint setpoints pass actuator networks, cylinder controller, valves and plant; else joints follow at once.
        reach: limits, starts and targets; by default those of plant and forward model.
        residual: actions are offsets of inverse kinematics that bring a hanging tool to rest (``full`` only).
        settings: of :class:`sysid_rl.train.driven.DrivenEnvironment` (``full`` only).

    Raises:
        SettingsError: plant and forward model do not fit each other, or settings of the full path without ``full``.
    """
    if full and residual is not None:
        return ResidualEnvironment(plant, forward, size=size, seed=seed, task=task, reach=reach, residual=residual, **settings)
    if full:
        return DrivenEnvironment(plant, forward, size=size, seed=seed, task=task, reach=reach, **settings)
    if settings:
        found = f"settings {', '.join(sorted(settings))}"
        raise SettingsError("environment", found, "none: they belong to the full path (full = true)")
    return KinematicEnvironment(plant, forward, size=size, seed=seed, task=task, reach=reach)


def from_versions(registry: Registry, plant: str, forward: str, **settings: Any) -> Environment:
    """The environment of a registered plant and a registered forward model.

    Args:
        plant, forward: ``name``, ``name@3`` or ``name@champion``.
        settings: of :func:`make_environment`.

    Raises:
        StoreError: no such version, or one of another kind.
        SettingsError: the plant lacks a joint, or the forward model belongs to another machine.
    """
    return make_environment(*load_versions(registry, plant, forward), **settings)
