"""Composed parts of a machine in MuJoCo: cylinders as tendons, backlash as a second joint, a hanging tool as a pendulum."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.export.mjcf_bodies import ModelNames
from sysid.export.mjcf_drives import ARMATURE, DriveEntry, Moved, dry_friction, limit
from sysid.machine.description import Linkage
from sysid.machine.kinematics import GRAVITY

Array = npt.NDArray[np.float64]

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


def _mujoco() -> Any:
    import mujoco

    return mujoco
