"""The shipped crane with every effect that it can have, and its commands."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets import Recording
from sysid.effects import CATALOGUE, Effect
from sysid.machine import KnownEffect, Machine, TriangleLinkage, load_machine
from sysid.machine.description import Linkage
from sysid.plant import Plant, free_run, nominal_plant
from sysid.signals import point_signals

Array = npt.NDArray[np.float64]

FOLDER = Path(__file__).resolve().parents[2] / "datasets" / "autolog"
RATE = 100.0
#: One magnitude for each effect of an axis driven by a valve, as a crane of this size has it (SI).
AMOUNTS: dict[str, dict[str, float | list[float]]] = {
    "input_delay": {"delay": 0.0413},
    "valve_hysteresis": {"width": 0.03},
    "valve_deadband": {"positive": 0.12, "negative": 0.10},
    "gain_curve": {"exponent": 1.2},
    "flow_saturation": {"limit": 0.75},
    "command_rate_limit": {"rate": 5.0},
    "first_order_lag": {"time_constant": 0.05},
    "gain_error": {"ratio": 0.92},
    "asymmetric_gain": {"ratio": 0.95},
    "temperature_drift": {"fraction": 0.1, "time_constant": 600.0},
    "load_dependent_flow": {"coefficient": 0.002},
    "internal_leakage": {"rate": 2e-5},
    "stiction": {"breakaway": 0.05, "release": 0.02},
    "oil_compressibility": {"frequency": 8.0, "damping_ratio": 0.15},
    "pump_flow_limit": {"limit": 1.5},
    "backlash": {"width": 0.005},
    "joint_compliance": {"compliance": 5e-5},
    "joint_offset": {"offset": 0.01},
    "link_length_error": {"error": 0.003},
    "base_misalignment": {"translation": [0.002, -0.003, 0.001], "rotation": [0.01, -0.01, 0.02]},
    "gripper_sway": {"length": 0.22, "damping_ratio": 0.04},
    "sensor_scale": {"scale": 1.001},
    "sensor_bias": {"bias": 0.001},
    "sensor_quantisation": {"step": 1e-5},
    "clock_skew": {"skew": 40.0},
    "clock_offset": {"offset": 0.012},
}
#: What the motion capture of this machine sees: the effects of its clock act on these.
STREAMS = {"mocap": ("slew.joint", "boom.joint", "stick.joint", "ee.x", "ee.y", "ee.z", "tool.x", "tool.y", "tool.z")}
#: Main frequency of each axis' command [Hz]: slow enough to use the range, none a multiple of another.
_FREQUENCIES = np.array([0.05, 0.1, 0.13, 0.17])


def crane() -> Plant:
    """The nominal plant with the linkages of the drawing and every effect at a value that is not neutral."""
    machine = load_machine(FOLDER / "machine.toml")
    drawing = tomllib.loads((FOLDER / "bench.toml").read_text("utf-8"))["axes"]
    linkages = {}
    for axis in machine.axes:
        if axis.drives == "cylinder":
            sizes = {key: value for key, value in drawing[axis.name]["cylinder"].items() if key != "stroke"}
            linkages[axis.name] = TriangleLinkage(Linkage(kind="triangle", **sizes))
    plant = nominal_plant(machine, linkages, STREAMS)
    for effect in (e for e in CATALOGUE if not e.of_links and not e.described_only):  # of other machines
        for target in targets(machine, effect):
            if effect.name not in AMOUNTS:
                raise SystemExit(f"no magnitude for {effect.name}: add one to AMOUNTS in {Path(__file__).name}")
            for side in effect.sides or (None,):
                plant = plant.with_effect(KnownEffect(effect.name, target, AMOUNTS[effect.name], side))
    return plant


def targets(machine: Machine, effect: Effect) -> tuple[str, ...]:
    """Everything on this machine that can have the effect."""
    if effect.target == "axis":
        return tuple(a.name for a in machine.axes if not effect.actuations or a.actuation in effect.actuations)
    if effect.target == "signal":
        return read(machine)
    return tuple(STREAMS) if effect.target == "stream" else (effect.target,)


def read(machine: Machine) -> tuple[str, ...]:
    """Every signal that the plant predicts."""
    sensors = [axis.driven for axis in machine.axes if axis.drives == "cylinder"]
    return (*sensors, *(f"{axis.name}.joint" for axis in machine.axes), *point_signals("ee"), *point_signals("tool"))


def commands(seconds: float) -> Array:
    """Smooth to and fro of all axes at once, with a quick part on top: (n, 4) in [−1, 1]."""
    t = np.arange(round(seconds * RATE))[:, None] / RATE
    return np.asarray(0.75 * np.cos(2 * np.pi * _FREQUENCIES * t) + 0.2 * np.sin(2 * np.pi * 7.3 * _FREQUENCIES * t))


def recorded(plant: Plant, seconds: float) -> Recording:
    """What a log of this plant would hold: commands and every signal that it predicts, begun in the middle of all ranges."""
    commanded = commands(seconds)
    table: dict[str, Array] = {"time": np.arange(len(commanded)) / RATE}
    for i, axis in enumerate(plant.machine.axes):
        table[f"{axis.name}.command"] = commanded[:, i]
        table[axis.driven] = np.where(table["time"] < 1.0, 0.5 * sum(axis.range), np.nan)
    begun = Recording("begun", pd.DataFrame(table), RATE)
    return Recording("recorded", begun.table.assign(**{str(k): v for k, v in free_run(plant, begun).items()}), RATE)


def middle(machine: Machine) -> Array:
    """Joint positions in the middle of all ranges, (4,)."""
    return np.array([0.5 * sum(axis.limits or (0.0, 0.0)) for axis in machine.axes])


def joint_speeds(machine: Machine) -> Array:
    """Speed of each joint at command 1, where a cylinder drives it the mean over its range, (4,)."""
    return np.array([a.gain * np.ptp(a.limits or (0.0, 0.0)) / np.ptp(a.range) for a in machine.axes])
