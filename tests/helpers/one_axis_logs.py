"""Logs of six seconds of a machine with one axis, for tests of what is stored."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

MACHINE = """schema = 1
name = "demo"
rate_hz = 50.0
[[axes]]
name = "a"
actuation = "velocity"
drives = "cylinder"
gain = 0.05
stroke = [0.0, 0.5]
"""


def record(folder: Path, seed: int, joint: bool = False) -> None:
    folder.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    time = np.arange(300) / 50.0
    table = pd.DataFrame(
        {"time": time, "a.command": rng.uniform(-1, 1, 300), "a.cylinder [mm]": 200 + 50 * np.sin(time + seed)}
    )
    if joint:
        table["a.joint [deg]"] = np.cos(time)
    table.to_csv(folder / "log.csv", index=False)
