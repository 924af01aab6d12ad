"""Compiled plant against PyBullet world, effect by effect, on the shipped crane: writes the tables of reports/bench_agreement/.

    .venv/bin/python pipelines/world.py

Both run freely from the commands of one recording. An effect counts as shown where it changes the compiled run.
"""

from __future__ import annotations

import importlib.metadata
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from committed import markdown, processor, write_tables
from sysid.datasets import Dataset, Recording, ingest
from sysid.effects import CATALOGUE
from sysid.machine import KnownEffect
from sysid.networks import NetworkRecipe, fit_actuator
from sysid.plant import Plant, free_run, nominal_plant
from sysid.plant.stepper import Stepper
from sysid.world import Log, World

ROOT = Path(__file__).resolve().parents[1]
PAGE, PICTURE = ROOT / "reports" / "bench_agreement" / "README.md", ROOT / "docs" / "images" / "world.png"
RECORDING = "manual-06"
#: Height of the ground, without contact: the compiled plant has no ground.
NO_GROUND = -3.0
JOINTS = [f"{axis}.joint" for axis in ("slew", "boom", "stick", "telescope")]
EE, TOOL = [f"ee.{c}" for c in "xyz"], [f"tool.{c}" for c in "xyz"]

SWAY = KnownEffect("gripper_sway", "tool", {"length": 0.22, "damping_ratio": 0.04})
EFFECTS = (
    KnownEffect("input_delay", "boom", {"delay": 0.08}),
    KnownEffect("valve_hysteresis", "boom", {"width": 0.06}),
    KnownEffect("valve_deadband", "boom", {"positive": 0.24, "negative": 0.18}),
    KnownEffect("gain_curve", "boom", {"exponent": 1.4}),
    KnownEffect("flow_saturation", "boom", {"limit": 0.5}),
    KnownEffect("command_rate_limit", "boom", {"rate": 2.0}),
    KnownEffect("first_order_lag", "boom", {"time_constant": 0.15}),
    KnownEffect("gain_error", "boom", {"ratio": 0.85}),
    KnownEffect("asymmetric_gain", "boom", {"ratio": 1.2}),
    KnownEffect("temperature_drift", "boom", {"fraction": 0.15, "time_constant": 40.0}),
    KnownEffect("load_dependent_flow", "boom", {"coefficient": 0.003}),
    KnownEffect("internal_leakage", "boom", {"rate": 1e-4}),
    KnownEffect("stiction", "boom", {"breakaway": 0.2, "release": 0.05}),
    KnownEffect("oil_compressibility", "boom", {"frequency": 7.0, "damping_ratio": 0.1}),
    KnownEffect("pump_flow_limit", "machine", {"limit": 0.9}),
    KnownEffect("coulomb_friction", "slew", {"force": 0.6}),
    KnownEffect("viscous_friction", "slew", {"coefficient": 9.0}),
    KnownEffect("stribeck_friction", "slew", {"static_force": 0.8, "coulomb_force": 0.5, "stribeck_velocity": 0.02}),
    KnownEffect("smooth_coulomb_friction", "slew", {"force": 0.6, "width": 0.02}),
    KnownEffect("inertia_error", "slew", {"ratio": 1.5}),
    KnownEffect("flexible_drive", "slew", {"frequency": 4.0, "damping_ratio": 0.1, "inertia_ratio": 2.0}),
    KnownEffect("load_bias", "slew", {"force": 0.2}),
    KnownEffect("backlash", "slew", {"width": 0.0105}, "drive"),
    KnownEffect("backlash", "slew", {"width": 0.0105}, "structure"),
    KnownEffect("joint_compliance", "boom", {"compliance": 5e-5}, "drive"),
    KnownEffect("joint_compliance", "stick", {"compliance": 1e-4}, "structure"),
    KnownEffect("joint_offset", "stick", {"offset": 0.017}),
    KnownEffect("link_length_error", "boom", {"error": 0.003}),
    KnownEffect("base_misalignment", "base", {"translation": [0.002, -0.003, 0.001], "rotation": [0.01, -0.01, 0.02]}),
    KnownEffect("sensor_scale", "ee.z", {"scale": 1.01}),
    KnownEffect("sensor_bias", "ee.x", {"bias": 0.005}),
    KnownEffect("sensor_quantisation", "tool.x", {"step": 0.002}),
    KnownEffect("clock_skew", "mocap", {"skew": 150.0}),
    KnownEffect("clock_offset", "mocap", {"offset": -0.015}),
)
#: Torque [N·m] at command 1 of the slew where it is turned by force, its inertia [kg·m²] and viscous friction [N·m·s/rad].
TORQUE, INERTIA, VISCOUS = 3.0, 2.0, 6.0


