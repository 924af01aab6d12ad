"""Datasets made by the plant itself, so that every parameter is known: a small arm on a slew, and a slide moved by force."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Dataset, Recording, Role
from sysid.machine import KnownEffect, Machine, machine_from_files
from sysid.plant import Plant, free_run, nominal_plant

Array = npt.NDArray[np.float64]
ROLES: tuple[Role, ...] = ("fit", "fit", "select", "held_out")

URDF = """<robot name="arm">
  <link name="base"/><link name="column"/><link name="boom"/><link name="hand"/><link name="tip"/><link name="grip"/>
  <joint name="slew_joint" type="revolute"><parent link="base"/><child link="column"/>
    <origin xyz="0 0 0.3"/><axis xyz="0 0 1"/><limit lower="-2.6" upper="2.6"/></joint>
  <joint name="boom_joint" type="revolute"><parent link="column"/><child link="boom"/>
    <origin xyz="0.05 0 0"/><axis xyz="0 -1 0"/><limit lower="-0.43" upper="1.4"/></joint>
  <joint name="wrist_joint" type="revolute"><parent link="boom"/><child link="hand"/>
    <origin xyz="0.6 0 0"/><axis xyz="0 -1 0"/><limit lower="-2.0" upper="2.0"/></joint>
  <joint name="tip_joint" type="fixed"><parent link="hand"/><child link="tip"/><origin xyz="0.25 0 0"/></joint>
  <joint name="grip_joint" type="fixed"><parent link="tip"/><child link="grip"/></joint>
</robot>
"""

_ARM = """
schema = 1
name = "arm"
rate_hz = 100.0
urdf = "arm.urdf"
tip = "tip"
tool = "grip"
[noise]
"slew.joint" = 2e-4
"boom.cylinder" = 2e-5
"boom.joint" = 3e-4
"wrist.joint" = 3e-4
"ee.x" = 1e-4
"ee.y" = 1e-4
"ee.z" = 1e-4
"tool.x" = 1e-4
"tool.y" = 1e-4
"tool.z" = 1e-4
[[axes]]
name = "slew"
joint = "slew_joint"
actuation = "velocity"
drives = "joint"
gain = 0.436
[[axes]]
name = "boom"
joint = "boom_joint"
actuation = "velocity"
drives = "cylinder"
gain = 0.025
stroke = [0.0, 0.12]
linkage = {kind = "triangle", a = 0.12, b = 0.20, offset = 0.9, retracted = 0.15, sense = 1}
[[axes]]
name = "wrist"
joint = "wrist_joint"
actuation = "position"
drives = "joint"
"""

_SLIDE = """
schema = 1
name = "slide"
rate_hz = 500.0
[noise]
"slide.joint" = 5e-6
[[axes]]
name = "slide"
actuation = "force"
drives = "joint"
inertia = 20.0
limits = [-100.0, 100.0]
"""


def arm() -> Machine:
    """A slewing column (velocity, joint), a boom (velocity, cylinder), a wrist (position), a tool that hangs below the tip."""
    return machine_from_files({"machine.toml": _ARM, "arm.urdf": URDF}, "arm")


#: Masses of the links [kg] and how far along them their centres lie [m].
MASSES = {"column": (6.0, "0 0 0.1"), "boom": (4.0, "0.3 0 0.02"), "hand": (1.5, "0.1 0 0"), "grip": (2.5, "0 0 -0.05")}


def loaded_arm() -> Machine:
    """The arm with masses."""
    urdf = URDF
    for link, (mass, centre) in MASSES.items():
        inertial = f'<inertial><origin xyz="{centre}"/><mass value="{mass}"/></inertial>'
        urdf = urdf.replace(f'<link name="{link}"/>', f'<link name="{link}">{inertial}</link>')
    return machine_from_files({"machine.toml": _ARM, "arm.urdf": urdf}, "arm")


#: How the loaded arm's boom gives way to its weight.
LOADS = (
    KnownEffect("load_dependent_flow", "boom", {"coefficient": 0.01}),
    KnownEffect("joint_compliance", "boom", {"compliance": 3e-4}, "structure"),
)


def slide() -> Machine:
    """One axis moved by force."""
    return machine_from_files({"machine.toml": _SLIDE}, "slide")


def steered(count: int, rate_hz: float, gain: float, travel: float, rng: np.random.Generator) -> Array:
    """Commands of an operator who stays within ±``travel``: strokes of all sizes, slow ramps through zero, pauses.

    ``gain`` is how far a command of 1 moves in a second; it only decides when to turn round.
    """
    command = np.zeros(count)
    place, k = 0.0, round(0.5 * rate_hz)
    while k < count:
        seconds = rng.uniform(0.4, 1.6)
        kind = rng.choice(["stroke", "ramp", "pause"], p=[0.55, 0.3, 0.15])
        length = min(round(seconds * rate_hz), count - k)
        away = np.sign(place) if abs(place) > 0.5 * travel else rng.choice([-1.0, 1.0])
        if kind == "stroke":
            part = np.full(length, -away * rng.choice([0.15, 0.3, 0.5, 0.75, 1.0]))
        elif kind == "ramp":
            part = -away * np.linspace(0.0, rng.uniform(0.25, 0.9), length) * rng.choice([1.0, -0.3])
        else:
            part = np.zeros(length)
        room = max(travel - abs(place), 0.05 * travel)
        part = np.where(np.abs(np.cumsum(part)) * gain / rate_hz > room, 0.0, part)
        command[k : k + length] = part
        place += gain * float(part.sum()) / rate_hz
        k += length
    return command


def arm_inputs(name: str, seconds: float, seed: int) -> Recording:
    """Commands, and a first sample of what they move, for :func:`measured`."""
    rng = np.random.default_rng(seed)
    count = round(seconds * 100.0)
    time = np.arange(count) / 100.0
    start = np.where(time < 0.01, 1.0, np.nan)
    wrist = sum(np.sin(2 * np.pi * f * rng.uniform(0.8, 1.2) * time + rng.uniform(0, 6.28)) for f in (0.11, 0.3))
    steps = rng.uniform(-0.3, 0.3, count // 150 + 1).repeat(150)[:count]
    table = {
        "time": time,
        "slew.command": steered(count, 100.0, 0.436, 1.2, rng),
        "boom.command": steered(count, 100.0, 0.025, 0.045, rng),
        "wrist.command": 0.4 * np.asarray(wrist) + steps,
        "slew.joint": 0.0 * start,
        "boom.cylinder": 0.06 * start,
    }
    return Recording(name, pd.DataFrame(table), 100.0)


#: Frequencies and amplitudes of the forces on the slide [Hz, N]; the second set reaches the resonance of a flexible drive.
WAVES = ((0.4, 30.0), (0.9, 45.0), (2.1, 40.0))
FAST_WAVES = (*WAVES, *((f, 25.0) for f in np.geomspace(3.0, 25.0, 24)))


def slide_inputs(name: str, seconds: float, seed: int, shape: Sequence[tuple[float, float]] = WAVES) -> Recording:
    """Forces that push the slide to and fro. The force is continuous: each step holds what it is in the step's middle."""
    rng = np.random.default_rng(seed)
    count = round(seconds * 500.0)
    time = np.arange(count) / 500.0
    waves = [(f * rng.uniform(0.9, 1.1), size) for f, size in shape]

    def force(t: Array) -> Array:
        return sum((size * np.cos(2 * np.pi * f * t) for f, size in waves), np.zeros(len(t))) * (1.0 - np.exp(-t))

    table = {
        "time": time,
        "slide.command": force(time + 0.001),
        "slide.joint": np.where(time < 0.2, 0.0, np.nan),
        "at_samples": force(time),
    }
    return Recording(name, pd.DataFrame(table), 500.0)


