"""Bodies and joints of a machine in MuJoCo: those of its URDF, or one body for each axis where it has none; and composed parts:
cylinders as tendons, backlash as a second joint, a hanging tool as a pendulum.

Joint values are those of the structure. The effects of the geometry are composed: lengths, offset of the tip, and the pose of
the base, with gravity turned with it, so that the world frame is the measured one.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.export.mjcf_drives import ARMATURE, HARD, DriveEntry, Moved, dry_friction, limit
from sysid.export.names import MachineNames, Names
from sysid.export.urdf import (
    APART,
    SMALL_INERTIA,
    SMALL_MASS,
    LinkInertias,
    base_pose,
    link_inertias,
    machine_names,
    stretched,
    tip_offset,
)
from sysid.machine.description import Linkage
from sysid.machine.kinematics import GRAVITY, Joint, Kinematics
from sysid.machine.sources.mjcf_model import mjcf_text
from sysid.machine.urdf_tree import urdf_tree
from sysid.plant import Plant

Array = npt.NDArray[np.float64]
#: Body that is added for the payload of an arm.
PAYLOAD = "payload"
#: Radius of the line drawn along a link [m]; it neither collides nor has mass.
DRAWN = 0.01
#: Mass [kg] and inertia [kg·m²] of a body without them beside links whose torques count: MuJoCo accepts no less than 10⁻¹⁵.
TINY_MASS, TINY_INERTIA = 1e-12, 1e-13


#: The model; a table of its axes has the same stem.
FILE = "robot.xml"
#: Longest step of an integrator [s]; a sample of the machine is a whole number of steps.
LONGEST_STEP = 1e-3


def steps_of(rate_hz: float) -> int:
    """Steps in a sample of the machine, of at most :data:`LONGEST_STEP` each."""
    return max(1, math.ceil(1.0 / (rate_hz * LONGEST_STEP) - 1e-9))


def new_spec(plant: Plant, step: float) -> Any:
    """An ``MjSpec`` without bodies, for steps of the implicit integrator of ``step`` [s]."""
    spec = _mujoco().MjSpec()
    spec.modelname = plant.machine.name
    spec.compiler.degree = False
    spec.option.timestep = step
    spec.option.integrator = _mujoco().mjtIntegrator.mjINT_IMPLICITFAST
    return spec


def write_model(folder: Path, spec: Any, about: Mapping[str, Any], loop: str, source: str) -> tuple[str, str, str]:
    """Write a model, its table of axes and the loop that runs it; returns the names of the files."""
    table = Path(FILE).with_suffix(".json").name
    for name, text in ((FILE, mjcf_text(spec)), (table, json.dumps(about, indent=1)), (loop, source)):
        (folder / name).write_text(text, "utf-8")
    return FILE, table, loop


@dataclass(frozen=True)
class ModelNames:
    """Names in a model of MuJoCo: of the machine, and the namespaces of its bodies and joints for what is added to it."""

    machine: MachineNames
    bodies: Names
    joints: Names


def model_names(plant: Plant) -> ModelNames:
    """Those of a plant."""
    bodies, joints = Names(["world"]), Names()
    added = [part for part in (PAYLOAD,) if plant.effect("payload", "tool") is not None]
    return ModelNames(machine_names(plant, bodies, joints, added), bodies, joints)


def add_bodies(spec: Any, plant: Plant, names: MachineNames, inertias: LinkInertias | None = None) -> None:
    """Add the bodies of a plant to an ``MjSpec``, with a site ``ee`` where it has a URDF.

    Args:
        inertias: of the links, instead of those of the URDF; a link without is given none that a torque would notice.
    """
    kinematics = plant.machine.kinematics()
    if kinematics is None or plant.machine.urdf_text is None:
        _plain_bodies(spec, plant, names)
        return
    turn, place = base_pose(plant)
    root = spec.worldbody.add_body(name=names.links[kinematics.chain[0].parent], pos=place, quat=quaternion(turn))
    spec.option.gravity = turn @ np.array([0.0, 0.0, -plant.machine.gravity])
    least = (SMALL_MASS, SMALL_INERTIA) if inertias is None else (TINY_MASS, TINY_INERTIA)
    known = link_inertias(urdf_tree(plant.machine.urdf_text)) if inertias is None else inertias
    _Tree(spec, plant, names, kinematics, known, least).add(root, kinematics.chain[0].parent)


@dataclass(frozen=True)
class _Tree:
    """Links of a URDF as bodies; ``least`` mass [kg] and inertia [kg·m²] of a body."""

    spec: Any
    plant: Plant
    names: MachineNames
    kinematics: Kinematics
    inertias: LinkInertias
    least: tuple[float, float]

    def add(self, body: Any, link: str) -> None:
        """Complete the body of a link, with all that hangs on it."""
        mass, centre, inertia = self.inertias.get(link, (np.zeros(1), np.zeros(3), np.zeros((3, 3))))
        body.explicitinertial = True
        body.mass, body.ipos = max(float(mass[0]), self.least[0]), centre
        moments = inertia + self.least[1] * np.eye(3)
        body.fullinertia = [moments[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        if link == self.kinematics.tip:
            body.add_site(name="ee").pos = tip_offset(self.plant, self.kinematics)
        for joint in self.kinematics.joints.values():
            if joint.parent != link:
                continue
            child = body.add_body(name=self.names.links[joint.child])
            child.pos = stretched(joint, self.plant, self.kinematics)
            child.quat = quaternion(joint.origin[:3, :3])
            if float(np.linalg.norm(child.pos)) > DRAWN:
                body.add_geom(
                    type=_mujoco().mjtGeom.mjGEOM_CAPSULE, fromto=[0.0, 0.0, 0.0, *child.pos], size=[DRAWN, 0.0, 0.0],
                    contype=0, conaffinity=0, group=1, mass=0.0,
                )  # fmt: skip
            if joint.name in self.kinematics.drives:
                self._joint(child, joint)
            self.add(child, joint.child)

    def _joint(self, child: Any, joint: Joint) -> None:
        kinds, names = _mujoco().mjtJoint, self.names.joints
        added = child.add_joint(name=names[joint.name], axis=joint.axis)
        added.type = kinds.mjJNT_SLIDE if joint.prismatic else kinds.mjJNT_HINGE
        drive = self.kinematics.drives[joint.name]
        master = self.kinematics.actuated[drive.column]
        if joint.name != master:  # a passive joint follows its axis
            equality = self.spec.add_equality(name=f"{added.name}_follows", name1=added.name, name2=names[master])
            equality.type, equality.objtype = _mujoco().mjtEq.mjEQ_JOINT, _mujoco().mjtObj.mjOBJ_JOINT
            equality.data[:5] = [drive.offset, drive.ratio, 0.0, 0.0, 0.0]
            equality.solref, equality.solimp = [2.0 * self.spec.option.timestep, 1.0], HARD


def _plain_bodies(spec: Any, plant: Plant, names: MachineNames) -> None:
    """A body for each axis, side by side: hinges about z, slides along x."""
    kinds = _mujoco().mjtJoint
    for k, axis in enumerate(plant.machine.axes):
        body = spec.worldbody.add_body(name=names.links[f"{axis.name}_link"], pos=[0.0, APART * k, 0.0])
        body.mass, body.ipos = SMALL_MASS, np.zeros(3)
        body.explicitinertial, body.fullinertia = True, [*[SMALL_INERTIA] * 3, 0.0, 0.0, 0.0]
        slides = axis.joint_type == "prismatic"
        joint = body.add_joint(name=names.joint(axis.name), axis=[1.0, 0.0, 0.0] if slides else [0.0, 0.0, 1.0])
        joint.type = kinds.mjJNT_SLIDE if slides else kinds.mjJNT_HINGE


def passive_joints(plant: Plant, written: MachineNames) -> list[dict[str, Any]]:
    """Passive joints and the axes that they follow."""
    kinematics = plant.machine.kinematics()
    if kinematics is None:
        return []
    names = plant.machine.axis_names
    return [
        {"joint": written.joints[joint], "axis": names[drive.column], "ratio": drive.ratio, "offset": drive.offset}
        for joint, drive in kinematics.drives.items()
        if joint not in kinematics.actuated
    ]


def quaternion(rotation: Array) -> Array:
    """Unit quaternion (w, x, y, z) of a rotation matrix."""
    found = np.zeros(4)
    _mujoco().mju_mat2Quat(found, np.ascontiguousarray(rotation).ravel())
    return found


def _mujoco() -> Any:
    import mujoco

    return mujoco


#: A joint behind a backlash rests by friction until the drive has crossed it, as in the plant, whatever its load: its armature
#: is far above that of the links, its friction stops it within a step at :data:`FASTEST_SPEED` [rad/s or m/s], and the drive is
#: far above both.
BEHIND, FASTEST_SPEED, DRIVE_RATIO = 1e3, 10.0, 1e6
#: Mass of a hanging tool [kg]: it swings, and no drive notices it.
TOOL_MASS, TOOL_INERTIA = 1e-9, 1e-14
#: Inertia of the gimbal above it [kg·m²]: the damping of any tool turns it by less than 10⁻⁴ rad/s².
GIMBAL_INERTIA = 1e-3


def moved_by(spec: Any, names: ModelNames, entry: DriveEntry, axis: dict[str, Any], joint: Any, step: float) -> Moved:
    """What the actuator of an axis moves, with the second joint of a backlash and the tendon of a cylinder."""
    driven = joint
    if entry.backlash is not None:
        driven = _driven_joint(spec, names, joint, entry.backlash[0], step)
    if entry.triangle is None:
        return Moved(driven, driven.name, False, axis["offset"])
    tendon = _cylinder(spec, axis["name"], driven, entry.triangle, axis["offset"])
    return Moved(tendon, driven.name, True, entry.triangle.retracted)


def _driven_joint(spec: Any, names: ModelNames, joint: Any, width: float, step: float) -> Any:
    """A joint beside ``joint`` with the same axis, which moves it when the backlash is crossed."""
    body = joint.parent
    carrier = body.parent.add_body(name=names.bodies.new(f"{joint.name}_drive_body"), pos=body.pos, quat=body.quat)
    carrier.explicitinertial, carrier.mass, carrier.ipos = True, 1e-9, np.zeros(3)
    carrier.fullinertia = [1e-9, 1e-9, 1e-9, 0.0, 0.0, 0.0]
    driven = carrier.add_joint(name=names.joints.new(f"{joint.name}_drive"), axis=joint.axis, type=joint.type)
    joint.armature = BEHIND
    dry_friction(joint, BEHIND * FASTEST_SPEED / step, step)
    play = spec.add_tendon(name=f"{joint.name}_backlash")
    play.wrap_joint(joint.name, 1.0)
    play.wrap_joint(driven.name, -1.0)
    limit(play, [-0.5 * width, 0.5 * width], step)
    return driven


def _cylinder(spec: Any, name: str, joint: Any, triangle: Linkage, offset: float) -> Any:
    """A tendon between two points at the levers' distances from the joint; its length is that of the cylinder."""
    body = joint.parent
    axis = np.asarray(joint.axis) / np.linalg.norm(joint.axis)
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first /= np.linalg.norm(first)
    angle = triangle.offset - offset
    second = math.cos(angle) * first + math.sin(angle) * np.cross(axis, first)
    turn = np.zeros(9)
    _mujoco().mju_quat2Mat(turn, np.asarray(body.quat, dtype=np.float64))
    fixed = np.asarray(body.pos) + turn.reshape(3, 3) @ (triangle.a * first)
    body.parent.add_site(name=f"{name}_cylinder_base", pos=fixed)
    body.add_site(name=f"{name}_cylinder_rod", pos=triangle.b * second)
    tendon = spec.add_tendon(name=f"{name}_cylinder")
    tendon.wrap_site(f"{name}_cylinder_base")
    tendon.wrap_site(f"{name}_cylinder_rod")
    return tendon


