"""The plant against the stand-in machine, effect by effect, with the model error that remains: writes docs/bench.md's table.

    .venv/bin/python pipelines/bench_agreement.py

The stand-in machine computes flows, pressures, spools, seals, bodies, pendulums and cameras; the plant computes the named
effects. For every row a machine is recorded without noise, first without the feature that the row names: an engineer's baseline
(gain, delay, lag, dead-band …) is fitted to that. Then the feature is switched on and the one effect is fitted, everything else
left as it was. Errors are those of free runs on a recording that no fit has seen.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import least_squares, minimize

from committed import provenance, write_result, write_tables
from sysid.bench.capture import frame_rotation
from sysid.bench.case import overlaid
from sysid.bench.cylinder import drive_of, position_of
from sysid.bench.joint_machines import description_of
from sysid.bench.joint_recipe import ServoArm, Slide, Take
from sysid.bench.recipe import AXES, Recipe, RecordingSettings
from sysid.bench.recipe_file import check_recipe, load_recipe
from sysid.bench.run import simulate
from sysid.bench.servo_arm import run_servo_arm
from sysid.bench.site_files import machine_toml, urdf
from sysid.bench.slide import run_slide
from sysid.config import parse_settings, read_toml
from sysid.datasets import Recording
from sysid.effects import CATALOGUE, effect_named, form_for
from sysid.machine import KnownEffect, Machine, machine_from_files
from sysid.plant import Plant, free_run, nominal_plant

Array = npt.NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[1]
AUTOLOG = ROOT / "datasets" / "autolog" / "bench.toml"
PIPELINE = "pipelines/bench_agreement.py"
PAGE, RESULT = ROOT / "docs" / "bench.md", ROOT / "reports" / "bench_agreement" / "result.json"
SEED = 20240527

# ---- The machines, without any feature ----------------------------------------------------------------------------------

#: The shipped crane, its sensors and clocks made perfect, its camera at the controller's rate, nothing hidden. Delays are whole
#: samples: what a fraction of one costs is a row of its own.
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
#: The same crane, hydraulic: spools of 6 Hz; springs carry the weight; as fast one way as the other.
HYDRAULIC_CRANE = overlaid(
    VALVE_CRANE,
    {
        "masses": {"balanced": 1.0},
        "axes": {
            "slew": {"drive": "hydraulic", "hydraulics": {"area": 4e-5, "area_rod": 4e-5, "viscous": 2.0}},
            "boom": {"drive": "hydraulic", "hydraulics": {"area": 4.91e-4, "area_rod": 3.14e-4, "retraction": 0.025}},
            "stick": {"drive": "hydraulic", "hydraulics": {"area": 4.91e-4, "area_rod": 3.14e-4, "retraction": 0.035}},
            "telescope": {"drive": "hydraulic", "hydraulics": {"area": 2.0e-4, "area_rod": 1.2e-4, "retraction": 0.1}},
        },
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
class Stand:
    """A machine: its recipe's tables, and the effects that an engineer fits to every axis of it before anything else."""

    tables: Mapping[str, Any]
    baseline: tuple[str, ...]


STANDS = {
    "valve crane": Stand(VALVE_CRANE, VALVE),
    "hydraulic crane": Stand(HYDRAULIC_CRANE, VALVE),
    "servo arm": Stand(SERVO_ARM, ("input_delay", "first_order_lag")),
    "slide": Stand(SLIDE, ("viscous_friction",)),
}

