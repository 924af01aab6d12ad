"""``mjcf``: a MuJoCo model with the effects that MuJoCo has, and the drive model for the others."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

from sysid.effects import Effect
from sysid.export.drive_data import FRICTIONS, drive_data
from sysid.export.drive_module import MODULE, ModelSimulation, load_module, write_drive_model
from sysid.export.mjcf_arm import FRICTION_BY_LOOP, LOOP, MujocoArm, write_arm
from sysid.export.mjcf_bodies import (
    FILE,
    add_bodies,
    add_tool,
    heavier_drive,
    model_names,
    moved_by,
    new_spec,
    passive_joints,
    steps_of,
    write_model,
)
from sysid.export.mjcf_drives import Elements, add_drive, drive_entry
from sysid.export.mjcf_servo import MujocoServos, has_servos, write_servos
from sysid.export.names import MachineNames
from sysid.export.target import ForceSimulation, Simulation, Support, Target
from sysid.export.urdf import NOTE
from sysid.machine.rigid_body import moves_masses
from sysid.plant import Plant

ROBOT = "mujoco_robot.py"
_ELEMENTS = {
    "input_delay": "actuator `delay` and `nsample`",
    "first_order_lag": "actuator `dyntype=filterexact`",
    "second_order_lag": "position servo against the armature",
    "gain_error": "actuator `gainprm`",
    "internal_leakage": "actuator `biasprm`",
    "viscous_friction": "joint `damping` (the same in both directions; else by the drive model)",
    "coulomb_friction": "joint `frictionloss` (the same in both directions; else by the drive model)",
    "inertia_error": "joint `armature`",
    "armature_error": "joint `armature`",
    "stiffness_error": "position actuator `gainprm` and `biasprm`",
    "damping_error": "position actuator `biasprm`",
    "force_limit": "position actuator `forcerange`",
    "load_bias": "actuator `biasprm`",
    "link_mass_error": "`inertial` of the body",
    "inertial_error": "`inertial` of the body, joint `armature`; what a joint has and takes divided by its force constant",
    "payload": "body `payload` with its `inertial`",
    "joint_offset": "actuator `biasprm` and `range`, subtracted from the joint's sensor",
}
_COMPOSED = {
    "force_constant_error": "armature, friction and constant force of the joint, divided by it; of an arm actuator `gainprm`",
    "backlash": "second joint of the drive, tendon limited to the width, dry friction of the joint (velocity axes, one side)",
    "link_length_error": "`pos` of the bodies of the link",
    "tip_offset": "`pos` of the site `ee`",
    "base_misalignment": "pose of the root body, and `gravity` turned with it",
    "gripper_sway": "a point mass on a damped ball joint below a gimbal that does not rotate (not beside a misaligned base); "
    "swings up to 80°, since the tool has no state above its pivot",
}
_BY_DRIVE_MODEL = ("backlash", "gripper_sway")
_BEFORE = ("valve_hysteresis", "valve_deadband", "gain_curve", "flow_saturation", "command_rate_limit")


class MjcfTarget(Target):
    """MuJoCo 4.

    Args:
        most: ``composed``: drives, cylinders, backlash and the hanging tool as elements of MuJoCo; ``native``: drives alone;
            ``plugin``: none, all joints follow the drive model.
    """

    def __init__(self, most: Elements = "composed") -> None:
        self.most = most
        self.native = {} if most == "plugin" else _ELEMENTS
        by_drive_model = () if most == "composed" else _BY_DRIVE_MODEL
        self.composed = {effect: how for effect, how in _COMPOSED.items() if effect not in by_drive_model}

    name = "mjcf"
    title = "MuJoCo"
    modules = ("mujoco",)
    arms = True
    plugin = FRICTION_BY_LOOP
    notes = (
        "`robot.json` states the mode of each axis. `native`: its actuator takes the command. `command`: it takes what the "
        "first parts of the drive model make of the command. `drive_model`: it follows the joint of the drive model. "
        "`friction` (of an arm): `mujoco_arm.py` sets the friction of its joint before each step.",
        NOTE,
    )

    def names(self, plant: Plant) -> MachineNames:
        return model_names(plant).machine

    def otherwise(self, effect: Effect) -> Support:
        if effect.name in _BEFORE:
            return Support("plugin", f"`{MODULE}`, which changes the command of the actuator")
        if effect.stage == "sensor":
            return Support("plugin", f"`{MODULE}`, `Robot.readings`")
        if effect.name in FRICTIONS:
            return Support("plugin", f"`{MODULE}`, whose output the actuator takes or follows; of an arm `{LOOP}`")
        return Support("plugin", f"`{MODULE}`, whose output the actuator takes or follows")

    def write(self, plant: Plant, rate_hz: float, folder: Path) -> tuple[str, ...]:
        from sysid.export.standalone import mujoco_robot

        if moves_masses(plant.machine):
            return write_arm(plant, rate_hz, folder)
        if has_servos(plant):
            return write_servos(plant, rate_hz, folder)
        data = drive_data(plant, rate_hz)
        spec, about = _spec_of(plant, data, steps_of(rate_hz), self.most)
        files = write_model(folder, spec, about, ROBOT, inspect.getsource(mujoco_robot))
        return *files, *write_drive_model(plant, rate_hz, folder)

    def simulation(self, plant: Plant, folder: Path) -> Simulation | ForceSimulation | None:
        if moves_masses(plant.machine):
            return MujocoArm(folder)
        if has_servos(plant):
            return MujocoServos(folder)
        robot = load_module(folder / ROBOT).Robot(folder / FILE, load_module(folder / MODULE).load())
        return ModelSimulation(robot, dict)


def _spec_of(plant: Plant, data: dict[str, Any], substeps: int, most: Elements) -> tuple[Any, dict[str, Any]]:
    """The model, and what the shipped loop has to know of it."""
    step = data["dt"] / substeps
    spec = new_spec(plant, step)
    names, posed = model_names(plant), plant.machine.kinematics() is not None
    add_bodies(spec, plant, names.machine)
    axes, passive = [], passive_joints(plant, names.machine)
    for axis in data["axes"]:
        name = names.machine.joint(axis["name"])
        entry, joint = drive_entry(plant, axis, data["pump_limit"] is not None, most), spec.joint(name)
        moved = moved_by(spec, names, entry, axis, joint, step)
        add_drive(spec, axis, moved, entry, step, bool(passive))
        if entry.backlash is not None:
            heavier_drive(moved, spec.actuator(axis["name"]))
        about = {"axis": axis["name"], "mode": entry.mode, "reason": entry.reason, "prefix": entry.prefix, "joint": name}
        driver = moved.joint if entry.backlash is not None else name
        sensed = driver if entry.backlash is not None and entry.backlash[1] == "structure" else name
        about |= {"drive_joint": driver, "sensed_joint": sensed}
        about |= {"offset": axis["offset"], "zero": moved.zero, "driven": f"{axis['name']}.{axis['drives']}"}
        # A servo without a lag reaches a set-point at once: it is led there over the sample, as the plant moves.
        led = axis["actuation"] == "position" and not {name for name, _ in axis["command"]} & {
            "first_order_lag",
            "second_order_lag",
        }
        axes.append(about | {"actuation": axis["actuation"], "led": led})
    swings = most == "composed" and data["sway"] is not None and posed and plant.effect("base_misalignment", "base") is None
    gimbal = None
    if swings:
        tip = spec.body(names.machine.links[str(plant.machine.tip)])
        gimbal = add_tool(names, tip, spec.site("ee").pos, data["sway"]["length"], data["sway"]["damping_ratio"])
    found = {"plant": plant.reference, "substeps": substeps, "posed": posed, "swings": swings, "gimbal": gimbal}
    return spec, {**found, "axes": axes, "passive": passive}
