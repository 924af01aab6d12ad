"""An arm of servos in MuJoCo: position actuators with their gains, limits and delays on joints with armature and friction.

The time step is that of the simulator that ``machine.toml`` describes, where a sample is a whole number of its steps; dry
friction gives way as its constraint does. Backlash is a second joint behind that of the motor, with hard ends.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.effects import first_order_lag
from sysid.errors import SettingsError
from sysid.export.drive_data import effect_slots, sensor_readings
from sysid.export.drive_module import load_module, with_classes
from sysid.export.mjcf_bodies import FILE, add_bodies, model_names, new_spec, passive_joints, steps_of, write_model
from sysid.export.mjcf_drives import add_actuator, dry_friction, limit
from sysid.export.standalone.parts import SensorReading
from sysid.export.target import Start
from sysid.export.urdf import LinkInertias
from sysid.names import listed
from sysid.plant import Model, Plant, chain, compile_plant
from sysid.plant.arm_dynamics import mass_ratios
from sysid.plant.arm_inertia import inertial

Array = npt.NDArray[np.float64]

LOOP = "mujoco_servos.py"
#: Effects that the model can have.
EFFECTS = frozenset(
    (
        "input_delay", "first_order_lag", "stiffness_error", "damping_error", "force_limit", "armature_error",
        "link_mass_error", "viscous_friction", "coulomb_friction", "backlash", "joint_offset", "link_length_error",
        "tip_offset", "base_misalignment", "sensor_bias", "sensor_scale", "sensor_quantisation", "clock_offset", "clock_skew",
    )
)  # fmt: skip
#: Friction that a joint of MuJoCo has in one size for both directions.
EVEN = ("viscous_friction", "coulomb_friction")


def has_servos(plant: Plant) -> bool:
    """Whether the axes of a plant are servos with their controllers."""
    return any(axis.servo is not None for axis in plant.machine.axes)


def write_servos(plant: Plant, rate_hz: float, folder: Path) -> tuple[str, ...]:
    """Write model, table of axes and loop; returns the names of the files.

    Raises:
        SettingsError: effects that the model cannot have.
    """
    from sysid.export.standalone import mujoco_servos

    _check(plant)
    spec, about = _spec_of(plant, rate_hz)
    return write_model(folder, spec, about, LOOP, with_classes(mujoco_servos, "class Servos", [SensorReading]))


class MujocoServos:
    """The shipped loop as the simulation of an export."""

    def __init__(self, folder: Path) -> None:
        self.arm = load_module(folder / LOOP).Servos(folder / FILE)

    def reset(self, start: Start) -> dict[str, float]:
        found: dict[str, float] = self.arm.reset(start.joints, start.commands, start.speeds)
        return found

    def step(self, commands: Array) -> dict[str, float]:
        found: dict[str, float] = self.arm.step(commands)
        return found


def _check(plant: Plant) -> None:
    beyond = [f"{item.name} on {item.target}" for item in plant.effects if item.name not in EFFECTS]
    beyond += [f"a residual network on {item.target}" for item in plant.residuals]
    for item in plant.effects:
        if item.name in EVEN:
            values = effect_slots(plant, item.name, item.target)
            if values["positive"] != values["negative"]:
                beyond.append(f"{item.name} on {item.target} by direction")
    if beyond:
        where, remedy = f"export of {plant.machine.name} to mjcf", "sysid models shows the effects of a plant."
        raise SettingsError(where, f"{listed(beyond)} on servo axes", f"one of {listed(sorted(EFFECTS))}", remedy)


def _spec_of(plant: Plant, rate_hz: float) -> tuple[Any, dict[str, Any]]:
    import mujoco

    laws = [axis.servo for axis in plant.machine.axes]
    stated = [law.step for law in laws if law is not None and law.step > 0.0]
    whole = round(1.0 / (rate_hz * stated[0])) if stated else 0
    substeps = steps_of(rate_hz)
    if whole and abs(whole * stated[0] * rate_hz - 1.0) < 1e-6:
        substeps = whole
    step = 1.0 / (rate_hz * substeps)
    spec = new_spec(plant, step)
    if any(law is not None and not law.implicit for law in laws):
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    names, model = model_names(plant).machine, compile_plant(plant)
    add_bodies(spec, plant, names, _inertias(plant, model))
    axes = [_axis(spec, plant, i, names.joint(axis.name), step) for i, axis in enumerate(plant.machine.axes)]
    compiled = spec.compile()
    for law, row in zip(laws, axes, strict=True):
        joint = spec.joint(row["joint"])
        if law is not None and law.friction_give > 0.0 and joint.frictionloss > 0.0:
            weight = compiled.dof_invweight0[compiled.jnt_dofadr[compiled.joint(row["joint"]).id]]
            _give_way(joint, law.friction_give, law.friction_time + 0.5 * step, float(weight))
    found = {"plant": plant.reference, "substeps": substeps, "posed": plant.machine.kinematics() is not None}
    return spec, {**found, "axes": axes, "passive": passive_joints(plant, names), "sensors": sensor_readings(model)}


def _inertias(plant: Plant, model: Model) -> LinkInertias | None:
    """Of all that moves with each joint of the chain, as those of its link; None without masses."""
    kinematics, true = plant.machine.kinematics(), mass_ratios(model.arrays, model.theta)[:, None] * model.arrays.bodies
    if kinematics is None or not true.any():
        return None
    moved = [joint.child for joint in kinematics.chain if joint.name in kinematics.drives]
    bodies = {link: inertial(row) for link, row in zip(moved, true, strict=True)}
    return {link: (np.array([own.mass]), own.centre, own.moments) for link, own in bodies.items() if own.mass > 0.0}


def _axis(spec: Any, plant: Plant, i: int, name: str, step: float) -> dict[str, Any]:
    """Complete the joint of an axis and add its actuator; returns its row of the table."""
    import mujoco

    axis, model = plant.machine.axes[i], compile_plant(plant)
    kp, kv, low, high, armature = (float(value) for value in chain.servo_law.py_func(model.theta, model.arrays.axes, i))
    joint, offset = spec.joint(name), effect_slots(plant, "joint_offset", axis.name).get("offset", 0.0)
    joint.armature = armature
    joint.damping = [effect_slots(plant, "viscous_friction", axis.name).get("positive", 0.0), 0.0, 0.0]
    dry_friction(joint, effect_slots(plant, "coulomb_friction", axis.name).get("positive", 0.0), step)
    if axis.limits is not None:
        limit(joint, [end + offset for end in axis.limits], step)
    width, behind = effect_slots(plant, "backlash", axis.name, "drive").get("width", 0.0), None
    if width > 0.0:
        behind = joint.parent.add_joint(name=f"{joint.name}_backlash", type=joint.type, axis=joint.axis, pos=joint.pos)
        limit(behind, [-0.5 * width, 0.5 * width], step)
    actuator = add_actuator(spec, axis.name, joint)
    actuator.gainprm[0], actuator.biasprm[:3] = kp, [0.0, -kp, -kv]
    if math.isfinite(low) or math.isfinite(high):
        actuator.forcerange, actuator.forcelimited = [low, high], mujoco.mjtLimited.mjLIMITED_TRUE
    lag = effect_slots(plant, "first_order_lag", axis.name).get("time_constant", 0.0)
    if lag >= first_order_lag.ABSENT:
        actuator.dyntype, actuator.dynprm[0] = mujoco.mjtDyn.mjDYN_FILTEREXACT, lag
    late = round(effect_slots(plant, "input_delay", axis.name).get("delay", 0.0) / step)
    if late > 0:
        actuator.delay = (late - 1e-3) * step  # a whole number of steps must not become one more by rounding
        actuator.nsample = late + 2
    return {"axis": axis.name, "joint": joint.name, "offset": offset, "behind": behind.name if behind is not None else None}


def _give_way(joint: Any, give: float, time: float, weight: float) -> None:
    """Let the dry friction of a joint give way at ``give`` [rad/(s·N·m) or m/(s·N)] within ``time`` [s]."""
    impedance = 1.0 / (1.0 + give / (time * weight))
    joint.solimp_friction = [impedance, impedance, 1e-3, 0.5, 2.0]
    joint.solref_friction = [2.0 * time / impedance, 1.0]