# ---- The rows -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """One effect on one machine.

    Args:
        feature: what the machine has, key in its recipe → value (``axes.boom.backlash``; ``axes.0.delay`` in a list).
        signals: what the effect shows in; all in one unit.
        guess: where the fit begins to look; components of vectors in order.
        own: the machine's own setting, where it has one that means the same as the parameter.
        base: features that the machine has in both runs, where the effect needs them to show.
        also: effects that the baseline of the target needs beside those of its stand.
        programs: what is recorded to fit, ``seconds`` each; ``unseen``: what the errors are stated for.
    """

    effect: str
    target: str
    stand: str
    feature: Mapping[str, Any]
    signals: tuple[str, ...]
    guess: Mapping[str, float | tuple[float, ...]]
    own: Mapping[str, float | tuple[float, ...]] = field(default_factory=dict)
    base: Mapping[str, Any] = field(default_factory=dict)
    side: str | None = None
    also: tuple[str, ...] = ()
    programs: tuple[str, ...] = ("steps", "operator")
    unseen: str = "operator"
    seconds: float = 60.0


EE, TOOL = ("ee.x", "ee.y", "ee.z"), ("tool.x", "tool.y", "tool.z")
BOOM, SLEW = ("boom.cylinder",), ("slew.joint",)
SHOULDER, PLACE = ("shoulder.joint",), ("carriage.joint",)
VALVES, HYDRAULIC, ARM, CARRIAGE = "valve crane", "hydraulic crane", "servo arm", "slide"
LAPS = {"axes.boom.valve.deadband_positive": 0.24, "axes.boom.valve.deadband_negative": 0.18}
NO_LAP = {"axes.boom.valve.deadband_positive": 0.0, "axes.boom.valve.deadband_negative": 0.0}
#: A slewing drive at the end of long hoses, with a brisk spool; the oil hardly gives way before the feature softens it.
HOSES = {"supply.parked": 40e5, "oil.bulk_modulus": 2e10, "axes.slew.hydraulics.spool_frequency": 30.0,
         "axes.slew.hydraulics.dead_volume": 5e-4}  # fmt: skip
#: Cylinders with a rod on either side: as much oil one way as the other.
DOUBLE_RODS = {
    f"axes.{axis}.hydraulics.area_rod": area for axis, area in (("boom", 4.91e-4), ("stick", 4.91e-4), ("telescope", 2e-4))
}
DRIVES = ("boom.cylinder", "stick.cylinder", "telescope.joint")
STRIBECK = {"static_force": 35.0, "coulomb_force": 20.0, "stribeck_velocity": 0.01}
#: Many short runs: after minutes a small error in friction decides where the carriage sticks.
PUSHES = ("push",) * 8
STRIBECK_GUESS = {"static_force": 25.0, "coulomb_force": 15.0, "stribeck_velocity": 0.03}
#: A tenth of the boom cylinder's displacement where it is parked [m].
COUNT = 0.1 * position_of(0.5, drive_of(load_recipe(AUTOLOG).axis("boom")))

ROWS: tuple[Row, ...] = (
    Row("input_delay", "boom", VALVES, {"axes.boom.valve.delay": 0.12}, BOOM, {"delay": 0.05}, {"delay": 0.12}),
    Row("input_delay", "boom", VALVES, {"axes.boom.valve.delay": 0.1247}, BOOM, {"delay": 0.05}, {"delay": 0.1247}),
    Row("input_delay", "boom", HYDRAULIC, {"axes.boom.valve.delay": 0.12}, BOOM, {"delay": 0.05}),
    Row("input_delay", "shoulder", ARM, {"axes.0.delay": 0.08}, SHOULDER, {"delay": 0.04}),
    Row("valve_hysteresis", "boom", HYDRAULIC, {"axes.boom.hydraulics.hysteresis": 0.10}, BOOM, {"width": 0.05},
        {"width": 0.06}, programs=("reversals", "operator")),
    Row("valve_deadband", "boom", VALVES, LAPS, BOOM, {"positive": 0.1, "negative": 0.1}, {"positive": 0.24, "negative": 0.18},
        programs=("stairs", "operator")),
    Row("valve_deadband", "boom", HYDRAULIC, LAPS, BOOM, {"positive": 0.1, "negative": 0.1},
        {"positive": 0.24, "negative": 0.18}, programs=("stairs", "operator")),
    Row("gain_curve", "boom", VALVES, {"axes.boom.valve.notch": 0.6}, BOOM, {"exponent": 1.3}),
    Row("gain_curve", "boom", HYDRAULIC, {"axes.boom.valve.notch": 0.6}, BOOM, {"exponent": 1.3}),
    Row("flow_saturation", "boom", VALVES, {"axes.boom.valve.saturation": 0.5}, BOOM, {"limit": 0.6}, {"limit": 0.5}),
    Row("flow_saturation", "boom", HYDRAULIC, {"axes.boom.valve.saturation": 0.5}, BOOM, {"limit": 0.6}, {"limit": 0.5}),
    Row("command_rate_limit", "boom", VALVES, {"axes.boom.valve.spool_speed": 1.0}, BOOM, {"rate": 2.0}, {"rate": 1.0}),
    Row("command_rate_limit", "boom", HYDRAULIC, {"axes.boom.valve.spool_speed": 1.0}, BOOM, {"rate": 2.0}, {"rate": 1.0},
        base=NO_LAP),
    Row("command_rate_limit", "boom", HYDRAULIC, {"axes.boom.valve.spool_speed": 1.0}, BOOM, {"rate": 2.0}, {"rate": 1.0}),
    Row("command_rate_limit", "shoulder", ARM, {"axes.0.rate_limit": 0.8}, SHOULDER, {"rate": 1.5}, {"rate": 0.8}),
    Row("first_order_lag", "boom", VALVES, {"axes.boom.valve.time_constant": 0.17}, BOOM, {"time_constant": 0.08},
        {"time_constant": 0.17}),
    Row("first_order_lag", "boom", HYDRAULIC, {"axes.boom.hydraulics.spool_frequency": 2.0}, BOOM, {"time_constant": 0.08},
        base=NO_LAP),
    Row("first_order_lag", "boom", HYDRAULIC, {"axes.boom.hydraulics.spool_frequency": 2.0}, BOOM, {"time_constant": 0.08}),
    Row("first_order_lag", "shoulder", ARM, {"axes.0.time_constant": 0.10}, SHOULDER, {"time_constant": 0.05},
        {"time_constant": 0.10}),
    Row("gain_error", "boom", HYDRAULIC, {"supply.pressure": 60e5, "supply.rated": 80e5}, BOOM, {"ratio": 1.0},
        {"ratio": (60.0 / 80.0) ** 0.5}),
    Row("asymmetric_gain", "boom", VALVES, {"axes.boom.valve.direction_ratio": 0.8}, BOOM, {"ratio": 1.0}, {"ratio": 0.8}),
    Row("asymmetric_gain", "boom", HYDRAULIC, {"axes.boom.hydraulics.retraction": None}, BOOM, {"ratio": 1.0},
        {"ratio": (3.14 / 4.91) ** 0.5}),
    Row("temperature_drift", "slew", HYDRAULIC, {"oil.end": 40.0}, SLEW, {"fraction": 0.1, "time_constant": 40.0},
        base={"oil.transition": 5e4, "oil.start": -5.0, "oil.end": -5.0, "oil.warm_up": 60.0}, seconds=120.0),
    Row("load_dependent_flow", "boom", HYDRAULIC, {"masses.balanced": 0.0}, BOOM, {"coefficient": 0.003}),
    Row("internal_leakage", "boom", HYDRAULIC, {"axes.boom.hydraulics.spool_leakage": 5e-14}, BOOM, {"rate": 3e-5},
        base={"masses.balanced": 0.0}, also=("asymmetric_gain", "load_dependent_flow"), programs=("rest", "operator"),
        unseen="rest"),
    Row("stiction", "boom", VALVES, {"axes.boom.valve.silt": 0.3}, BOOM, {"breakaway": 0.1, "release": 0.02},
        {"breakaway": 0.3 - 0.1}, base={"axes.boom.valve.deadband_positive": 0.1, "axes.boom.valve.time_constant": 0.01},
        programs=("stairs", "operator")),
    Row("oil_compressibility", "slew", HYDRAULIC, {"oil.bulk_modulus": 5e8}, SLEW, {"frequency": 5.0, "damping_ratio": 0.1},
        base={**HOSES, "masses.column_inertia": 20.0, "axes.slew.hydraulics.area": 8e-5, "axes.slew.hydraulics.area_rod": 8e-5,
              "axes.slew.hydraulics.viscous": 40.0}, unseen="steps"),
    Row("oil_compressibility", "slew", HYDRAULIC, {"oil.bulk_modulus": 5e8}, SLEW, {"frequency": 5.0, "damping_ratio": 0.1},
        base={**HOSES, "axes.slew.hydraulics.viscous": 8.0}, unseen="steps"),
    Row("pump_flow_limit", "machine", HYDRAULIC, {"supply.flow_limit": 2e-5}, DRIVES, {"limit": 1.5}, base=DOUBLE_RODS,
        programs=("together", "operator"), unseen="together"),
    Row("pump_flow_limit", "machine", HYDRAULIC, {"supply.flow_limit": 2e-5}, DRIVES, {"limit": 1.5},
        programs=("together", "operator"), unseen="together"),
    Row("coulomb_friction", "carriage", CARRIAGE, {"coulomb": 20.0}, PLACE, {"force": 10.0}, {"force": 20.0}, seconds=20.0),
    Row("viscous_friction", "carriage", CARRIAGE, {"viscous": 300.0}, PLACE, {"coefficient": 100.0}, {"coefficient": 300.0},
        seconds=20.0),
    Row("stribeck_friction", "carriage", CARRIAGE, {"coulomb": 20.0, "static": 35.0}, PLACE, STRIBECK_GUESS, STRIBECK,
        programs=PUSHES, seconds=6.0),
    Row("stribeck_friction", "carriage", CARRIAGE, {"coulomb": 20.0, "static": 35.0, "bristle": 2e-5}, PLACE, STRIBECK_GUESS,
        STRIBECK, programs=PUSHES, seconds=6.0),
    Row("inertia_error", "carriage", CARRIAGE, {"mass": 120.0}, PLACE, {"ratio": 1.0}, {"ratio": 120.0 / 95.0},
        seconds=20.0),
    Row("load_bias", "carriage", CARRIAGE, {"offset": -3.2}, PLACE, {"force": -1.0}, {"force": -3.2}, seconds=20.0),
    Row("backlash", "slew", VALVES, {"axes.slew.backlash": 0.0105}, SLEW, {"width": 0.005}, {"width": 0.0105},
        programs=("reversals", "operator")),
    Row("backlash", "slew", VALVES, {"axes.slew.backlash": 0.0105}, EE, {"width": 0.005}, {"width": 0.0105},
        base={"slew_sensor.mount": "drive"}, side="structure", programs=("reversals", "operator")),
    Row("backlash", "boom", VALVES, {"axes.boom.backlash": 0.001}, ("boom.joint",), {"width": 0.01},
        programs=("reversals", "operator")),
    Row("backlash", "shoulder", ARM, {"axes.0.backlash": 0.01}, SHOULDER, {"width": 0.005}, {"width": 0.01}),
    Row("joint_compliance", "boom", VALVES, {"axes.boom.stiffness": 5000.0}, ("boom.joint",), {"compliance": 1e-4},
        {"compliance": 1.0 / 5000.0}),
    Row("joint_compliance", "shoulder", ARM, {"axes.0.compliance": 2e-3}, SHOULDER, {"compliance": 1e-3}, {"compliance": 2e-3}),
    Row("joint_offset", "stick", VALVES, {"build.joint_offset.stick": 0.017}, EE, {"offset": 0.01}, {"offset": 0.017}),
    Row("link_length_error", "boom", VALVES, {"build.boom": 0.003}, EE, {"error": 0.001}, {"error": 0.003}),
    Row("base_misalignment", "base", VALVES, {"capture.shift": [0.004, -0.003, 0.002], "capture.tilt": [0.010, -0.008, 0.012]},
        EE, {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0)},
        {"translation": (0.004, -0.003, 0.002), "rotation": (0.010, -0.008, 0.012)}),
    Row("gripper_sway", "tool", VALVES, {"gripper.length": 0.22, "gripper.damping_ratio": 0.04}, TOOL,
        {"length": 0.3, "damping_ratio": 0.08}, {"length": 0.22, "damping_ratio": 0.04}),
    Row("sensor_bias", "boom.cylinder", VALVES, {"sensors": [{"signal": "boom.cylinder", "bias": 0.004}]}, ("boom.joint",),
        {"bias": 0.002}, {"bias": 0.004}),
    Row("sensor_scale", "boom.cylinder", VALVES, {"sensors": [{"signal": "boom.cylinder", "aside": 0.05, "standoff": 0.16402}]},
        BOOM, {"scale": 0.98}),
    # The counter stands at a whole count where the machine is parked; else its start is known to half a count only.
    Row("sensor_quantisation", "boom.cylinder", VALVES, {"sensors": [{"signal": "boom.cylinder", "quantum": COUNT}]}, BOOM,
        {"step": 0.002}, {"step": COUNT}),
    Row("clock_skew", "mocap", VALVES, {"capture.skew": 400.0}, EE, {"skew": 100.0}, {"skew": 400.0}),
    Row("clock_offset", "mocap", VALVES, {"capture.latency": 0.030}, EE, {"offset": -0.01}, {"offset": -0.030}),
)  # fmt: skip

# ---- Recording a machine ------------------------------------------------------------------------------------------------


def recipe_of(stand: str, features: Mapping[str, Any]) -> Recipe | ServoArm | Slide:
    """The machine of a stand with its features switched on."""
    tables = dict(STANDS[stand].tables)
    kind = tables.get("kind")
    if kind is None:
        tables = overlaid(read_toml(AUTOLOG), tables)
    for key, value in features.items():
        tables = with_value(tables, key.split("."), value)
    if kind is not None:
        return parse_settings(tables, ServoArm if kind == "servo_arm" else Slide, stand)
    recipe = parse_settings(tables, Recipe, stand)
    check_recipe(recipe, stand)
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


def description(machine: Recipe | ServoArm | Slide) -> Machine:
    """What the owner wrote down: geometry, rated gains and masses."""
    if not isinstance(machine, Recipe):
        return machine_from_files(description_of(machine), machine.name)
    gains = {name: machine.axis(name).valve.gain for name in AXES}
    files = {"machine.toml": machine_toml(machine, gains, []), f"{machine.name}.urdf": urdf(machine)}
    return machine_from_files(files, machine.name)


def record(machine: Recipe | ServoArm | Slide, program: str, seed: int, seconds: float) -> Recording:
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
    # The camera's frames come at the controller's rate; they are taken at their word, whatever its clock says.
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

# ---- Fitting ------------------------------------------------------------------------------------------------------------


def errors(plant: Plant, recordings: Sequence[Recording], signals: Sequence[str]) -> Array:
    """Plant less machine over all samples of ``signals`` that both have."""
    parts = []
    for recording in recordings:
        run = free_run(plant, recording)
        for signal in signals:
            left = run[signal].to_numpy() - recording.values(signal)
            parts.append(left[~np.isnan(left)])
    return np.concatenate(parts)


def rmse(plant: Plant, recordings: Sequence[Recording], signals: Sequence[str]) -> float:
    """Root mean square; of points, over their coordinates together (their distance)."""
    left = errors(plant, recordings, signals)
    per_sample = len(signals) if signals[0].split(".")[0] in ("ee", "tool") else 1
    return float(np.sqrt(per_sample * np.mean(left**2)))


@dataclass(frozen=True)
class Unknown:
    """An effect to be fitted: where the search begins, in the order of its parameters."""

    name: str
    target: str
    guess: Mapping[str, float | tuple[float, ...]]
    side: Any = None

    @property
    def start(self) -> Array:
        return np.concatenate([np.atleast_1d(np.asarray(value, dtype=np.float64)) for value in self.guess.values()])

    @property
    def bounds(self) -> Array:
        """(m, 2), from the catalogue."""
        form = form_for(effect_named(self.name), frozenset(self.guess), "row")
        by_name = {parameter.name: parameter for parameter in form.parameters}
        return np.array([by_name[key].bounds for key, value in self.guess.items() for _ in np.atleast_1d(value)])

    @property
    def stepwise(self) -> bool:
        form = form_for(effect_named(self.name), frozenset(self.guess), "row")
        return any(parameter.stepwise for parameter in form.parameters)

    def at(self, x: Array) -> KnownEffect:
        found: dict[str, float | list[float]] = {}
        place = 0
        for key, value in self.guess.items():
            size = np.size(value)
            found[key] = x[place : place + size].tolist() if isinstance(value, tuple) else float(x[place])
            place += size
        return KnownEffect(self.name, self.target, found, self.side)


#: Numbers to be fitted → points of the grid in each, and how far it reaches [factor].
GRID = {1: (41, 10.0), 2: (15, 5.0), 3: (7, 3.0)}
#: Points for an effect whose parameter must be met closely before it explains anything.
FINE = 601


def fit(plant: Plant, unknowns: Sequence[Unknown], recordings: Sequence[Recording], signals: Sequence[str]) -> Plant:
    """The plant whose ``unknowns`` fit ``recordings`` best, everything else as it is.

    Up to three numbers are looked for on a grid around the guess. Then least squares, then a simplex without slopes:
    dead-bands, plays and quanta have kinks.
    """
    guess = np.concatenate([unknown.start for unknown in unknowns])
    low, high = np.concatenate([unknown.bounds for unknown in unknowns]).T
    sizes = np.where(guess != 0.0, np.abs(guess), 0.01)

    def plant_at(x: Array) -> Plant:
        values, tried, place = np.clip(x * sizes, low, high), plant, 0
        for unknown in unknowns:
            tried = tried.with_effect(unknown.at(values[place : place + len(unknown.start)]))
            place += len(unknown.start)
        return tried

    def residuals(x: Array) -> Array:
        return errors(plant_at(x), recordings, signals)

    def cost(x: Array) -> float:
        return float(np.mean(residuals(x) ** 2))

    points, reach = GRID.get(len(guess), (1, 1.0))
    if any(unknown.stepwise for unknown in unknowns):
        points = points if len(guess) > 1 else FINE
    factors = np.geomspace(1.0 / reach, reach, points)
    repeat = len(guess) if points > 1 else 0
    grid = [np.array(row) * np.sign(guess) for row in itertools.product(factors, repeat=repeat)] if repeat else [guess / sizes]
    best = min(grid, key=cost)
    ends = (low / sizes, high / sizes)

    def settled(x: Array) -> Array:
        inside = np.clip(x, ends[0] + 1e-6, ends[1] - 1e-6)
        rough = least_squares(residuals, inside, bounds=ends, diff_step=1e-3, max_nfev=25)
        return np.asarray(least_squares(residuals, rough.x, bounds=ends, diff_step=1e-5, max_nfev=15).x)

    best = min((best, settled(best)), key=cost)
    names = [unknown.name for unknown in unknowns for _ in unknown.start]
    if {"input_delay", "first_order_lag"} <= set(names):
        # Delay and lag exchange, and every sample of delay has a minimum of its own: their sum is kept, each is tried.
        delay, lag = names.index("input_delay"), names.index("first_order_lag")
        both = best[delay] * sizes[delay] + best[lag] * sizes[lag]
        tries = [best.copy() for _ in np.arange(0.01, both, 0.01)]
        for k, x in enumerate(tries, start=1):
            x[delay], x[lag] = 0.01 * k / sizes[delay], (both - 0.01 * k) / sizes[lag]
        best = min((best, settled(min(tries, key=cost))), key=cost) if tries else best
    if len(guess) <= 3:
        away = 0.03 * np.maximum(np.abs(best), 0.1)
        corners = np.vstack([best, *(best + np.diag(away))])
        options = {"initial_simplex": corners, "maxfev": 50 * len(guess), "xatol": 1e-6, "fatol": 1e-30}
        best = min((best, minimize(cost, best, method="Nelder-Mead", options=options).x), key=cost)
    return plant_at(best)


#: Where the fit of a baseline begins.
FIRST_GUESS: dict[str, Mapping[str, float | tuple[float, ...]]] = {
    "gain_error": {"ratio": 1.0},
    "input_delay": {"delay": 0.03},
    "first_order_lag": {"time_constant": 0.04},
    "valve_deadband": {"positive": 0.12, "negative": 0.12},
    "viscous_friction": {"coefficient": 100.0},
    "asymmetric_gain": {"ratio": 1.0},
    "load_dependent_flow": {"coefficient": 0.003},
}


@cache
def baseline(stand: str, base: tuple[tuple[str, Any], ...], axes: tuple[str, ...], also: tuple[str, ...]) -> Plant:
    """What an engineer fits to steps and an operator's work on the machine without the feature."""
    machine = recipe_of(stand, dict(base))
    plant = nominal_plant(description(machine), streams=STREAMS)
    recordings = [record(machine, program, 101 + k, 60.0) for k, program in enumerate(("steps", "operator"))]
    for axis in axes:
        names = (*STANDS[stand].baseline, *also)
        unknowns = [Unknown(name, axis, FIRST_GUESS[name]) for name in names]
        plant = fit(plant, unknowns, recordings, (plant.machine.axis(axis).driven,))
    return plant


