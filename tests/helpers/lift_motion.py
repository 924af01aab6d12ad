"""A lift whose joint follows its cylinder with play, moved by a valve with a dead-band and a lag: logs without files."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Dataset, Recording, Role
from sysid.machine import Linkage, Machine, TriangleLinkage, machine_from_files

Array = npt.NDArray[np.float64]

MACHINE = """
schema = 1
name = "lift"
rate_hz = 50.0
[noise]
"boom.cylinder" = 2e-5
"boom.joint" = 2e-4
[[axes]]
name = "boom"
actuation = "ACTUATION"
drives = "cylinder"
gain = 0.05
stroke = [0.0, 0.2]
limits = [-0.4, 1.2]
"""
LINKAGE = TriangleLinkage(Linkage("triangle", a=0.15, b=0.4, offset=1.1, retracted=0.3))
GAIN, DEADBAND, LAG = 0.05, 0.15, 0.1
RATE = 50.0


def lift(actuation: str = "velocity") -> Machine:
    return machine_from_files({"machine.toml": MACHINE.replace("ACTUATION", actuation)}, "lift")


def play(values: Array, width: float) -> Array:
    """``values`` (n,) behind a play."""
    out, at = np.empty_like(values), values[0]
    for k, value in enumerate(values):
        at = min(max(at, value - 0.5 * width), value + 0.5 * width)
        out[k] = at
    return out


def moved(command: Array, deadband: float = DEADBAND, lag: float = LAG) -> Array:
    """Cylinder [m] at every sample for ``command`` (n,): dead-band, first-order lag, gain, end stops."""
    position, speed, out = 0.1, 0.0, np.empty(len(command))
    for k, u in enumerate(command):
        out[k] = position
        wanted = GAIN * np.sign(u) * max(abs(u) - deadband, 0.0)
        speed = wanted if lag == 0.0 else speed + (wanted - speed) / (RATE * lag)
        position = float(np.clip(position + speed / RATE, 0.0, 0.2))
    return out


def recording(name: str, seed: int, seconds: float = 40.0, width: float = 0.0, **valve: float) -> Recording:
    """Steps of the lever that lead to and fro, with rests; ``width`` of play [m] between cylinder and joint."""
    rng = np.random.default_rng(seed)
    n = round(RATE * seconds)
    command, at, position = np.zeros(n), 0, 0.1
    while at < n:
        hold = rng.integers(10, 60)
        toward = 1.0 if rng.uniform() < (0.2 - position) / 0.2 else -1.0
        level = 0.0 if rng.uniform() < 0.2 else toward * rng.uniform(0.1, 1.0)
        command[at : at + hold] = level
        position = float(np.clip(position + GAIN * level * hold / RATE, 0.02, 0.18))
        at += hold
    cylinder = moved(command, **valve)
    table = pd.DataFrame(
        {
            "time": np.arange(n) / RATE,
            "boom.command": command,
            "boom.cylinder": cylinder + rng.normal(0.0, 2e-5, n),
            "boom.joint": LINKAGE.joint(play(cylinder, width)) + rng.normal(0.0, 2e-4, n),
        }
    )
    return Recording(name, table, RATE)


def dataset(width: float = 0.0, **valve: float) -> Dataset:
    """Two recordings to fit, one to select, one held out."""
    recordings = tuple(recording(f"run-{k}", k, width=width, **valve) for k in range(4))
    return with_roles(recordings)


def with_roles(recordings: tuple[Recording, ...], machine: Machine | None = None) -> Dataset:
    roles: dict[str, Role] = {"run-2": "select", "run-3": "held_out"}
    return Dataset.of(machine or lift(), recordings, {each.name: roles.get(each.name, "fit") for each in recordings})
