"""Logs of a lift of one axis: four recordings of the same strokes, each with its own noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

MACHINE = """
schema = 1
name = "lift"
rate_hz = 50.0
[[axes]]
name = "boom"
actuation = "velocity"
drives = "joint"
gain = 0.3
limits = [-1.0, 1.0]
"""

Array = npt.NDArray[np.float64]


def write_lift(folder: Path, levels: Sequence[float], sensor: Callable[[Array], Array] = lambda joint: joint) -> Path:
    """``machine.toml`` and ``logs/`` in ``folder``: commands at ``levels``, 2 s each; joints [rad] as ``sensor`` gives them."""
    (folder / "machine.toml").write_text(MACHINE)
    command = np.repeat(levels, 100)
    joint = np.concatenate([[0.0], np.cumsum(0.3 * command[:-1]) / 50.0]) - 0.3
    for number in range(4):
        noise = np.random.default_rng(number).normal(0.0, 1e-3, len(command))
        measured = sensor(joint + noise)
        table = {"time": np.arange(len(command)) / 50.0, "boom.command": command, "boom.joint [rad]": measured}
        (folder / "logs" / f"run-{number}").mkdir(parents=True)
        pd.DataFrame(table).to_csv(folder / "logs" / f"run-{number}" / "log.csv", index=False)
    return folder
