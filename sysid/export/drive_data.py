"""Plant → data of a drive model: the parts of every axis in their order, with their parameters (SI)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.effects import CATALOGUE, effect_named
from sysid.effects.base_misalignment import EFFECT as BASE
from sysid.machine.kinematics import GRAVITY, rotation_by
from sysid.plant import Model, Plant, compile_plant
from sysid.plant.layout import AT, AXIS_WIDTH, neutral_vector, signal_place, signals_of, slot_indices
from sysid.plant.machine_arrays import (
    AXIS,
    CENTRE,
    GAIN,
    HIGH,
    LENGTH,
    LOW,
    MASS,
    OFFSET,
    ORDER,
    PASSIVE,
    PRISMATIC,
    RATIO,
    ROTATION,
    SENSE,
    SHIFT,
    TABLE_LOW,
    TABLE_STEP,
    WEIGHT,
)

Array = npt.NDArray[np.float64]
Part = tuple[str, dict[str, Any]]


def _velocity_order() -> tuple[str, ...]:
    """Command stage of a velocity axis in the order of the catalogue, with the gain of the description.

    The dead time comes behind the static curves, with which it commutes, because a fraction of a step is interpolated exactly
    only behind their kinks.
    """
    axis = [effect for effect in CATALOGUE if effect.target == "axis" and effect.stage == "command"]
    names = [effect.name for effect in axis if "velocity" in effect.actuations and effect.name != "input_delay"]
    names.insert(names.index("command_rate_limit"), "input_delay")
    names.insert(names.index("internal_leakage"), "nominal_gain")
    return tuple(names)


VELOCITY_ORDER = _velocity_order()
#: Static parts behind the place of a spool.
EDGE = ("valve_deadband", "gain_curve", "flow_saturation")
#: Those that act on a spool; one part where it sticks at its centre.
SPOOL = ("input_delay", "command_rate_limit", "first_order_lag")
#: The same of a position axis, whose parts give the value at the end of a step; a ramp begins with its step.
POSITION_ORDER = ("command_rate_limit", "input_delay", "first_order_lag", "second_order_lag")


def drive_data(plant: Plant, rate_hz: float) -> dict[str, Any]:
    """The data of :func:`sysid.export.standalone.model.assemble` for steps of 1/``rate_hz``."""
    model = compile_plant(plant)
    sway = effect_slots(plant, "gripper_sway", "tool")
    pump = effect_slots(plant, "pump_flow_limit", "machine")
    return {
        "schema": 1,
        "machine": plant.machine.name,
        "plant": plant.reference,
        "dt": 1.0 / rate_hz,
        "axes": [_axis(plant, model, i) for i in range(model.axes)],
        "pump_limit": pump["limit"] if pump else None,
        "kinematics": _kinematics(model),
        "sway": sway if sway and sway["length"] >= 1e-3 else None,
        "sensors": sensor_readings(model),
    }


def effect_slots(plant: Plant, name: str, target: str, side: str | None = None) -> dict[str, float]:
    """Slots of an effect by name, empty where the plant does not have it."""
    if plant.effect(name, target, side) is None:
        return {}
    effect, theta, names = effect_named(name), plant.vector(), plant.machine.axis_names
    return {s.name: float(theta[slot_indices(names, effect, target, side, s.name)[0]]) for s in effect.slots}


def _axis(plant: Plant, model: Model, i: int) -> dict[str, Any]:
    axis, row, name = plant.machine.axes[i], model.arrays.axes[i], plant.machine.axes[i].name
    low, high = float(row[LOW]), float(row[HIGH])
    found: dict[str, Any] = {
        "name": name,
        "actuation": axis.actuation,
        "drives": axis.drives,
        "low": low if math.isfinite(low) else None,
        "high": high if math.isfinite(high) else None,
        "gain": axis.gain,
        "sense": float(row[SENSE]),
        "command": _command(plant, name),
        "linkage": None,
        "offset": effect_slots(plant, "joint_offset", name).get("offset", 0.0),
    }
    for side in ("drive", "structure"):
        found[f"{side}_backlash"] = effect_slots(plant, "backlash", name, side).get("width", 0.0)
        found[f"{side}_compliance"] = effect_slots(plant, "joint_compliance", name, side).get("compliance", 0.0)
    if name in plant.linkages:
        joints = model.arrays.tables[i].tolist()
        found["linkage"] = {"low": float(row[TABLE_LOW]), "step": float(row[TABLE_STEP]), "joints": joints}
    if axis.actuation == "force":
        spring = effect_slots(plant, "flexible_drive", name)
        # Forces in units of the command: a drive that makes less of it moves as if everything else were larger.
        constant = effect_slots(plant, "force_constant_error", name).get("ratio", 1.0)
        frictions = [(law, values) for law in FRICTIONS if (values := effect_slots(plant, law, name))]
        found |= {
            "mass": float(row[GAIN]) * effect_slots(plant, "inertia_error", name).get("ratio", 1.0) / constant,
            "bias": effect_slots(plant, "load_bias", name).get("force", 0.0) / constant,
            "frictions": [(law, _divided(law, values, constant)) for law, values in frictions],
            "rotor": "flexible_drive" if spring else "rigid_drive",
            "spring": spring,
        }
    return found


def _divided(law: str, values: dict[str, float], constant: float) -> dict[str, float]:
    """Slots of a friction with its forces divided by a constant; speeds and exponents stay."""
    parameters = [parameter for form in effect_named(law).forms for parameter in form.parameters if parameter.scale == "force"]
    forces = {slot for parameter in parameters for group in parameter.components for slot in group}
    return {slot: value / constant if slot in forces else value for slot, value in values.items()}


def _command(plant: Plant, name: str) -> list[Part]:
    axis, parts = plant.machine.axis(name), []
    sticking = _sticking_spool(plant, name)
    order = {"velocity": VELOCITY_ORDER, "position": POSITION_ORDER, "servo": (), "force": ()}[axis.actuation]
    for part in order:
        if part == "nominal_gain":
            parts.append((part, {"gain": axis.gain}))
        elif sticking and part in (*SPOOL, "stiction"):
            parts += [("sticking_spool", sticking)] if part == SPOOL[-1] else []
        elif values := effect_slots(plant, part, name):
            extra: dict[str, Any] = {}
            if axis.actuation == "position" and part == "first_order_lag":
                extra = {"at_end": True}
            if axis.actuation == "position" and part == "command_rate_limit":
                lag, spring = (effect_slots(plant, each, name).get("time_constant", 0.0) for each in POSITION_ORDER[2:])
                extra = {"at_end": True, "lag": lag} if lag >= 1e-6 or spring < 1e-6 else {}
            if part == "stiction":
                extra = {"gain": axis.gain}
            if part == "second_order_lag" and values["time_constant"] < 1e-6:
                continue
            parts.append((part, values | extra))
    return parts


def _sticking_spool(plant: Plant, name: str) -> dict[str, Any]:
    """Effects of the part that stands for :data:`SPOOL` where the spool sticks at its centre; empty where it does not."""
    if effect_slots(plant, "stiction", name).get("spool_breakaway", 0.0) == 0.0:
        return {}
    return {"effects": {each: values for each in (*EDGE, *SPOOL, "stiction") if (values := effect_slots(plant, each, name))}}


def _kinematics(model: Model) -> dict[str, Any] | None:
    if not model.posed:
        return None
    theta, links, base = model.theta, model.arrays.links, model.arrays.base
    joints = []
    for j, row in enumerate(links[:-1]):
        joints.append(
            {
                "rotation": row[ROTATION : ROTATION + 9].reshape(3, 3).tolist(),
                "shift": _shift(theta, links, j).tolist(),
                "axis": row[AXIS : AXIS + 3].tolist(),
                "prismatic": bool(row[PRISMATIC]),
                "axis_index": int(row[ORDER]),
                "ratio": float(row[RATIO]),
                "offset": float(row[OFFSET]),
                "mass": float(row[MASS] * row[WEIGHT]) / GRAVITY,  # its weight, at the standard gravity of the loads
                "centre": row[CENTRE : CENTRE + 3].tolist(),
            }
        )
    at = base + AT.tip_offset
    tip = _shift(theta, links, len(links) - 1) + theta[at : at + 3]
    at = base + AT.base_misalignment
    translation, turn = theta[at : at + 3], rotation_by(theta[at + 3 : at + 6])
    assert [slot.name[:4] for slot in BASE.slots] == ["tran"] * 3 + ["rota"] * 3
    return {
        "joints": joints, "tip": tip.tolist(), "base_rotation": turn.tolist(), "base_translation": translation.tolist()
    }  # fmt: skip


def _shift(theta: Array, links: Array, j: int) -> Array:
    """Translation of a frame, with the link length error of the joint before it."""
    shift = links[j, SHIFT : SHIFT + 3].copy()
    if j > 0 and links[j - 1, PASSIVE] == 0.0 and links[j, LENGTH] > 1e-9:
        longer = float(theta[int(links[j - 1, ORDER]) * AXIS_WIDTH + AT.link_length_error])
        shift *= 1.0 + longer / links[j, LENGTH]
    return np.asarray(shift)


def sensor_readings(model: Model) -> dict[str, dict[str, float]]:
    """Sensors that are not ideal. The clocks of their streams are no part of a model that runs in the machine's time."""
    neutral, found = neutral_vector(model.axes), {}
    for signal in signals_of(model.machine.axis_names):
        at = signal_place(model.machine.axis_names, signal)
        places = {"scale": at + AT.sensor_scale, "bias": at + AT.sensor_bias, "step": at + AT.sensor_quantisation}
        if any(model.theta[place] != neutral[place] for place in places.values()):
            found[signal] = {key: float(model.theta[place]) for key, place in places.items()}
    return found


#: Effects that a model in the machine's time, from commands to motion, does not contain, and why.
WITHOUT_PART = {
    "clock_offset": "stamps of a recording",
    "clock_skew": "stamps of a recording",
    "link_mass_error": "forces of an arm, which `mjcf` alone writes",
    "inertial_error": "forces of an arm, which `mjcf` alone writes",
    "payload": "forces of an arm, which `mjcf` alone writes",
    "load_dependent_friction": "forces of an arm, which `mjcf` alone writes",
    **dict.fromkeys(
        ("stiffness_error", "damping_error", "force_limit", "armature_error"),
        "controllers of servos, which `mjcf` alone writes",
    ),
}
#: What opposes the motion of a force axis: all of its effects but those of mass, spring, constant load and force constant.
FRICTIONS = tuple(
    effect.name
    for effect in CATALOGUE
    if effect.stage == "force" and "force" in effect.actuations and effect.name not in WITHOUT_PART
    and effect.name not in ("inertia_error", "flexible_drive", "load_bias", "force_constant_error")
)  # fmt: skip
