"""An arm in MuJoCo: force axes that move links with masses.

The plant states the commands u of a motion: ``u = scale·Y(q, v, a)·π + (inertia + rotor)·a + friction + bias`` on each axis,
``scale`` its force constant; ``force_constant_error`` multiplies u beside it. In MuJoCo all of it is divided by ``scale``: π
are the masses, centres and inertias of the bodies, the payload is a body of its own, the inertia of the rotor is the armature
of the joint, friction that of the joint, and the actuator turns a command into a true force.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError
from sysid.export.drive_data import FRICTIONS, effect_slots, sensor_readings
from sysid.export.drive_module import load_module, with_classes
from sysid.export.mjcf_bodies import (
    FILE,
    PAYLOAD,
    TINY_INERTIA,
    add_bodies,
    model_names,
    new_spec,
    passive_joints,
    steps_of,
    write_model,
)
from sysid.export.mjcf_drives import add_actuator, dry_friction, limit
from sysid.export.standalone.parts import SensorReading, axis_parameters
from sysid.names import listed
from sysid.plant import Plant, compile_plant
from sysid.plant.arm_inertia import ArmInertia, arm_inertia

Array = npt.NDArray[np.float64]

LOOP = "mujoco_arm.py"
#: Friction of an arm that the loop sets, beside that of an axis without masses.
FRICTION_BY_LOOP = {"load_dependent_friction": f"`{LOOP}`, which sets the dry friction of the joint before each step"}
#: What an arm cannot have beside its masses; effects of its geometry, friction, forces and sensors it can.
NOT_OF_ARMS = ("flexible_drive", "joint_compliance", "gripper_sway")


def write_arm(plant: Plant, rate_hz: float, folder: Path) -> tuple[str, ...]:
    """Write model, table of axes and loop; returns the names of the files.

    Raises:
        SettingsError: axes that are not driven by forces at their joints, effects that the model cannot have, or inertial
            parameters that are not those of a mass distribution.
    """
    from sysid.export.standalone import mujoco_arm

    _check(plant)
    found = arm_inertia(plant)
    spec, about = _spec_of(plant, found, rate_hz)
    about |= {"plant": plant.reference, "inertia_change": found.change}
    return write_model(
        folder, spec, about, LOOP, with_classes(mujoco_arm, "class JointFriction", [SensorReading, axis_parameters])
    )


class MujocoArm:
    """The shipped loop as the simulation of an export."""

    def __init__(self, folder: Path) -> None:
        self.arm = load_module(folder / LOOP).Arm(folder / FILE)

    def run(self, joints: Array, speeds: Array, commands: Array) -> tuple[Array, Array, Array]:
        arm = self.arm
        arm.reset(joints, speeds)
        out = np.empty((3, *commands.shape))
        for k, command in enumerate(commands):
            arm.step(command)
            out[:, k] = arm.data.qpos[arm.places] - arm.offsets, arm.data.qvel[arm.dofs], arm.data.qacc[arm.dofs]
        return out[0], out[1], out[2]

    def forces(self, joints: Array, speeds: Array, accelerations: Array) -> Array:
        found: Array = self.arm.forces(joints, speeds, accelerations)
        return found

    def tips(self, joints: Array) -> Array:
        out = np.empty((len(joints), 3))
        for k, row in enumerate(joints):
            signals = self.arm.reset(row)
            out[k] = [signals[f"ee.{axis}"] for axis in "xyz"]
        return out


def _check(plant: Plant) -> None:
    where = f"export of {plant.machine.name} to mjcf"
    others = [axis.name for axis in plant.machine.axes if axis.actuation != "force" or axis.drives != "joint"]
    if others:
        found = f"{listed(others)} beside force axes that move links with masses"
        raise SettingsError(where, found, "an arm whose axes all are driven by forces at their joints")
    beyond = [f"{e.name} on {e.target}" for e in plant.effects if e.name in NOT_OF_ARMS]
    beyond += [f"a residual network on {r.target}" for r in plant.residuals]
    if beyond:
        remedy = "sysid models shows the effects of a plant; export the version before them."
        raise SettingsError(where, f"{listed(beyond)} in an arm with masses", "friction, forces, masses and geometry", remedy)


def _spec_of(plant: Plant, found: ArmInertia, rate_hz: float) -> tuple[Any, dict[str, Any]]:
    kinematics = plant.machine.kinematics()
    assert kinematics is not None
    substeps = steps_of(rate_hz)
    step = 1.0 / (rate_hz * substeps)
    spec = new_spec(plant, step)
    links = {kinematics.joints[joint].child: own for joint, own in found.bodies.items() if own.mass > 0.0}
    inertias = {link: (np.array([own.mass]), own.centre, own.moments) for link, own in links.items()}
    names = model_names(plant).machine
    add_bodies(spec, plant, names, inertias)
    if found.payload is not None:
        mass, centre = found.payload
        load = spec.body(names.links[kinematics.tip]).add_body(name=names.added[PAYLOAD], pos=centre)
        load.explicitinertial, load.mass, load.ipos = True, mass, np.zeros(3)
        load.fullinertia = [*[TINY_INERTIA] * 3, 0.0, 0.0, 0.0]
    axes = [_axis(spec, plant, i, found, names.joint(plant.machine.axes[i].name), step) for i in range(len(plant.machine.axes))]
    sensors = sensor_readings(compile_plant(plant))
    return spec, {"substeps": substeps, "axes": axes, "passive": passive_joints(plant, names), "sensors": sensors}


def _axis(spec: Any, plant: Plant, i: int, found: ArmInertia, name: str, step: float) -> dict[str, Any]:
    """Complete the joint of an axis and add its actuator; returns its row of the table."""
    axis, scale = plant.machine.axes[i], float(found.scales[i])
    joint, offset = spec.joint(name), effect_slots(plant, "joint_offset", axis.name).get("offset", 0.0)
    laws = [(law, values) for law in FRICTIONS if (values := effect_slots(plant, law, axis.name))]
    share = effect_slots(plant, "load_dependent_friction", axis.name).get("coefficient", 0.0)
    even = {"viscous_friction", "coulomb_friction"}
    native = share == 0.0 and all(name in even and values["positive"] == values["negative"] for name, values in laws)
    means = {name: 0.5 * (values["positive"] + values["negative"]) / scale for name, values in laws if name in even}
    joint.armature = float(found.armatures[i])
    joint.damping = [means.get("viscous_friction", 0.0), 0.0, 0.0]
    dry_friction(joint, means.get("coulomb_friction", 0.0), step)
    if axis.limits is not None:
        limit(joint, [end + offset for end in axis.limits], step)
    actuator = add_actuator(spec, axis.name, joint)
    actuator.gainprm[0] = effect_slots(plant, "force_constant_error", axis.name).get("ratio", 1.0) / scale
    actuator.biasprm[0] = -effect_slots(plant, "load_bias", axis.name).get("force", 0.0) / scale
    mode = "native" if native else "friction"
    about = {"axis": axis.name, "joint": joint.name, "mode": mode, "scale": scale, "offset": offset}
    return about | {"laws": [] if native else laws, "load_dependent_friction": share}
