"""Rows of the trainer: updates a second beside Stable-Baselines3's DDPG, equal batch, networks and buffer, one thread each.

Both draw a batch from a full buffer and update critic, actor and targets; nothing is acted. Networks of SB3: its own MlpPolicy.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.rows import in_turns, row

#: Batch, hidden layers, updates of one measurement.
CASES = ((1024, (400, 300), 20), (256, (256, 256), 100), (64, (64, 64), 400))
ROWS, OBSERVED, ACTIONS = 20_000, 10, 4
REPEATS = 9
RATE, DISCOUNT, TAU = 1e-3, 0.99, 1e-3

#: Observations (n, O), actions (n, A), rewards (n,) and next observations (n, O).
Transitions = tuple[Any, Any, Any, Any]
#: Makes so many updates.
Updates = Callable[[int], None]


def training_rows() -> list[dict[str, Any]]:
    """One row a case."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        return [_case(*case) for case in CASES]
    finally:
        torch.set_num_threads(threads)


def _case(batch: int, hidden: tuple[int, ...], updates: int) -> dict[str, Any]:
    rows = transitions()
    ours, theirs = ours_on("cpu", batch, hidden, rows), sb3_on("cpu", batch, hidden, rows)
    taken = in_turns({"ours": lambda: ours(updates), "theirs": lambda: theirs(updates)}, REPEATS)
    per_second = {name: [updates / t for t in times] for name, times in taken.items()}
    size = "-".join(map(str, hidden))
    return row(
        f"ddpg_update_{batch}_{size}", "Stable-Baselines3", per_second["ours"], per_second["theirs"], "updates/s",
        "drawing the batch included, one thread each", more_is_better=True,
    )  # fmt: skip


def transitions() -> Transitions:
    """A full buffer: observations, actions, rewards, next observations."""
    rng = np.random.default_rng(0)
    s, following = (rng.uniform(-1.0, 1.0, (ROWS, OBSERVED)) for _ in range(2))
    return s, rng.uniform(-1.0, 1.0, (ROWS, ACTIONS)), rng.normal(size=ROWS), following


def ours_on(device: str, batch: int, hidden: tuple[int, ...], rows: Transitions, graph: bool = True) -> Updates:
    """Makes so many updates, and waits for the device.

    Args:
        graph: on a GPU, as a CUDA graph, as :class:`sysid_rl.train.ddpg.Trainer` does.
    """
    import torch

    from sysid_rl.train.agent import Agent, Space
    from sysid_rl.train.recipe import Learning, Networks
    from sysid_rl.train.repeated import Repeated
    from sysid_rl.train.replay import Replay

    one, four = np.ones(OBSERVED), np.ones(ACTIONS)
    space = Space(-one, one, -four, four, (False,) * ACTIONS, (4, 7), (7, 10))
    learning = Learning(batch=batch, discount=DISCOUNT, tau=TAU, actor_rate=RATE, critic_rate=RATE)
    agent = Agent(space, Networks(hidden, hidden), learning, np.random.default_rng(0), device)
    replay, rng = Replay(ROWS, OBSERVED, ACTIONS, device), np.random.default_rng(1)
    chosen = torch.zeros(batch, dtype=torch.long, device=device)
    room = torch.empty((batch, replay.width), device=device)
    replay.add(*rows)

    def once() -> None:
        s, a, r, following = (replay.take(chosen, room)[:, part] for part in replay.columns)
        agent.update(s, a, r[:, 0], following)

    learn = Repeated(once, agent.device) if graph else once

    def run(updates: int) -> None:
        for _ in range(updates):
            chosen.copy_(replay.draw(batch, rng))
            learn()
        if agent.device.type == "cuda":
            torch.cuda.synchronize()

    return run


def sb3_on(device: str, batch: int, hidden: tuple[int, ...], rows: Transitions) -> Updates:
    """Stable-Baselines3."""
    import torch
    from stable_baselines3 import DDPG

    train = _filled(DDPG, batch, hidden, rows, device=device)

    def run(updates: int) -> None:
        train(updates)
        if device == "cuda":
            torch.cuda.synchronize()

    return run


def sbx_on(batch: int, hidden: tuple[int, ...], rows: Transitions) -> Updates:
    """SBX, Stable-Baselines3's interface in JAX, on JAX's own choice of device; all updates of a call are one program."""
    import jax
    from sbx import DDPG

    train = _filled(DDPG, batch, hidden, rows)

    def run(updates: int) -> None:
        jax.block_until_ready(train(updates).policy.actor_state.params)

    return run


def _filled(algorithm: Any, batch: int, hidden: tuple[int, ...], rows: Transitions, **settings: Any) -> Callable[[int], Any]:
    """A learner of either library with a full buffer: makes so many updates and returns itself."""
    import gymnasium
    from stable_baselines3.common.logger import configure

    class Nowhere(gymnasium.Env[Any, Any]):
        observation_space = gymnasium.spaces.Box(-1.0, 1.0, (OBSERVED,), np.float32)
        action_space = gymnasium.spaces.Box(-1.0, 1.0, (ACTIONS,), np.float32)

    model = algorithm(
        "MlpPolicy", Nowhere(), batch_size=batch, gamma=DISCOUNT, tau=TAU, learning_rate=RATE, buffer_size=ROWS,
        policy_kwargs={"net_arch": list(hidden)}, **settings,
    )  # fmt: skip
    model.set_logger(configure(None, []))
    s, a, r, following = (values.astype(np.float32) for values in rows)
    for k in range(ROWS):
        model.replay_buffer.add(s[k], following[k], a[k], r[k : k + 1], np.zeros(1), [{}])

    def train(updates: int) -> Any:
        model.train(gradient_steps=updates, batch_size=batch)
        return model

    return train
