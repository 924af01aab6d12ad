"""Rows of the trainer: updates a second beside Stable-Baselines3's DDPG, equal batch, networks and buffer, one thread each.

Both draw a batch from a full buffer and update critic, actor and targets; nothing is acted. Networks of SB3: its own MlpPolicy.
"""

from __future__ import annotations

import sys
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
    rng = np.random.default_rng(0)
    s, following = (rng.uniform(-1.0, 1.0, (ROWS, OBSERVED)) for _ in range(2))
    a, r = rng.uniform(-1.0, 1.0, (ROWS, ACTIONS)), rng.normal(size=ROWS)
    ours, theirs = _ours(batch, hidden, (s, a, r, following)), _theirs(batch, hidden, (s, a, r, following))
    taken = in_turns({"ours": lambda: ours(updates), "theirs": lambda: theirs(updates)}, REPEATS)
    per_second = {name: [updates / t for t in times] for name, times in taken.items()}
    size = "-".join(map(str, hidden))
    return row(
        f"ddpg_update_{batch}_{size}", "Stable-Baselines3", per_second["ours"], per_second["theirs"], "updates/s",
        "drawing the batch included, one thread each", more_is_better=True,
    )  # fmt: skip


def _ours(batch: int, hidden: tuple[int, ...], rows: tuple[Any, ...]) -> Any:
    import torch

    from sysid.rl.agent import Agent, Space
    from sysid.rl.recipe import Learning, Networks
    from sysid.rl.replay import Replay

    one, four = np.ones(OBSERVED), np.ones(ACTIONS)
    space = Space(-one, one, -four, four, (False,) * ACTIONS, (4, 7), (7, 10))
    learning = Learning(batch=batch, discount=DISCOUNT, tau=TAU, actor_rate=RATE, critic_rate=RATE)
    agent = Agent(space, Networks(hidden, hidden), learning, np.random.default_rng(0), "cpu")
    replay, rng, room = (
        Replay(ROWS, OBSERVED, ACTIONS),
        np.random.default_rng(1),
        torch.empty(batch, 2 * OBSERVED + ACTIONS + 1),
    )
    replay.add(*rows)

    def run(updates: int) -> None:
        for _ in range(updates):
            drawn = replay.sample(batch, rng, room)
            s, a, r, following = (drawn[:, part] for part in replay.columns)
            agent.update(s, a, r[:, 0], following)

    return run


def _theirs(batch: int, hidden: tuple[int, ...], rows: tuple[Any, ...]) -> Any:
    import gymnasium
    from stable_baselines3 import DDPG
    from stable_baselines3.common.logger import configure

    class Nowhere(gymnasium.Env[Any, Any]):
        observation_space = gymnasium.spaces.Box(-1.0, 1.0, (OBSERVED,), np.float32)
        action_space = gymnasium.spaces.Box(-1.0, 1.0, (ACTIONS,), np.float32)

    model = DDPG(
        "MlpPolicy", Nowhere(), batch_size=batch, gamma=DISCOUNT, tau=TAU, learning_rate=RATE, buffer_size=ROWS,
        policy_kwargs={"net_arch": list(hidden)}, device="cpu",
    )  # fmt: skip
    model.set_logger(configure(None, []))
    s, a, r, following = (values.astype(np.float32) for values in rows)
    for k in range(ROWS):
        model.replay_buffer.add(s[k], following[k], a[k], r[k : k + 1], np.zeros(1), [{}])

    def run(updates: int) -> None:
        model.train(gradient_steps=updates, batch_size=batch)

    return run
