"""The machines without any feature, and their noise-free recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from simulated_bench.capture import frame_rotation
from simulated_bench.case import overlaid
from simulated_bench.joint_machines import description_of
from simulated_bench.joint_recipe import ServoArm, Slide, Take
from simulated_bench.recipe import AXES, BenchRecipe, RecordingSettings
from simulated_bench.recipe_file import check_recipe
from simulated_bench.run import simulate
from simulated_bench.servo_arm import run_servo_arm
from simulated_bench.site_files import machine_toml, urdf
from simulated_bench.slide import run_slide
from sysid.config import parse_settings, read_toml
from sysid.datasets import Recording
from sysid.machine import Machine, machine_from_files

Array = npt.NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[2]
AUTOLOG = ROOT / "datasets" / "autolog" / "bench.toml"
SEED = 20240527
EE, TOOL = ("ee.x", "ee.y", "ee.z"), ("tool.x", "tool.y", "tool.z")

#: The shipped crane with ideal sensors and clocks, its camera at the controller's rate, nothing hidden. Delays are whole
#: samples; a fraction of a sample is a separate row.
VALVE_CRANE: dict[str, Any] = {
    "axes": {
        "slew": {"backlash": 0.0, "valve": {"delay": 0.03}},
        **{name: {"valve": {"delay": 0.03}} for name in ("boom", "stick", "telescope")},
    },
    "gripper": {"length": 0.0, "damping_ratio": 0.0},
    "draw_wire": {"noise": 0.0, "quantum": 0.0},
    "slew_sensor": {"error": 0.0, "noise": 0.0, "quantum": 0.0},
    "controller": {"publish_delay": 0.0, "transport_delay": 0.0, "jitter": 0.0},
    "capture": {
        "rate": 100.0, "noise": 0.0, "offset": [0.0, 0.0], "skew": 0.0, "latency": 0.0, "dropouts_per_minute": 0.0,
        "swaps": [], "exported_markers": [],
    },
    "recordings": [],
    "hidden": [],
}  # fmt: skip
#: Pistons of the hydraulic crane [m²], and the speed of retraction that makes both directions equally fast [m/s].
PISTONS: Mapping[str, dict[str, Any]] = {
    "slew": {"area": 4e-5, "area_rod": 4e-5, "viscous": 2.0},
    "boom": {"area": 4.91e-4, "area_rod": 3.14e-4, "retraction": 0.025},
    "stick": {"area": 4.91e-4, "area_rod": 3.14e-4, "retraction": 0.035},
    "telescope": {"area": 2.0e-4, "area_rod": 1.2e-4, "retraction": 0.1},
}
#: The same crane, hydraulic: spools of 6 Hz; springs carry the weight; equally fast in both directions.
HYDRAULIC_CRANE = overlaid(
    VALVE_CRANE,
    {
        "masses": {"balanced": 1.0},
        "axes": {name: {"drive": "hydraulic", "hydraulics": pistons} for name, pistons in PISTONS.items()},
    },
)
SERVO_ARM: dict[str, Any] = {
    "kind": "servo_arm", "name": "arm", "seed": SEED, "recordings": [],
    "axes": [
        {"name": "shoulder", "limits": [-0.5, 1.5], "length": 0.3, "mass": 1.0, "time_constant": 0.03},
        {"name": "elbow", "limits": [-2.0, 0.5], "length": 0.25, "mass": 0.6, "time_constant": 0.03},
    ],
}  # fmt: skip
SLIDE: dict[str, Any] = {"kind": "slide", "name": "slide", "seed": SEED, "mass": 95.0, "viscous": 200.0, "recordings": []}

VALVE = ("gain_error", "input_delay", "first_order_lag", "valve_deadband")


@dataclass(frozen=True)
class MachineSettings:
    """A machine: tables of its recipe, and the effects of its baseline."""

    tables: Mapping[str, Any]
    baseline: tuple[str, ...]


MACHINES = {
    "valve crane": MachineSettings(VALVE_CRANE, VALVE),
    "hydraulic crane": MachineSettings(HYDRAULIC_CRANE, VALVE),
    "servo arm": MachineSettings(SERVO_ARM, ("input_delay", "first_order_lag")),
    "slide": MachineSettings(SLIDE, ("viscous_friction",)),
}


def recipe_of(machine_name: str, features: Mapping[str, Any]) -> BenchRecipe | ServoArm | Slide:
    """The machine of a stand with its features switched on."""
    tables = dict(MACHINES[machine_name].tables)
    if "kind" not in tables:
        tables = overlaid(read_toml(AUTOLOG), tables)
    for key, value in features.items():
        tables = with_value(tables, key.split("."), value)
    return parsed(tables, machine_name)


def parsed(tables: Mapping[str, Any], where: str) -> BenchRecipe | ServoArm | Slide:
    """The checked machine that tables describe."""
    kind = tables.get("kind")
    if kind is not None:
        return parse_settings(tables, ServoArm if kind == "servo_arm" else Slide, where)
    recipe = parse_settings(tables, BenchRecipe, where)
    check_recipe(recipe, where)
    return recipe


def with_value(tables: Any, path: Sequence[str], value: Any) -> Any:
    """A copy of nested tables and lists with one value set; a setting of None is taken out, which is its default."""
    if isinstance(tables, list):
        place = int(path[0])
        return [with_value(each, path[1:], value) if k == place else each for k, each in enumerate(tables)]
    first, rest = path[0], path[1:]
    if rest:
        return {**tables, first: with_value(tables.get(first, {}), rest, value)}
    without = {key: each for key, each in tables.items() if key != first}
    return without if value is None else {**without, first: value}


def description(machine: BenchRecipe | ServoArm | Slide) -> Machine:
    """The owner's description: geometry, rated gains and masses."""
    if not isinstance(machine, BenchRecipe):
        return machine_from_files(description_of(machine), machine.name)
    gains = {name: machine.axis(name).valve.gain for name in AXES}
    files = {"machine.toml": machine_toml(machine, gains, []), f"{machine.name}.urdf": urdf(machine)}
    return machine_from_files(files, machine.name)


