"""A machine as a USD stage: links, joints and masses by UsdPhysics, with the schemas of Newton beside them, and its drives: the
schema's own dynamics for axes that need no more, position drives for the others.

UsdPhysics measures the angles of joints in degrees, and their gains and damping per degree; Newton actuators in radians.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt

from sysid.export.mjcf_drives import ARMATURE
from sysid.export.names import MachineNames, Names, identifier
from sysid.export.urdf import (
    END_EFFECTOR,
    SMALL_INERTIA,
    SMALL_MASS,
    base_pose,
    link_inertias,
    machine_names,
    tip_offset,
    urdf_of,
)
from sysid.machine.kinematics import origin_pose, pose_of
from sysid.plant import Plant

Array = npt.NDArray[np.float64]
ROOT, SCENE, ANCHOR = "/Machine", "/PhysicsScene", "base_joint"


@dataclass(frozen=True)
class JointEntry:
    """A joint of the stage.

    Args:
        name, parent, child: of its prim and of those of the bodies, the parent empty for the world.
        angular: of a revolute or continuous joint; ``fixed``: without a degree of freedom.
        limits: [rad or m], None for none.
    """

    name: str
    parent: str
    child: str
    kind: str
    pose: Array
    axis: Array
    limits: tuple[float, float] | None
    mimic: tuple[str, float, float] | None

    @property
    def path(self) -> str:
        return joint_path(self.name)

    @property
    def angular(self) -> bool:
        return self.kind in ("revolute", "continuous")


def usd_names(plant: Plant) -> MachineNames:
    """Names of the links, joints and actuators of a plant in a stage."""
    actuators = Names(form=identifier).each(plant.machine.axis_names)
    return replace(machine_names(plant, Names(form=identifier), Names(form=identifier), (), [ANCHOR]), axes=actuators)


def write_bodies(stage: Any, plant: Plant, names: MachineNames, steps_per_second: int) -> dict[str, JointEntry]:
    """Scene, links and joints of a plant; returns the joints by their names in the stage."""
    from pxr import Gf, UsdGeom, UsdPhysics

    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    turn, place = base_pose(plant)
    scene = UsdPhysics.Scene.Define(stage, SCENE)
    scene.CreateGravityDirectionAttr(Gf.Vec3f(*map(float, turn @ np.array([0.0, 0.0, -1.0]))))
    scene.CreateGravityMagnitudeAttr(plant.machine.gravity)
    scene.GetPrim().ApplyAPI("NewtonSceneAPI")
    set_value(scene.GetPrim(), "newton:timeStepsPerSecond", steps_per_second)
    root = UsdGeom.Xform.Define(stage, ROOT)
    stage.SetDefaultPrim(root.GetPrim())
    UsdPhysics.ArticulationRootAPI.Apply(root.GetPrim())
    for group in ("links", "joints", "actuators"):
        UsdGeom.Scope.Define(stage, f"{ROOT}/{group}")
    urdf = urdf_of(plant, names)
    joints = _joints(urdf)
    inertias, anchor = link_inertias(urdf), pose_of(turn, place)
    poses = _link_poses(joints, anchor)
    for link, pose in poses.items():
        _link(stage, link, pose, inertias.get(link, (np.zeros(1), np.zeros(3), np.zeros((3, 3)))))
    base = next(link for link in poses if link not in {joint.child for joint in joints})
    for joint in [JointEntry(names.added[ANCHOR], "", base, "fixed", anchor, np.array([1.0, 0.0, 0.0]), None, None), *joints]:
        _joint(stage, joint)
    by_name = {joint.name: joint for joint in joints}
    _follow(stage, by_name)
    kinematics = plant.machine.kinematics()
    if kinematics is not None:
        point = UsdGeom.Xform.Define(stage, f"{link_path(names.links[kinematics.tip])}/{END_EFFECTOR}")
        point.AddTranslateOp().Set(Gf.Vec3d(*map(float, tip_offset(plant, kinematics))))
        point.GetPrim().ApplyAPI("NewtonSiteAPI")
    return by_name


def link_path(link: str) -> str:
    return f"{ROOT}/links/{link}"


def joint_path(joint: str) -> str:
    return f"{ROOT}/joints/{joint}"


def set_value(prim: Any, name: str, value: float) -> None:
    """Author a number of an applied schema."""
    from pxr import Sdf

    kinds = Sdf.ValueTypeNames
    prim.CreateAttribute(name, kinds.Int if isinstance(value, int) else kinds.Float).Set(value)


def _joints(root: Element) -> list[JointEntry]:
    """Joints of a URDF."""
    found = []
    for joint in root.findall("joint"):
        parent, child = (str(joint.find(side).get("link")) for side in ("parent", "child"))  # type: ignore[union-attr]
        kind, name = str(joint.get("type")), str(joint.get("name"))
        axis, limit, mimic = joint.find("axis"), joint.find("limit"), joint.find("mimic")
        direction = np.array([float(x) for x in (axis.get("xyz", "1 0 0") if axis is not None else "1 0 0").split()])
        bounded = limit is not None and kind in ("revolute", "prismatic")
        ends = tuple(float(limit.get(end, "0")) for end in ("lower", "upper")) if bounded and limit is not None else None
        leader = None
        if mimic is not None:
            leader = str(mimic.get("joint")), float(mimic.get("offset", "0")), float(mimic.get("multiplier", "1"))
        pose = origin_pose(joint.find("origin"))
        along = direction / np.linalg.norm(direction)
        found.append(JointEntry(name, parent, child, kind, pose, along, ends, leader))  # type: ignore[arg-type]
    return found


def _link_poses(joints: list[JointEntry], root: Array) -> dict[str, Array]:
    """Poses (4, 4) of the links in the world, all joints at zero, parents first; ``root``: that of links without a parent."""
    children = {joint.child for joint in joints}
    roots = dict.fromkeys(joint.parent for joint in joints if joint.parent not in children)
    poses = dict.fromkeys(roots, root)
    waiting = list(joints)
    while waiting:
        ready = [joint for joint in waiting if joint.parent in poses]
        for joint in ready:
            poses[joint.child] = poses[joint.parent] @ joint.pose
        waiting = [joint for joint in waiting if joint not in ready]
    return poses


def _link(stage: Any, link: str, pose: Array, inertia: tuple[Array, ...]) -> None:
    from pxr import Gf, UsdGeom, UsdPhysics

    body = UsdGeom.Xform.Define(stage, link_path(link))
    body.AddTranslateOp().Set(Gf.Vec3d(*map(float, pose[:3, 3])))
    body.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(_quaternion(pose[:3, :3])))
    UsdPhysics.RigidBodyAPI.Apply(body.GetPrim())
    mass = UsdPhysics.MassAPI.Apply(body.GetPrim())
    moments, axes = np.linalg.eigh(inertia[2])
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] *= -1.0
    mass.CreateMassAttr(max(float(inertia[0][0]), SMALL_MASS))
    mass.CreateCenterOfMassAttr(Gf.Vec3f(*map(float, inertia[1])))
    mass.CreateDiagonalInertiaAttr(Gf.Vec3f(*map(float, moments + SMALL_INERTIA)))
    mass.CreatePrincipalAxesAttr(Gf.Quatf(_quaternion(axes)))


def _joint(stage: Any, entry: JointEntry) -> None:
    """A joint whose frame on both bodies has the axis of motion as x, the normal of a planar one; a floating one is none."""
    from pxr import Gf, UsdPhysics

    if entry.kind == "floating":
        return
    kinds = {
        "revolute": UsdPhysics.RevoluteJoint,
        "continuous": UsdPhysics.RevoluteJoint,
        "prismatic": UsdPhysics.PrismaticJoint,
        "planar": UsdPhysics.Joint,
    }
    joint = kinds.get(entry.kind, UsdPhysics.FixedJoint).Define(stage, entry.path)
    if entry.parent:
        joint.CreateBody0Rel().SetTargets([link_path(entry.parent)])
    joint.CreateBody1Rel().SetTargets([link_path(entry.child)])
    along = _turn_to(entry.axis)
    joint.CreateLocalPos0Attr(Gf.Vec3f(*map(float, entry.pose[:3, 3])))
    joint.CreateLocalRot0Attr(Gf.Quatf(_quaternion(entry.pose[:3, :3] @ along)))
    joint.CreateLocalPos1Attr(Gf.Vec3f(0.0))
    joint.CreateLocalRot1Attr(Gf.Quatf(_quaternion(along)))
    if entry.kind == "planar":
        for locked in ("transX", "rotY", "rotZ"):
            limit = UsdPhysics.LimitAPI.Apply(joint.GetPrim(), locked)
            limit.CreateLowAttr(1.0)  # above the upper end: locked
            limit.CreateHighAttr(-1.0)
    elif entry.kind in kinds:
        joint.CreateAxisAttr("X")
        if entry.limits is not None:
            low, high = (math.degrees(x) if entry.angular else x for x in entry.limits)
            joint.CreateLowerLimitAttr(low)
            joint.CreateUpperLimitAttr(high)


def mimics(joint: JointEntry, joints: Mapping[str, JointEntry]) -> bool:
    """Whether a joint follows another of its own kind, as NewtonMimicAPI requires: it has no units for others."""
    return joint.mimic is not None and joint.angular == joints[joint.mimic[0]].angular


def _follow(stage: Any, joints: Mapping[str, JointEntry]) -> None:
    for joint in joints.values():
        if joint.mimic is not None and mimics(joint, joints):
            leader, offset, ratio = joint.mimic
            prim = stage.GetPrimAtPath(joint.path)
            prim.ApplyAPI("NewtonMimicAPI")
            prim.CreateRelationship("newton:mimicJoint").SetTargets([joint_path(leader)])
            offset = math.degrees(offset) if joint.angular else offset
            set_value(prim, "newton:mimicCoef0", offset)
            set_value(prim, "newton:mimicCoef1", ratio)


def _turn_to(axis: Array) -> Array:
    """A rotation (3, 3) that turns x to a unit axis."""
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    second = np.cross(axis, other)
    second /= np.linalg.norm(second)
    return np.column_stack([axis, second, np.cross(axis, second)])


def _quaternion(turn: Array) -> Any:
    """Unit quaternion of a rotation matrix; USD multiplies rows from the left."""
    from pxr import Gf

    return Gf.Matrix3d(*map(float, turn.T.ravel())).ExtractRotation().GetQuat()


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

    prim = _driven_joint(stage, joint, ARMATURE)
    drive = UsdPhysics.DriveAPI.Apply(prim, "angular" if joint.angular else "linear")
    drive.CreateTypeAttr("force")
    drive.CreateStiffnessAttr(per_unit(ARMATURE * steps_per_second**2, joint))
    drive.CreateDampingAttr(per_unit(2.0 * ARMATURE * steps_per_second, joint))
    drive.CreateTargetPositionAttr(0.0)


def _force(stage: Any, axis: dict[str, Any], name: str, joint: JointEntry) -> None:
    """Mass, damping and friction of the joint; the force is the feedforward of an actuator with a constant effort."""
    laws = dict(axis["frictions"])
    prim = _driven_joint(stage, joint, axis["mass"])
    damping = laws.get("viscous_friction", {"positive": 0.0})["positive"]
    set_value(prim, "newton:damping", per_unit(damping, joint))
    set_value(prim, "newton:friction", laws.get("coulomb_friction", {"positive": 0.0})["positive"])
    actuator = _actuator(stage, name, joint)
    actuator.ApplyAPI("NewtonPDControlAPI")
    set_value(actuator, "newton:constEffort", -axis["bias"])


def _delayed(stage: Any, axis: dict[str, Any], name: str, joint: JointEntry, steps_per_second: int) -> None:
    """A servo that reaches its delayed target in two steps of an explicit integrator (kp = m/h², kd = m/h)."""
    _driven_joint(stage, joint, ARMATURE)
    actuator = _actuator(stage, name, joint)
    actuator.ApplyAPI("NewtonPDControlAPI")
    set_value(actuator, "newton:kp", ARMATURE * steps_per_second**2)
    set_value(actuator, "newton:kd", ARMATURE * steps_per_second)
    actuator.ApplyAPI("NewtonActuatorDelayAPI")
    delay = dict(axis["command"])["input_delay"]["delay"]
    set_value(actuator, "newton:delaySteps", round(delay * steps_per_second))


def _driven_joint(stage: Any, joint: JointEntry, armature: float) -> Any:
    prim = stage.GetPrimAtPath(joint.path)
    prim.ApplyAPI("NewtonJointAPI")
    set_value(prim, "newton:armature", armature)
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
