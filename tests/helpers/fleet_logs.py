"""Logs of a fleet of lifts whose valves have a dead-band: one differs, one drifts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import lift_logs
import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets import ingest

MACHINE = lift_logs.MACHINE.replace("[-1.0, 1.0]", "[-3.0, 3.0]")
RATE, SECONDS = 50.0, 40.0

Array = npt.NDArray[np.float64]


def write_fleet(folder: Path, machines: Mapping[str, Sequence[float]]) -> Path:
    """A workspace with a dataset for each machine.

    Args:
        machines: name → dead-band of its valve in each recording, the same on both sides.
    """
    for number, (name, bands) in enumerate(machines.items()):
        logs = folder / "logs" / name
        logs.mkdir(parents=True)
        (logs / "machine.toml").write_text(MACHINE)
        for k, band in enumerate(bands):
            (logs / f"run-{k:02d}").mkdir()
            recorded(band, 100 * number + k).to_csv(logs / f"run-{k:02d}" / "log.csv", index=False)
        ingest(logs, folder / "workspace", name=name)
    return folder / "workspace"


def one_lift(root: Path, count: int = 4) -> Path:
    """The folder of one lift with ``count`` recordings."""
    root.mkdir(parents=True)
    (root / "machine.toml").write_text(MACHINE)
    for k in range(count):
        (root / f"run-{k}").mkdir()
        recorded(0.08, k).to_csv(root / f"run-{k}" / "log.csv", index=False)
    return root


def recorded(band: float, seed: int) -> pd.DataFrame:
    """One recording: steps of all sizes, ramps through zero; the joint follows with a dead-band."""
    rng = np.random.default_rng(seed)
    n = round(SECONDS * RATE)
    steps = np.repeat(rng.uniform(-0.5, 0.5, n // 50), 50)
    ramp = 0.25 * np.sin(2.0 * np.pi * 0.2 * np.arange(n) / RATE + rng.uniform(0.0, 6.0))
    command = np.where((np.arange(n) // 250) % 2 == 0, steps, ramp)
    flow = np.sign(command) * np.maximum(np.abs(command) - band, 0.0)
    joint = np.concatenate([[0.0], np.cumsum(0.3 * flow[:-1]) / RATE]) + rng.normal(0.0, 5e-4, n)
    return pd.DataFrame({"time": np.arange(n) / RATE, "boom.command": command, "boom.joint [rad]": joint})
