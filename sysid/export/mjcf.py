"""``mjcf``: a MuJoCo model with the effects that MuJoCo has, and the drive model for the others."""

from __future__ import annotations

import inspect
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.effects import Effect
from sysid.export.drive_data import FRICTIONS, WITHOUT_PART, drive_data
from sysid.export.drive_module import MODULE, load_module, write_drive_model
from sysid.export.mjcf_arm import FILE, FRICTION_BY_LOOP, LOOP, arm_simulation, write_arm
from sysid.export.mjcf_bodies import add_bodies, add_tool, heavier_drive, model_names, moved_by, passive_joints
from sysid.export.mjcf_drives import Elements, add_drive, drive_entry
from sysid.export.mjcf_servo import MujocoServos, has_servos, write_servos
from sysid.export.names import MachineNames
from sysid.export.target import ForceSimulation, Simulation, Start, Support
from sysid.export.urdf import NOTE
from sysid.machine.rigid_body import moves_masses
from sysid.machine.sources.mjcf_model import mjcf_text
from sysid.plant import Plant

Array = npt.NDArray[np.float64]
ROBOT = "mujoco_robot.py"
#: Longest step of the integrator [s]; a sample of the machine is a whole number of steps.
LONGEST_STEP = 1e-3
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


class MjcfTarget:
    """MuJoCo 4.

    Args:
        most: ``composed``: drives, cylinders, backlash and the hanging tool as elements of MuJoCo; ``native``: drives alone;
            ``plugin``: none, all joints follow the drive model.
    """

    def __init__(self, most: Elements = "composed") -> None:
        self.most = most

    name = "mjcf"
    title = "MuJoCo"
    modules: tuple[str, ...] = ("mujoco",)
    resolution, arms = 0.0, True
    notes: tuple[str, ...] = (
        "`robot.json` states the mode of each axis. `native`: its actuator takes the command. `command`: it takes what the "
        "first parts of the drive model make of the command. `drive_model`: it follows the joint of the drive model. "
        "`friction` (of an arm): `mujoco_arm.py` sets the friction of its joint before each step.",
        NOTE,
    )

    def names(self, plant: Plant) -> MachineNames:
        return model_names(plant).machine

    def support(self, effect: Effect) -> Support:
        if effect.name in _ELEMENTS and self.most != "plugin":
            return Support("native", _ELEMENTS[effect.name])
        if effect.name in _COMPOSED and (self.most == "composed" or effect.name not in _BY_DRIVE_MODEL):
            return Support("composed", _COMPOSED[effect.name])
        if effect.name in FRICTION_BY_LOOP:
            return Support("plugin", FRICTION_BY_LOOP[effect.name])
        if effect.name in WITHOUT_PART:
            return Support("not_representable", WITHOUT_PART[effect.name])
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
        substeps = max(1, math.ceil(1.0 / (rate_hz * LONGEST_STEP) - 1e-9))
        spec, about = _spec_of(plant, data, substeps, self.most)
        (folder / FILE).write_text(mjcf_text(spec), "utf-8")
        (folder / FILE).with_suffix(".json").write_text(json.dumps(about, indent=1), "utf-8")
        (folder / ROBOT).write_text(inspect.getsource(mujoco_robot), "utf-8")
        return FILE, f"{Path(FILE).stem}.json", ROBOT, *write_drive_model(plant, rate_hz, folder)

    def simulation(self, plant: Plant, folder: Path) -> Simulation | ForceSimulation | None:
        if moves_masses(plant.machine):
            return arm_simulation(folder)
        if has_servos(plant):
            return MujocoServos(folder)
        return MujocoSimulation(load_module(folder / ROBOT).Robot(folder / FILE, load_module(folder / MODULE).load()))


def _spec_of(plant: Plant, data: dict[str, Any], substeps: int, most: Elements) -> tuple[Any, dict[str, Any]]:
    """The model, and what the shipped loop has to know of it."""
    import mujoco

    spec = mujoco.MjSpec()
    spec.modelname = plant.machine.name
    spec.compiler.degree = False
    spec.option.timestep = step = data["dt"] / substeps
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
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


class MujocoSimulation:
    """The shipped loop."""

    def __init__(self, robot: Any) -> None:
        self.robot = robot

    def reset(self, start: Start) -> dict[str, float]:
        found: dict[str, float] = self.robot.reset(start.joints, start.drive, start.commands, start.speeds)
        return found

    def step(self, commands: Array) -> dict[str, float]:
        found: dict[str, float] = self.robot.step(commands)
        return found
