"""Logs of a lift of one axis with a linkage, whose valve has a dead-band that its description lacks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from sample_crane import commands

from sysid.machine import Linkage, TriangleLinkage

MACHINE = """
schema = 1
name = "lift"
rate_hz = 50.0
[noise]
"boom.cylinder" = 2e-5
"boom.joint" = 2e-4
[[axes]]
name = "boom"
actuation = "velocity"
drives = "cylinder"
gain = 0.03
stroke = [0.0, 0.3]
limits = [-0.4, 1.2]
"""
RECIPE = "[actuator]\nsamples = 300\nhidden_of = {boom = [16, 16]}\n[actuator.training]\nlearning_rate = 3e-3\nepochs = 400\n"
LINKAGE = TriangleLinkage(Linkage("triangle", a=0.15, b=0.4, offset=1.1, retracted=0.3))
DEADBAND = (0.11, 0.07)


def write_logs(folder: Path) -> None:
    for number in range(4):
        rng = np.random.default_rng(number)
        u = commands(24.0, 50.0, seed=number + 10)["boom"]
        flow = np.where(u > DEADBAND[0], u - DEADBAND[0], np.where(u < -DEADBAND[1], u + DEADBAND[1], 0.0))
        cylinder = 0.1 + np.concatenate([[0.0], np.cumsum(0.03 * flow[:-1]) / 50.0])
        table = pd.DataFrame(
            {
                "time": np.arange(len(u)) / 50.0,
                "boom.command": u,
                "boom.cylinder [mm]": 1e3 * (cylinder + rng.normal(0.0, 2e-5, len(u))),
                "boom.joint [deg]": np.degrees(LINKAGE.joint(cylinder) + rng.normal(0.0, 2e-4, len(u))),
            }
        )
        (folder / f"run-{number}").mkdir(parents=True)
        table.to_csv(folder / f"run-{number}" / "log.csv", index=False)
