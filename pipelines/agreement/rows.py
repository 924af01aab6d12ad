"""Rows of the comparison: every effect on the machines that show it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from agreement.machines import AUTOLOG, EE, TOOL
from simulated_bench.cylinder import drive_of, position_of
from simulated_bench.recipe_file import load_recipe


@dataclass(frozen=True)
class Row:
    """One effect on one machine.

    Args:
        feature: settings of the machine, key in its recipe → value (``axes.boom.backlash``; ``axes.0.delay`` in a list).
        signals: what the effect shows in; all in one unit.
        guess: start of the fit; components of vectors in order.
        own: the setting of the machine, where it means the same as the parameter.
        base: features that the machine has in both runs, where the effect needs them to show.
        also: effects that the baseline of the target needs beside those of its stand.
        programs: recordings for the fit, ``seconds`` each; ``unseen``: program of the recording for the errors.
    """

    effect: str
    target: str
    machine_name: str
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


BOOM, SLEW = ("boom.cylinder",), ("slew.joint",)
SHOULDER, PLACE = ("shoulder.joint",), ("carriage.joint",)
VALVES, HYDRAULIC, ARM, CARRIAGE = "valve crane", "hydraulic crane", "servo arm", "slide"
LAPS = {"axes.boom.valve.deadband_positive": 0.24, "axes.boom.valve.deadband_negative": 0.18}
NO_LAP = {"axes.boom.valve.deadband_positive": 0.0, "axes.boom.valve.deadband_negative": 0.0}
#: A slewing drive at the end of long hoses, with a fast spool and stiff oil, which the feature makes softer.
HOSES = {"supply.parked": 40e5, "oil.bulk_modulus": 2e10, "axes.slew.hydraulics.spool_frequency": 30.0,
         "axes.slew.hydraulics.dead_volume": 5e-4}  # fmt: skip
#: Cylinders with a rod on either side: the same oil in both directions.
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

#: Effects of no machine of the bench: pipelines/electric_arms.py compares them.
ELSEWHERE = {"smooth_coulomb_friction", "flexible_drive", "second_order_lag", "force_constant_error"}

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
    Row("stiction", "boom", VALVES, {"axes.boom.valve.silt": 0.3}, BOOM, {"spool_breakaway": 0.1, "spool_release": 0.02},
        {"spool_breakaway": 0.3 - 0.1}, base={"axes.boom.valve.deadband_positive": 0.1, "axes.boom.valve.time_constant": 0.01},
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
