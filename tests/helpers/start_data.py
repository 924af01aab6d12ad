"""Recordings cut out of a longer motion of a machine that equals the plant: nothing is known of what was before them.

The axes are simulated without the plant, in steps of 1 ms: dead time, lag, gain, integral. Tip and tool are the plant's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt
import pandas as pd
from plant_data import arm, steered
from scipy import signal, stats

from sysid.datasets.recording import Recording
from sysid.machine import KnownEffect
from sysid.plant import Plant, compile_plant, nominal_plant
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]
Begun = Literal["at rest", "in motion", "before the actuator moves", "in mid-swing"]
BEGUN: tuple[Begun, ...] = ("at rest", "in motion", "before the actuator moves", "in mid-swing")

RATE_HZ, FINE = 100.0, 10
#: What the machine does before the recording begins [s].
BEFORE = 15.0
NOISE = {
    "slew.joint": 5e-4,
    "boom.cylinder": 2e-4,
    "boom.joint": 5e-4,
    "wrist.joint": 5e-4,
    **dict.fromkeys(point_signals("ee"), 2e-4),
    **dict.fromkeys(point_signals("tool"), 5e-4),
}


def started(begun: Begun, seed: int, seconds: float = 60.0) -> tuple[Plant, Recording]:
    """A plant with random lags, dead times and pendulum, and a recording of a machine that equals it."""
    rng = np.random.default_rng([BEGUN.index(begun), seed])
    plant = nominal_plant(arm())
    lags, delays = rng.uniform(0.0, 0.2, 3), rng.uniform(0.0, 0.3, 3).round(3)
    delays[2] = delays[2].round(2)  # a set-point steps at a sample
    for axis, lag, delay in zip(plant.machine.axis_names, lags, delays, strict=True):
        plant = plant.with_effect(KnownEffect("first_order_lag", axis, {"time_constant": float(lag)}))
        plant = plant.with_effect(KnownEffect("input_delay", axis, {"delay": float(delay)}))
    sway = {"length": float(rng.uniform(0.15, 0.35)), "damping_ratio": float(rng.uniform(0.01, 0.08))}
    plant = plant.with_effect(KnownEffect("gripper_sway", "tool", sway))
    count, first = round((BEFORE + seconds) * RATE_HZ), round(BEFORE * RATE_HZ)
    commands = _commands(count, rng)
    if begun == "at rest":
        commands[: first + 50] = commands[first + 50]
        commands[: first + 50, :2] = 0.0
    elif begun == "before the actuator moves":
        commands[:first] = [0.0, 0.0, commands[first - 1, 2]]
        commands[first : first + 80, :2] = rng.choice([-0.8, -0.4, 0.4, 0.8], 2)
    elif begun == "in mid-swing":  # the valves have been closed for a second, the tool still swings
        commands[first - 100 : first, :2] = 0.0
    motion = [_moved(commands[:, i], i, plant, lags[i], delays[i]) for i in range(3)]
    model, time = compile_plant(plant), np.arange(count) / RATE_HZ
    table = {"time": time, **{axis_signal(a, "command"): commands[:, i] for i, a in enumerate(plant.machine.axis_names)}}
    table |= {axis.driven: motion[i] for i, axis in enumerate(plant.machine.axes)}
    whole = Recording("whole", pd.DataFrame(table), RATE_HZ)
    table["boom.joint"] = model.joint(model.theta[None], whole, "boom")[0]
    table |= dict(zip(point_signals("ee"), model.tip(model.theta[None], _with(whole, table))[0].T, strict=True))
    table |= dict(zip(point_signals("tool"), model.tool(model.theta[None], _with(whole, table))[0].T, strict=True))
    cut = {name: values[first:] + rng.normal(0.0, NOISE.get(name, 0.0), count - first) for name, values in table.items()}
    return plant, Recording(begun, pd.DataFrame(cut | {"time": time[: count - first]}), RATE_HZ)


def excess(errors: Mapping[str, float], floors: Mapping[str, float]) -> float:
    """Squared errors of a recording beyond those of its noise floors, in squared standard deviations of noise, of all signals.

    The floor of a signal is the root of an expectation, so that this is zero on the average, while the error of one recording
    whose start is uncertain scatters about its floor without a bound of its own. The signals of a recording share its start and
    are not independent; recordings of different machines are.
    """
    return sum((errors[name] ** 2 - floor**2) / NOISE[name] ** 2 for name, floor in floors.items())


def beyond_chance(found: Sequence[float]) -> float:
    """Mean of independent excesses over its largest size by chance (Student's t, two-sided 1 %): beyond ±1 it is not zero."""
    error = float(np.std(found, ddof=1)) / math.sqrt(len(found))
    return float(np.mean(found)) / (error * float(stats.t.ppf(0.995, len(found) - 1)))


def _with(recording: Recording, table: dict[str, Array]) -> Recording:
    return Recording(recording.name, pd.DataFrame(table), recording.rate_hz)


def _commands(count: int, rng: np.random.Generator) -> Array:
    time = np.arange(count) / RATE_HZ
    wrist = sum(np.sin(2 * np.pi * f * rng.uniform(0.8, 1.2) * time + rng.uniform(0, 6.28)) for f in (0.11, 0.3))
    steps = rng.uniform(-0.3, 0.3, count // 150 + 1).repeat(150)[:count]
    slew, boom = steered(count, RATE_HZ, 0.436, 1.2, rng), steered(count, RATE_HZ, 0.025, 0.02, rng)
    return np.column_stack([slew, boom, 0.4 * np.asarray(wrist) + steps])


def _moved(command: Array, i: int, plant: Plant, lag: float, delay: float) -> Array:
    """What a command at 100 Hz moves, (n,)."""
    axis, h = plant.machine.axes[i], 1.0 / RATE_HZ / FINE
    position = axis.actuation == "position"
    fine = np.repeat(command, FINE)
    late = np.concatenate([np.full(round(delay / h), command[0]), fine])[: len(fine)]
    kept = math.exp(-h / lag)
    passed = signal.lfilter([1.0 - kept], [1.0, -kept], late[:-1] - late[0]) + late[0]
    valve = np.concatenate([late[:1], passed])
    if position:
        return valve[::FINE]
    mean = np.append(0.5 * (valve[1:] + valve[:-1]), valve[-1])
    place = np.concatenate([[0.0], np.cumsum(axis.gain * h * mean)[:-1]])
    return np.asarray((0.06 if axis.drives == "cylinder" else 0.0) + place[::FINE])
