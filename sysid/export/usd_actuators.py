"""Drives of a machine in a USD stage: the schema's own dynamics for axes that need no more, position drives for the others."""

from __future__ import annotations

import math
from typing import Any

from sysid.export.mjcf_drives import ARMATURE
from sysid.export.usd_stage import ROOT, JointEntry, set_value

#: Effects of a force axis that the joint or its actuator has.
FORCE_NATIVE = ("viscous_friction", "coulomb_friction")


def is_native(axis: dict[str, Any]) -> bool:
    """Whether the schemas have all effects of an axis of the drive data: else its joint follows the drive model."""
    between = any(axis[f"{side}_{what}"] for side in ("drive", "structure") for what in ("backlash", "compliance"))
    if between or axis["drives"] == "cylinder":
        return False
    if axis["actuation"] == "position":
        return [name for name, _ in axis["command"]] == ["input_delay"]
    if axis["actuation"] != "force" or axis["rotor"] != "rigid_drive":
        return False
    return all(name in FORCE_NATIVE and values["positive"] == values["negative"] for name, values in axis["frictions"])


def write_drive(stage: Any, axis: dict[str, Any], name: str, joint: JointEntry, steps_per_second: int) -> None:
    """Drive of an axis, ``name`` in the stage, and the passive dynamics of its joint."""
    if not is_native(axis):
        write_follower(stage, joint, steps_per_second)
    elif axis["actuation"] == "force":
        _force(stage, axis, name, joint)
    else:
        _delayed(stage, axis, name, joint, steps_per_second)


def write_follower(stage: Any, joint: JointEntry, steps_per_second: int) -> None:
    """A drive to the target position, critically damped against the armature; solvers integrate it implicitly."""
    from pxr import UsdPhysics

    prim = _joint(stage, joint, ARMATURE)
    drive = UsdPhysics.DriveAPI.Apply(prim, "angular" if joint.angular else "linear")
    drive.CreateTypeAttr("force")
    drive.CreateStiffnessAttr(per_unit(ARMATURE * steps_per_second**2, joint))
    drive.CreateDampingAttr(per_unit(2.0 * ARMATURE * steps_per_second, joint))
    drive.CreateTargetPositionAttr(0.0)


def _force(stage: Any, axis: dict[str, Any], name: str, joint: JointEntry) -> None:
    """Mass, damping and friction of the joint; the force is the feedforward of an actuator with a constant effort."""
    from pxr import Sdf

    laws, kind = dict(axis["frictions"]), Sdf.ValueTypeNames.Float
    prim = _joint(stage, joint, axis["mass"])
    damping = laws.get("viscous_friction", {"positive": 0.0})["positive"]
    set_value(prim, "newton:damping", kind, per_unit(damping, joint))
    set_value(prim, "newton:friction", kind, laws.get("coulomb_friction", {"positive": 0.0})["positive"])
    actuator = _actuator(stage, name, joint)
    actuator.ApplyAPI("NewtonPDControlAPI")
    set_value(actuator, "newton:constEffort", kind, -axis["bias"])


def _delayed(stage: Any, axis: dict[str, Any], name: str, joint: JointEntry, steps_per_second: int) -> None:
    """A servo that reaches its delayed target in two steps of an explicit integrator (kp = m/h², kd = m/h)."""
    from pxr import Sdf

    _joint(stage, joint, ARMATURE)
    actuator = _actuator(stage, name, joint)
    actuator.ApplyAPI("NewtonPDControlAPI")
    set_value(actuator, "newton:kp", Sdf.ValueTypeNames.Float, ARMATURE * steps_per_second**2)
    set_value(actuator, "newton:kd", Sdf.ValueTypeNames.Float, ARMATURE * steps_per_second)
    actuator.ApplyAPI("NewtonActuatorDelayAPI")
    delay = dict(axis["command"])["input_delay"]["delay"]
    set_value(actuator, "newton:delaySteps", Sdf.ValueTypeNames.Int, round(delay * steps_per_second))


def _joint(stage: Any, joint: JointEntry, armature: float) -> Any:
    from pxr import Sdf

    prim = stage.GetPrimAtPath(joint.path)
    prim.ApplyAPI("NewtonJointAPI")
    set_value(prim, "newton:armature", Sdf.ValueTypeNames.Float, armature)
    return prim


def _actuator(stage: Any, name: str, joint: JointEntry) -> Any:
    prim = stage.DefinePrim(actuator_path(name), "NewtonActuator")
    prim.CreateRelationship("newton:targets").SetTargets([joint.path])
    return prim


def actuator_path(axis: str) -> str:
    return f"{ROOT}/actuators/{axis}"


def per_unit(value: float, joint: JointEntry) -> float:
    """A gain or damping per radian or metre in the unit of a joint's attributes: per degree or metre."""
    return math.radians(value) if joint.angular else value
