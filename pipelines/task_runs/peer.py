"""Stable-Baselines3 in the environment of the residual policies, with its own defaults and the processor time of ours."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.networks.forward import ForwardModel
from sysid.networks.policy import PolicyNetwork
from sysid.plant import Plant
from sysid_rl.train.gym import MachineEnv
from sysid_rl.train.recipe import TrainingRecipe
from sysid_rl.train.training import environments

Array = npt.NDArray[np.float64]

#: Steps between two looks at the clock.
CHECK_STEPS = 500


@dataclass(frozen=True)
class PeerNetwork:
    """The peer's policy in the place of ours: the same observations and actions.

    Args:
        like: a policy of the same recipe.
        model: of the peer.
    """

    like: PolicyNetwork
    model: Any

    @property
    def steps(self) -> int:
        """Steps of the environment that it was trained for."""
        return int(self.model.num_timesteps)

    @property
    def inputs(self) -> tuple[str, ...]:
        return self.like.inputs

    @property
    def residual(self) -> Any:
        return self.like.residual

    def act(self, observations: npt.ArrayLike) -> Array:
        seen = self.like.mlp.inputs.apply(np.asarray(observations, dtype=np.float64)).astype(np.float32)
        return np.asarray(self.model.predict(seen, deterministic=True)[0], dtype=np.float64)


def trained(recipe: TrainingRecipe, plant: Plant, forward: ForwardModel, like: PolicyNetwork, cpu_s: float) -> PeerNetwork:
    """SAC after ``cpu_s`` seconds of processor time, one copy of the machine, observations scaled as for ours."""
    import gymnasium
    import torch
    from stable_baselines3 import SAC

    torch.set_num_threads(1)
    one = replace(recipe, setting=replace(recipe.setting, copies=1))
    environment, _ = environments(one, plant, forward, evaluation_copies=1)
    environment.spread = recipe.setting.spread
    scale = like.mlp.inputs

    def scaled(seen: Any) -> Any:
        return scale.apply(np.asarray(seen, dtype=np.float64)[None])[0].astype(np.float32)

    wide = np.full(environment.observations, np.inf, dtype=np.float32)
    inner = gymnasium.wrappers.TransformObservation(MachineEnv(environment), scaled, gymnasium.spaces.Box(-wide, wide))
    model = SAC("MlpPolicy", inner, seed=recipe.seed, device="cpu")
    begin = time.process_time()
    while time.process_time() - begin < cpu_s:
        model.learn(CHECK_STEPS, reset_num_timesteps=False, log_interval=None)
    return PeerNetwork(like, model)