def shaking_inputs(name: str, seconds: float, seed: int) -> Recording:
    """Forces up to 25 Hz, which twist a spring between motor and load."""
    return slide_inputs(name, seconds, seed, FAST_WAVES)


def creeping_inputs(name: str, seconds: float, seed: int) -> Recording:
    """Forces that let the slide creep in one direction, then in the other: friction at low speeds, and hardly a stop."""
    rng = np.random.default_rng(seed)
    made = slide_inputs(name, seconds, seed)
    time = made.values("time")
    size = 48.0 + sum(8.0 * np.sin(2 * np.pi * f * rng.uniform(0.9, 1.1) * time + rng.uniform(0, 6.28)) for f in (0.15, 0.4))
    force = np.tanh((0.5 * seconds - time) / 0.02) * size * (1.0 - np.exp(-time / 0.1))
    return replace(made, table=made.table.assign(**{"slide.command": force, "at_samples": force}))


def measured(truth: Plant, inputs: Recording, seed: int, noise: float = 1.0) -> Recording:
    """What sensors say while ``truth`` moves.

    ``noise`` scales that of the machine's data sheet; it lies before the rounding of a sensor that reads in steps.
    """
    rng = np.random.default_rng([seed, 1])
    run = free_run(truth, inputs)
    levels = truth.machine.noise
    columns = {"time": inputs.values("time")}
    for signal in inputs.signals:
        if signal.endswith(".command"):
            columns[signal] = inputs.values("at_samples" if "at_samples" in inputs.signals else signal)
    for signal in run.columns:
        if signal != "time":
            said = run[signal].to_numpy() + rng.normal(0.0, noise * levels.get(str(signal), 0.0), len(run))
            rounded = truth.effect("sensor_quantisation", str(signal))
            step = float(rounded.parameters["step"]) if rounded else 0.0  # type: ignore[arg-type]
            columns[str(signal)] = step * np.round(said / step) if step else said
    return replace(inputs, table=pd.DataFrame(columns))


def dataset_of(truth: Plant, seconds: float = 25.0, seed: int = 0, noise: float = 1.0) -> Dataset:
    """Two recordings to fit, one to select, one held out, of the machine that ``truth`` is.

    A slide with a film of oil creeps, and one with a spring is shaken, which shows them.
    """
    force = truth.machine.name == "slide"
    names = {effect.name for effect in truth.effects}
    push = creeping_inputs if "stribeck_friction" in names else shaking_inputs if "flexible_drive" in names else slide_inputs
    recordings = []
    for k in range(len(ROLES)):
        name = f"run-{k + 1}"
        inputs = (push if force else arm_inputs)(name, seconds, 10 * seed + k)
        recordings.append(measured(truth, inputs, 10 * seed + k, noise))
    splits = {r.name: role for r, role in zip(recordings, ROLES, strict=True)}
    return Dataset.of(truth.machine, recordings, splits)


#: Streams of a machine whose boom and tool are seen by motion capture.
CAPTURE: dict[str, tuple[str, ...]] = {"capture": ("boom.joint", "tool.x", "tool.y", "tool.z")}


def nominal(
    *effects: KnownEffect, machine: Machine | None = None, streams: Mapping[str, tuple[str, ...]] | None = None
) -> Plant:
    """The nominal plant with some effects."""
    plant = nominal_plant(machine or arm(), streams=streams)
    for effect in effects:
        plant = plant.with_effect(effect)
    return plant
