"""Stable-Baselines3's DDPG in the environment of pipelines/training.py, on the same helix, up to the accuracy of the paper."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.config import read_toml
from sysid.progress import Progress
from sysid.registry import Registry
from sysid_rl.train.kinematic import KinematicEnvironment
from sysid_rl.train.recipe import parse_training
from sysid_rl.train.tracking_task import plan_tracking
from sysid_rl.train.versions import load_versions
from trained.policies import kept
from trained.runs import PAPER, RECIPES

Array = npt.NDArray[np.float64]

#: Steps between two evaluations on the helix.
CHECK_STEPS = 2000


def peer(workspace: str, work: str, seed: int, limit: float, until: float, progress: Progress) -> dict[str, Any] | None:
    """SB3's DDPG and its progress, as :func:`trained.policies.kept` in ``work``; ``limit`` as of :func:`_trained`."""
    done = Path(work) / f"sb3-seed{seed}.json"
    return kept(done, {"seed": seed}, until, lambda: _trained(workspace, seed, limit, progress))


def _trained(workspace: str, seed: int, limit: float, progress: Progress) -> dict[str, Any]:
    """Train SB3's DDPG for ``limit`` seconds of processor time at most, at the batch and layers of the quick recipe's actor.

    Its own defaults else, with the paper's γ, τ and rates and its noise with time step 1.
    """
    import gymnasium
    import torch
    from stable_baselines3 import DDPG
    from stable_baselines3.common.noise import OrnsteinUhlenbeckActionNoise

    torch.set_num_threads(1)
    recipe = parse_training(read_toml(RECIPES / "quick.toml"), "quick")
    plant, forward = load_versions(Registry(Path(workspace)), recipe.plant, recipe.forward)
    task = plan_tracking(plant, forward, "helix")
    inner = KinematicEnvironment(plant, forward, size=1, seed=seed, task=recipe.setting.task, reach=task.reach)
    low, high = inner.observation_low, inner.observation_high
    middle, half = 0.5 * (inner.action_high + inner.action_low), 0.5 * (inner.action_high - inner.action_low)

    def seen(observations: Array) -> npt.NDArray[np.float32]:
        """Observations scaled to ±1, as SB3 recommends."""
        return np.asarray((observations - 0.5 * (high + low)) / (0.5 * (high - low)), dtype=np.float32)

    class Single(gymnasium.Env[Any, Any]):
        observation_space = gymnasium.spaces.Box(-2.0, 2.0, (inner.observations,), np.float32)
        action_space = gymnasium.spaces.Box(-1.0, 1.0, (inner.actions,), np.float32)

        def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
            super().reset(seed=seed)
            return seen(inner.reset())[0], {}

        def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
            _, rewards, truncated = inner.step(middle + half * np.asarray(action, dtype=np.float64)[None])
            return seen(inner.final)[0], float(rewards[0]), False, bool(truncated[0]), {}

    acts, layers = np.zeros(inner.actions), list(recipe.networks.actor)
    model = DDPG(
        "MlpPolicy", Single(), batch_size=recipe.learning.batch, gamma=0.99, tau=1e-3, learning_rate=1e-3,
        buffer_size=1_000_000, action_noise=OrnsteinUhlenbeckActionNoise(acts, acts + 0.1, dt=1.0),
        policy_kwargs={"net_arch": layers}, train_freq=1, gradient_steps=1, seed=seed, device="cpu",
    )  # fmt: skip

    class Actor:
        def act(self, observations: Array) -> Array:
            shares = model.predict(seen(observations), deterministic=True)[0]
            return np.asarray(middle + half * np.asarray(shares, dtype=np.float64))

    spent, marks = 0.0, []
    while spent < limit:
        begin = time.process_time()
        model.learn(CHECK_STEPS, reset_num_timesteps=False, log_interval=None)
        spent += time.process_time() - begin
        tracked = task.run("sb3", Actor())
        marks.append(
            {"step": model.num_timesteps, "cpu_seconds": spent, "rmse": tracked.rmse.tolist(), "max": tracked.worst.tolist()}
        )
        progress(min(1.0, spent / limit), f"SB3 seed {seed}")
        if all(found <= wanted for found, wanted in zip(marks[-1]["rmse"], PAPER["feedback"], strict=True)):
            break
    return {"seed": seed, "limit": limit, "updates": int(model._n_updates), "marks": marks}