def heavier_drive(moved: Moved, actuator: Any) -> None:
    """Raise a source of motion above the friction of a joint behind a backlash: armature and servo by one ratio."""
    moved.element.armature = ARMATURE * DRIVE_RATIO
    actuator.gainprm[0] *= DRIVE_RATIO
    actuator.biasprm[:3] = np.asarray(actuator.biasprm[:3]) * DRIVE_RATIO


def add_tool(names: ModelNames, tip: Any, place: Array, length: float, damping_ratio: float) -> str:
    """A point mass on a ball joint below a gimbal: a damped spherical pendulum.

    The damping of the plant acts against the motion of the tool relative to the tip, that of a joint against its rotation
    relative to the body above it. That body is therefore a gimbal: a free ball joint at the tip, without mass but with an
    inertia that the damping does not turn, so that it moves with the tip and does not rotate.

    Args:
        tip: body that carries the measured point at ``place`` (3,) [m].

    Returns:
        The name of the joint of the gimbal.
    """
    gimbal = tip.add_body(name=names.bodies.new("tool_gimbal"), pos=place)
    _light(gimbal, np.zeros(3), GIMBAL_INERTIA)
    free = gimbal.add_joint(name=names.joints.new("tool_gimbal"), type=_mujoco().mjtJoint.mjJNT_BALL)
    tool = gimbal.add_body(name=names.bodies.new("hanging_tool"))
    _light(tool, np.array([0.0, 0.0, -length]), TOOL_INERTIA)
    ball = tool.add_joint(name=names.joints.new("tool_swing"), type=_mujoco().mjtJoint.mjJNT_BALL)
    ball.damping = [2.0 * damping_ratio * math.sqrt(GRAVITY / length) * TOOL_MASS * length**2, 0.0, 0.0]
    tool.add_site(name="tool", pos=[0.0, 0.0, -length])
    return str(free.name)


def _light(body: Any, centre: Array, inertia: float) -> None:
    body.explicitinertial, body.mass, body.ipos = True, TOOL_MASS, centre
    body.fullinertia = [inertia, inertia, inertia, 0.0, 0.0, 0.0]