@dataclass(frozen=True)
class Row:
    """Differences between two simulations of one recording, and the change by the effect itself (RMS)."""

    what: str
    parameters: str
    changes: float
    joints: float
    ee: float
    tool: float


def rms(one: pd.DataFrame, other: pd.DataFrame, names: list[str]) -> float:
    """The largest over ``names`` [m or rad]."""
    left = one[names].to_numpy() - other[names].to_numpy()
    return float(np.sqrt(np.nanmean(left**2, axis=0)).max())


def by_force(plant: Plant, recording: Recording) -> tuple[Plant, Recording]:
    """The crane with its slew turned by a torque instead of a valve."""
    machine = plant.machine
    axes = tuple(
        replace(axis, actuation="force", inertia=INERTIA, gain=1.0) if axis.name == "slew" else axis for axis in machine.axes
    )
    effects = tuple(item for item in plant.effects if item.target != "slew")
    turned = Plant(replace(machine, axes=axes), plant.linkages, effects)
    torque = TORQUE * recording.table["slew.command"]
    table = recording.table.assign(**{"slew.command": torque})
    return turned.with_effect(KnownEffect("viscous_friction", "slew", {"coefficient": VISCOUS})), replace(
        recording, table=table
    )


def agreement(nominal: Plant, recording: Recording) -> list[Row]:
    """One row for each effect, then everything at once in the variants of the world."""
    missing = {e.name for e in CATALOGUE if not e.of_links and not e.described_only} - {item.name for item in (*EFFECTS, SWAY)}
    if missing:
        raise SystemExit(f"no example for {', '.join(sorted(missing))}: add one to EFFECTS")
    rows = []
    for item in EFFECTS:
        force = next(effect for effect in CATALOGUE if effect.name == item.name).actuations == ("force",)
        plant, source = by_force(nominal, recording) if force else (nominal, recording)
        side = f", {item.side}" if item.side else ""
        rows.append(compare(f"`{item.name}` on {item.target}{side}", plant, item, source))
    together = nominal
    for item in EFFECTS:
        if item.target != "slew" or item.name == "backlash":
            together = together.with_effect(item)
    rows += [
        compare('`gripper_sway`, `gripper="point"`', nominal, SWAY, recording, gripper="point"),
        compare('`gripper_sway`, `gripper="rigid"`', nominal, SWAY, recording),
        compare('`gripper_sway`, `"rigid"`, `mode="dynamic"`', nominal, SWAY, recording, mode="dynamic"),
        compare('all of them, `gripper="point"`', together, SWAY, recording, gripper="point"),
    ]
    return rows


def compare(what: str, without: Plant, item: KnownEffect, recording: Recording, **settings: str) -> Row:
    plant = without.with_effect(item)
    run, plain = free_run(plant, recording), free_run(without, recording)
    with World(plant, recording.rate_hz, ground=NO_GROUND, **settings) as world:  # type: ignore[arg-type]
        found = world.rollout(recording)
    changes = rms(run, plain, [*EE, *TOOL])
    values = ", ".join(f"{name} {numbers(value)}" for name, value in item.parameters.items())
    return Row(what, values, changes, rms(found, run, JOINTS), rms(found, run, EE), rms(found, run, TOOL))


