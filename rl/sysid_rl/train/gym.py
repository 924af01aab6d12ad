"""Environments for Gymnasium: one copy (:class:`MachineEnv`) and many (:class:`MachineVectorEnv`).

>>> env = MachineEnv(from_versions(registry, "autolog", "autolog-forward"))
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from sysid.errors import SettingsError
from sysid_rl.train.environment import Environment

Array = npt.NDArray[np.float64]
Observation = npt.NDArray[np.float32]

#: Observations may leave the bounds for the scaling of networks; the spaces are wider by this share of their range.
ROOM = 0.25


class MachineEnv(gymnasium.Env[Any, Any]):
    """One copy.

    Args:
        environment: of size one; its seed is set by ``reset(seed=…)``.
        normalised: actions in [-1, 1] instead of joint setpoints in SI, for trainers that expect it.

    Raises:
        SettingsError: several copies.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - as Gymnasium declares it

    def __init__(self, environment: Environment, normalised: bool = False) -> None:
        if environment.size != 1:
            raise SettingsError("MachineEnv", f"{environment.size} copies", "one; MachineVectorEnv takes several")
        self.environment, self.normalised = environment, normalised
        self.observation_space, self.action_space = spaces(environment, normalised)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """A random start and target; ``options`` may hold ``joints`` (A,) and ``target`` (3,) instead."""
        super().reset(seed=seed)
        if seed is not None:
            self.environment.seed(seed)
        if options:
            unknown = set(options) - {"joints", "target"}
            if unknown or len(options) != 2:
                raise SettingsError("MachineEnv.reset", f"options {sorted(options)}", "joints and target, or none")
            return _single(self.environment.begin(options["joints"], options["target"])), {}
        return _single(self.environment.reset()), {}

    def step(self, action: npt.ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One step; an episode is never terminated, only truncated after its steps."""
        wanted = np.asarray(action, dtype=np.float64)[None]
        _, rewards, truncated = self.environment.step(setpoints(self.environment, wanted, self.normalised))
        return _single(self.environment.final), float(rewards[0]), False, bool(truncated[0]), {}


class MachineVectorEnv(VectorEnv[Array, Array, Array]):
    """All copies of an environment; when an episode ends, the next one begins in the same step (``SAME_STEP``)."""

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(self, environment: Environment, normalised: bool = False) -> None:
        self.environment, self.normalised, self.num_envs = environment, normalised, environment.size
        self.single_observation_space, self.single_action_space = spaces(environment, normalised)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Random starts and targets in all copies."""
        super().reset(seed=seed)
        if options:
            raise SettingsError("MachineVectorEnv.reset", f"options {sorted(options)}", "none")
        if seed is not None:
            self.environment.seed(seed)
        return self.environment.reset().astype(np.float32), {}

    def step(self, actions: npt.ArrayLike) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """One step of all copies; ``final_obs`` holds the last observations of episodes that ended."""
        wanted = np.asarray(actions, dtype=np.float64)
        seen, rewards, truncated = self.environment.step(setpoints(self.environment, wanted, self.normalised))
        infos: dict[str, Any] = {}
        if truncated.any():
            final = np.where(truncated[:, None], self.environment.final, 0.0).astype(np.float32)
            infos = {"final_obs": final, "_final_obs": truncated.copy()}
        return seen.astype(np.float32), rewards, np.zeros_like(truncated), truncated, infos


def spaces(environment: Environment, normalised: bool) -> tuple[Box, Box]:
    """Spaces of observations and of actions."""
    low, high = environment.observation_low, environment.observation_high
    room = ROOM * (high - low)
    low, high = low - room, high + room
    basic = environment.actions + 6
    low[basic:], high[basic:] = -np.inf, np.inf  # speeds and sway have no bounds
    acts = np.ones(environment.actions)
    bounds = (-acts, acts) if normalised else (environment.action_low, environment.action_high)
    return (
        Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32),
        Box(bounds[0].astype(np.float32), bounds[1].astype(np.float32), dtype=np.float32),
    )


def setpoints(environment: Environment, actions: Array, normalised: bool) -> Array:
    """Actions as joint setpoints (n, A)."""
    if not normalised:
        return actions
    low, high = environment.action_low, environment.action_high
    return np.asarray(0.5 * (low + high) + 0.5 * (high - low) * actions)


def _single(observations: Array) -> Observation:
    return np.asarray(observations[0], dtype=np.float32)
