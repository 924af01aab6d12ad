"""Recordings of the arm's boom with a disturbance of its speed that is not in the catalogue of effects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from plant_data import ROLES, arm_inputs, loaded_arm, measured, nominal

from sysid.datasets.recording import Dataset, Recording
from sysid.plant import compile_plant, free_run, gravity_load

Array = npt.NDArray[np.float64]
#: (speed asked for, position, load, time, random number of this step) → what is added to the speed.
Rate = Callable[[float, float, float, float, float], float]

PERIOD = 0.03
MACHINE = loaded_arm()
BASE = nominal(machine=MACHINE)
MODEL = compile_plant(BASE)
ROW = MACHINE.axis_names.index("boom")


def ripple(v: float, x: float, load: float, t: float, dice: float) -> float:
    """A speed that is uneven along the cylinder."""
    return 0.1 * v * float(np.sin(2.0 * np.pi * x / PERIOD + 0.5))


def heavy(v: float, x: float, load: float, t: float, dice: float) -> float:
    """A speed that falls with speed and load."""
    return -0.5 * load * v * abs(v)


def pulsing(v: float, x: float, load: float, t: float, dice: float) -> float:
    """A pump pulsation, independent of the motion."""
    return 0.2 * abs(v) * float(np.sin(2.0 * np.pi * 0.7 * t))


def white(v: float, x: float, load: float, t: float, dice: float) -> float:
    """A white disturbance of the speed."""
    return 0.003 * dice


def swelling(v: float, x: float, load: float, t: float, dice: float) -> float:
    """A white disturbance of 5 % of the speed."""
    return 0.05 * v * dice


def nothing(v: float, x: float, load: float, t: float, dice: float) -> float:
    return 0.0


def disturbed(name: str, rate: Rate, seed: int, seconds: float = 30.0) -> Recording:
    """A recording of the arm whose boom moves at its speed plus ``rate``; its joint and all behind it follow."""
    recording = measured(BASE, arm_inputs(name, seconds, seed), seed)
    rng = np.random.default_rng([seed, 5])
    planned = free_run(MODEL, recording)["boom.cylinder"].to_numpy()
    speed, load = np.gradient(planned, 0.01), gravity_load(MACHINE, recording)[:, ROW]
    held = np.repeat(rng.standard_normal(len(planned) // 10 + 1), 10)  # a tenth of a second each
    moved, extra = planned.copy(), 0.0
    start = rng.uniform(0.0, 10.0)  # the disturbance does not know when the recording began
    for k in range(len(planned)):
        moved[k] = planned[k] + extra
        extra += 0.01 * rate(speed[k], moved[k], load[k], 0.01 * k + start, held[k])
    joint = BASE.linkages["boom"].joint(moved)
    noise = MACHINE.noise
    columns = {
        "boom.cylinder": moved + rng.normal(0.0, noise["boom.cylinder"], len(moved)),
        "boom.joint": joint + rng.normal(0.0, noise["boom.joint"], len(moved)),
    }
    kept = [c for c in recording.table.columns if not str(c).startswith(("ee.", "tool."))]
    return replace(recording, table=recording.table[kept].assign(**columns))


def disturbed_dataset(rate: Rate, seed: int = 0, seconds: float = 30.0) -> Dataset:
    """Two recordings to fit, one to select, one held out; tip and tool are not measured."""
    recordings = tuple(disturbed(f"run-{k + 1}", rate, 10 * seed + k, seconds) for k in range(len(ROLES)))
    splits = {r.name: role for r, role in zip(recordings, ROLES, strict=True)}
    return Dataset.of(MACHINE, recordings, splits)