def record(machine: BenchRecipe | ServoArm | Slide, program: str, seed: int, seconds: float) -> Recording:
    """One recording without noise, on the grid of the controller."""
    take = Take(program, seed, seconds)
    if isinstance(machine, ServoArm):
        time, wanted, joints = run_servo_arm(machine, take)
        names = [f"{axis.name}.{part}" for part in ("command", "joint") for axis in machine.axes]
        table = pd.DataFrame(np.column_stack([wanted, joints]), columns=names)
        return Recording(program, table.assign(time=time), machine.rate)
    if isinstance(machine, Slide):
        time, force, position = run_slide(machine, take)
        table = pd.DataFrame({"time": time, "carriage.command": force, "carriage.joint": position})
        return Recording(program, table, machine.rate)
    run = simulate(machine, RecordingSettings(program, seed, seconds=seconds, program=program))  # type: ignore[arg-type]
    rate = machine.controller.rate
    columns = {f"{name}.command": run.log.command[:, i] for i, name in enumerate(AXES)}
    columns |= {"boom.cylinder": run.log.wires[:, 0], "stick.cylinder": run.log.wires[:, 1]}
    columns |= {"telescope.joint": run.log.wires[:, 2], "slew.joint": run.log.slew}
    count = len(run.log.stamps)
    # Frames have the controller's rate and are placed row by row, whatever the clock of the camera.
    shown = run.capture.clock.to_machine(run.capture.time) - machine.capture.latency
    joints = run.truth.at(shown, run.truth.joint)
    turned = frame_rotation(machine.capture.rpy)
    seen = {body.name: body.position @ turned.T + np.array(machine.capture.translation) for body in run.capture.bodies}
    points = {"ee": seen["tip_body"], "tool": seen["gripper_body"]}
    columns |= {f"{name}.joint": fitted(joints[:, AXES.index(name)], count) for name in ("boom", "stick")}
    columns |= {f"{point}.{c}": fitted(points[point][:, k], count) for point in points for k, c in enumerate("xyz")}
    return Recording(program, pd.DataFrame({"time": np.arange(count) / rate, **columns}), rate)


def fitted(values: Array, count: int) -> Array:
    """``values`` cut or filled with NaN to ``count`` rows: a clock of its own may give the camera a frame more or less."""
    out = np.full(count, np.nan)
    out[: min(count, len(values))] = values[:count]
    return out


#: What each stream of a recorded crane carries.
STREAMS = {
    "machine": ("boom.cylinder", "stick.cylinder", "telescope.joint", "slew.joint"),
    "mocap": ("boom.joint", "stick.joint", *EE, *TOOL),
}
