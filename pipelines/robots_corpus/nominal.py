"""A log without a gap: recordings of a machine's own nominal simulation, in a process of its own.

    python -m robots_corpus.nominal MACHINE.toml LOGS

Every axis follows a sine within its limits, from rest. Axes that positions or speeds drive are simulated from their commands;
for axes that forces drive the forces are those that the plant needs for the sine, since an arm under given forces drifts.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from robots_corpus.corpus import SEED
from sysid.datasets.recording import Recording
from sysid.machine.description import Axis, Machine, load_machine
from sysid.plant import Model, compile_plant, free_run, nominal_plant
from sysid.plant.arm_forces import arm_forces

Array = npt.NDArray[np.float64]

RECORDINGS, SECONDS = 3, 12.0
#: At rest at the start [s], and time until the sine has its whole amplitude [s].
REST, RISE = 1.0, 2.0
#: Share of the range that a sine covers, its largest amplitude [rad or m], and the largest command of a speed axis.
SHARE, LARGEST, SPEED = 0.3, 0.5, 0.5
#: Standard deviation of the joint sensors [rad or m].
NOISE = 1e-4
#: A loaded servo rests beside its command: most runs until the start does so, and the change below which it does [rad or m].
SETTLING, SETTLED = 30, 1e-7


@dataclass(frozen=True)
class Sine:
    """``q(t) = middle + amplitude·w(t)·sin(2π·frequency·(t − REST))``, with a window ``w`` that rises from zero."""

    middle: float
    amplitude: float
    frequency: float

    def values(self, time: Array) -> tuple[Array, Array, Array]:
        """Position, speed and acceleration, (n,) each."""
        t, w = np.maximum(time - REST, 0.0), 2.0 * math.pi * self.frequency
        s = np.minimum(t / RISE, 1.0)
        window, slope, bend = s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2 / RISE, np.zeros_like(t)
        bend[s < 1.0] = (60 * s * (1 - s) * (1 - 2 * s) / RISE**2)[s < 1.0]
        sin, cos = np.sin(w * t), w * np.cos(w * t)
        q = self.amplitude * window * sin
        v = self.amplitude * (slope * sin + window * cos)
        a = self.amplitude * (bend * sin + 2.0 * slope * cos - window * w**2 * sin)
        return self.middle + q, v, a


def sine_of(axis: Axis, number: int, draw: np.random.Generator) -> Sine:
    """A sine for an axis; each has a frequency of its own, so that axes can be distinguished."""
    low, high = (-1.0, 1.0) if axis.limits is None else axis.limits
    low, high = max(low, -math.pi), min(high, math.pi)
    frequency = 0.15 + 0.04 * (number % 6) + 0.02 * draw.random()
    amplitude = min(0.5 * SHARE * (high - low), LARGEST)
    if axis.actuation == "velocity":
        amplitude = min(amplitude, SPEED * axis.gain / (2.0 * math.pi * frequency))
    middle = 0.5 * (low + high) + (draw.random() - 0.5) * (1.0 - SHARE) * 0.5 * (high - low)
    return Sine(middle, amplitude, frequency)


def recording(model: Model, number: int) -> pd.DataFrame:
    """``time``, commands and joints of one recording."""
    machine, draw = model.machine, np.random.default_rng([SEED, number])
    time = np.arange(round(SECONDS * machine.rate_hz)) / machine.rate_hz
    sines = [sine_of(axis, k, draw) for k, axis in enumerate(machine.axes)]
    q, v, a = (np.column_stack(columns) for columns in zip(*(sine.values(time) for sine in sines), strict=True))
    commands, joints = q.copy(), q.copy()
    for k, axis in enumerate(machine.axes):
        if axis.actuation == "velocity":
            commands[:, k] = v[:, k] / axis.gain
    if any(axis.actuation != "force" for axis in machine.axes):
        joints = simulated(model, time, commands, joints)
    forced = [k for k, axis in enumerate(machine.axes) if axis.actuation == "force"]
    if forced:
        v, a = np.gradient(joints, time, axis=0), np.gradient(np.gradient(joints, time, axis=0), time, axis=0)
        _, v[:, forced], a[:, forced] = (np.column_stack(c) for c in zip(*(sines[k].values(time) for k in forced), strict=True))
        commands[:, forced] = arm_forces(model, model.theta, joints, v, a, 1.0 / machine.rate_hz)[:, forced]
    return table(machine, time, commands, joints + draw.normal(0.0, NOISE, joints.shape))


def simulated(model: Model, time: Array, commands: Array, joints: Array) -> Array:
    """Joints (n, A) of the plant's free run; those of force axes stay."""
    found, rest = joints.copy(), round(0.8 * REST * model.machine.rate_hz)
    for _ in range(SETTLING):
        start, before = found.copy(), found[rest].copy()
        start[:rest] = found[rest]
        run = free_run(model, Recording("run", table(model.machine, time, commands, start), model.machine.rate_hz))
        for k, axis in enumerate(model.machine.axes):
            if axis.actuation != "force":
                found[:, k] = run[f"{axis.name}.joint"].to_numpy()
        if np.abs(found[rest] - before).max() < SETTLED:
            break
    return found


def table(machine: Machine, time: Array, commands: Array, joints: Array) -> pd.DataFrame:
    columns = {"time": time}
    for k, name in enumerate(machine.axis_names):
        columns[f"{name}.command"], columns[f"{name}.joint"] = commands[:, k], joints[:, k]
    return pd.DataFrame(columns)


def write_logs(machine: Machine, logs: Path) -> None:
    """One folder a recording."""
    model = compile_plant(nominal_plant(machine))
    for number in range(RECORDINGS):
        folder = logs / f"run-{number + 1}"
        folder.mkdir(parents=True, exist_ok=True)
        recording(model, number).to_csv(folder / "log.csv", index=False)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("machine", type=Path)
    parser.add_argument("logs", type=Path)
    given = parser.parse_args()
    write_logs(load_machine(given.machine), given.logs)
    print(json.dumps({}))