# ---- One row ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Agreement:
    """One row's outcome; errors are root mean squares on a recording that no fit has seen [unit].

    Args:
        alone: of the baseline on the machine without the feature: what the plant cannot do even there.
        without, with_effect: on the machine with the feature, before and after the effect is in.
        parameters: as fitted; ``own``: the machine's own setting. ``base``: what the machine has in both runs.
    """

    effect: str
    target: str
    side: str | None
    machine: str
    base: dict[str, Any]
    feature: dict[str, Any]
    signals: tuple[str, ...]
    unit: str
    alone: float
    without: float
    with_effect: float
    parameters: dict[str, float | list[float]]
    own: dict[str, float | tuple[float, ...]]
    seconds: float

    @property
    def share(self) -> float:
        """What is left of the error once the effect is in."""
        return self.with_effect / self.without


def agreement(row: Row) -> Agreement:
    begin = time.perf_counter()
    fixed = tuple(row.base.items())
    plain, real = recipe_of(row.stand, dict(fixed)), recipe_of(row.stand, {**row.base, **row.feature})
    axes = description(plain).axis_names
    moved = tuple(axis for axis in axes if row.target == axis or row.target not in axes)
    if row.signals[0].split(".")[0] in ("ee", "tool"):
        moved = axes
    before = baseline(row.stand, fixed, moved, row.also)
    fitting = [record(real, program, 201 + k, row.seconds) for k, program in enumerate(row.programs)]
    unseen = record(real, row.unseen, 301, row.seconds)
    after = fit(before, [Unknown(row.effect, row.target, row.guess, row.side)], fitting, row.signals)
    found = after.effect(row.effect, row.target, row.side)
    assert found is not None
    first = row.signals[0]
    return Agreement(
        effect=row.effect,
        target=row.target,
        side=row.side,
        machine=row.stand,
        base=dict(row.base),
        feature=dict(row.feature),
        signals=row.signals,
        unit=before.machine.expected_unit(first) or "m",
        alone=rmse(before, [record(plain, row.unseen, 301, row.seconds)], row.signals),
        without=rmse(before, [unseen], row.signals),
        with_effect=rmse(after, [unseen], row.signals),
        parameters=dict(found.parameters),
        own=dict(row.own),
        seconds=time.perf_counter() - begin,
    )


