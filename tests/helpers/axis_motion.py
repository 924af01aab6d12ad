"""Recordings of a machine with valve axes, each of which moves in some of them only."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from sysid.datasets import Recording
from sysid.machine import Machine, load_machine

RATE = 50.0
AXES_OF_TEST = ("boom", "stick")
#: Commands of a period of strokes [each 1 s]: both directions, small and large, with rests.
STROKES = (0.9, -0.9, 0.0, 0.3, -0.3, 0.3, -0.3, 0.9, -0.9, 0.0)


def machine_text(axes: Sequence[str]) -> str:
    lines = ["schema = 1", 'name = "lift"', f"rate_hz = {RATE:g}"]
    for axis in axes:
        lines += ["[[axes]]", f'name = "{axis}"', 'actuation = "velocity"', 'drives = "joint"', "gain = 0.3"]
        lines += ["limits = [-1.0, 1.0]"]
    return "\n".join(lines) + "\n"


def machine(axes: Sequence[str], folder: Path) -> Machine:
    (folder / "machine.toml").write_text(machine_text(axes))
    return load_machine(folder / "machine.toml")


def table(seconds: float, axes: Sequence[str], moving: Sequence[str], seed: int = 0) -> pd.DataFrame:
    """Every axis of ``moving`` makes the strokes, each axis with its own phase; the others show noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * RATE)) / RATE
    columns = {"time": time}
    for place, axis in enumerate(axes):
        command = np.array(STROKES)[(np.floor(time).astype(int) + 3 * place) % len(STROKES)] * (axis in moving)
        position = np.concatenate([[0.0], np.cumsum(0.27 * command[:-1]) / RATE])
        columns[f"{axis}.command"] = command
        columns[f"{axis}.joint"] = position + rng.normal(0.0, 1e-3, len(time))
    return pd.DataFrame(columns)


def recording(name: str, seconds: float, axes: Sequence[str], moving: Sequence[str], seed: int = 0) -> Recording:
    return Recording(name, table(seconds, axes, moving, seed), RATE)


def write_logs(folder: Path, axes: Sequence[str], runs: Sequence[tuple[str, float, Sequence[str]]]) -> Path:
    """``folder/logs`` with a CSV file for each run (name, seconds, moving axes), and ``folder/machine.toml``."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "machine.toml").write_text(machine_text(axes))
    for seed, (name, seconds, moving) in enumerate(runs):
        (folder / "logs" / name).mkdir(parents=True)
        found = table(seconds, axes, moving, seed).rename(columns=lambda c: f"{c} [rad]" if c.endswith(".joint") else c)
        found.to_csv(folder / "logs" / name / "log.csv", index=False)
    return folder