def speeds(plant: Plant, recording: Recording, repeats: int = 5) -> list[tuple[str, float]]:
    """Best of some repetitions, machine steps (four axes, sway included) a second."""
    found = []
    start = free_run(plant, recording).loc[0, JOINTS].to_numpy(dtype=np.float64)
    rng = np.random.default_rng(0)
    for lanes in (1, 256, 4096):
        stepper = Stepper(plant, recording.rate_hz, lanes)
        commands = rng.uniform(-1.0, 1.0, (lanes, len(start)))
        count = max(20, 200_000 // lanes // (10 if lanes == 1 else 1))
        best = 0.0
        for _ in range(repeats):
            stepper.reset(start)
            begin = time.perf_counter()
            for _ in range(count):
                stepper.step(commands)
            best = max(best, count * lanes / (time.perf_counter() - begin))
        found.append((f"`Stepper`, {lanes} lane{'s' if lanes > 1 else ''}", best))
    for substeps in (1, 4):
        with World(plant, recording.rate_hz, ground=NO_GROUND, substeps=substeps) as world:
            best = 0.0
            for _ in range(repeats):
                world.reset(start)
                begin = time.perf_counter()
                for _ in range(500):
                    world.step(commands[0])
                best = max(best, 500 / (time.perf_counter() - begin))
        found.append((f"`World`, {substeps} substep{'s' if substeps > 1 else ''}", best))
    return found


def tables(rows: list[Row], rates: list[tuple[str, float]]) -> str:
    """The generated part of the page."""
    lines = [
        (
            row.what, row.parameters, length(row.changes), f"{row.joints:.1g}", length(row.ee),
            "= tip" if row.tool == row.ee else length(row.tool),
        )
        for row in rows
    ]  # fmt: skip
    head = ("effect", "parameters", "moves tip or tool by", "joints differ by", "tip", "tool")
    cores = f"{processor()}, pybullet {importlib.metadata.version('pybullet')}"
    speed = markdown(("what", "steps/s"), [(what, f"{rate:,.0f}") for what, rate in rates])
    return f"{markdown(head, lines, 'll')}\n\nSteps a second on one machine ({cores}), shared with other work:\n\n{speed}"


def numbers(value: float | list[float]) -> str:
    return " ".join(f"{x:g}" for x in np.atleast_1d(np.asarray(value)))


def length(metres: float) -> str:
    if metres < 1e-5:
        return f"{1e6 * metres:.2g} µm"
    return f"{1e3 * metres:.1f} mm" if metres >= 1e-3 else f"{1e3 * metres:.2g} mm"


def photograph(plant: Plant, path: Path) -> None:
    """The crane above two logs, as the camera of the world sees it."""
    from PIL import Image

    logs = (Log((0.80, 0.10, -0.03), yaw=0.1), Log((0.80, 0.18, -0.03), yaw=0.1), Log((0.80, 0.14, 0.022), yaw=0.05))
    with World(plant, logs=logs) as world:
        world.reset([0.0, 0.75, -1.1, 0.1])
        for k in range(120):
            world.step([0.4 * np.sin(0.05 * k), 0.0, 0.0, 0.0])
        Image.fromarray(world.picture(800, 500, target=(0.5, 0.05, 0.2), distance=1.6)).save(path)


def crane(dataset: Dataset) -> Plant:
    """The nominal plant with the actuator networks as linkages."""
    return nominal_plant(dataset.machine, fit_actuator(dataset, NetworkRecipe()), dataset.streams)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        dataset = ingest(ROOT / "datasets" / "autolog", Path(folder))
        nominal, recording = crane(dataset), dataset.recording(RECORDING)
        rows = agreement(nominal, recording)
        rates = speeds(nominal.with_effect(SWAY), recording)
        photograph(nominal.with_effect(SWAY), PICTURE)
    write_tables(PAGE, tables(rows, rates), "pipelines/world.py")
    print(tables(rows, rates))


if __name__ == "__main__":
    main()