# ---- The page -----------------------------------------------------------------------------------------------------------


def in_words(row: Agreement) -> str:
    """``boom: valve.delay 0.12``: what the machine was given."""
    parts = []
    for key, value in row.feature.items():
        if key == "sensors":
            parts += [f"sensor {name} {number(setting)}" for name, setting in value[0].items() if name != "signal"]
        else:
            parts.append(f"{key.removeprefix('axes.').removeprefix('0.')} {number(value)}")
    return ", ".join(parts) + (" ¹" if row.base else "")


def number(value: Any) -> str:
    if value is None:
        return "left out"
    return " ".join(f"{v:.4g}" for v in np.atleast_1d(np.asarray(value, dtype=np.float64)))


def size(value: float, unit: str) -> str:
    """With a unit that suits: 0.93 mm, 12 µrad."""
    for factor, prefix in ((1.0, ""), (1e3, "m"), (1e6, "µ")):
        if value * factor >= 0.1:
            return f"{value * factor:.2g} {prefix}{unit}" if value * factor < 100.0 else f"{value * factor:.0f} {prefix}{unit}"
    return f"< 0.1 µ{unit}"


def table(rows: Sequence[Agreement]) -> str:
    """The generated part of the page."""
    lines = [
        "| effect | machine and feature | shows in | before | after | left | nothing hidden | fitted | its own |",
        "| --- | --- | --- | ---: | ---: | ---: | ---: | --- | --- |",
    ]
    for row in rows:
        side = f", {row.side}" if row.side else ""
        signals = row.signals[0].split(".")[0] if row.signals[0].split(".")[0] in ("ee", "tool") else ", ".join(row.signals)
        cells = (
            f"`{row.effect}` on {row.target}{side}",
            f"{row.machine}: {in_words(row)}",
            signals,
            size(row.without, row.unit),
            size(row.with_effect, row.unit),
            f"{100.0 * row.share:.1f} %" if row.share >= 1e-3 else "< 0.1 %",
            size(row.alone, row.unit),
            ", ".join(f"{name} {number(value)}" for name, value in row.parameters.items()),
            ", ".join(number(value) for value in row.own.values()) or "–",
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main(chosen: Sequence[Row] = ROWS, result: Path = RESULT, page: Path | None = PAGE) -> list[Agreement]:
    missing = {effect.name for effect in CATALOGUE} - {row.effect for row in ROWS}
    if missing:
        raise SystemExit(f"no machine shows {', '.join(sorted(missing))}: add a row to ROWS")
    rows = []
    for row in chosen:
        rows.append(agreement(row))
        print(f"{row.effect:20s} {row.stand:16s} {100 * rows[-1].share:6.1f} % left, {rows[-1].seconds:.0f} s", flush=True)
    found = {"rows": [{**asdict(row), "share": row.share} for row in rows]}
    write_result(result, provenance(f"python {PIPELINE}", SEED) | found)
    if page is not None:
        write_tables(page, table(rows), PIPELINE)
    return rows


if __name__ == "__main__":
    main()
