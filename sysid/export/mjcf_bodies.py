"""Bodies and joints of a machine in MuJoCo: those of its URDF, or one body for each axis where it has none.

Joint values are those of the structure. The effects of the geometry are composed: lengths, offset of the tip, and the pose of
the base, with gravity turned with it, so that the world frame is the measured one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.export.geometry import base_pose, stretched, tip_offset
from sysid.export.link_inertia import SMALL_INERTIA, SMALL_MASS, LinkInertias, link_inertias
from sysid.machine.kinematics import Joint, Kinematics
from sysid.machine.moved_bodies import GRAVITY
from sysid.plant import Plant

Array = npt.NDArray[np.float64]
#: Distance between the bodies of axes without a URDF [m].
APART = 0.5
#: Radius of the line drawn along a link [m]; it neither collides nor has mass.
DRAWN = 0.01
#: Mass [kg] and inertia [kg·m²] of a body without them beside links whose torques count: MuJoCo accepts no less than 10⁻¹⁵.
TINY_MASS, TINY_INERTIA = 1e-12, 1e-13


@dataclass(frozen=True)
class Bodies:
    """Names in the model: joint of each axis; body that carries it and body that it moves; whether there is a site ``ee``."""

    joints: tuple[str, ...]
    parents: tuple[str, ...]
    children: tuple[str, ...]
    posed: bool


def add_bodies(spec: Any, plant: Plant, inertias: LinkInertias | None = None) -> Bodies:
    """Add the bodies of a plant to an ``MjSpec``.

    Args:
        inertias: of the links, instead of those of the URDF; a link without is given none that a torque would notice.
    """
    kinematics = plant.machine.kinematics()
    if kinematics is None or plant.machine.urdf_text is None:
        return _plain_bodies(spec, plant)
    turn, place = base_pose(plant)
    root = spec.worldbody.add_body(name=kinematics.chain[0].parent, pos=place, quat=quaternion(turn))
    spec.option.gravity = turn @ np.array([0.0, 0.0, -GRAVITY])
    least = (SMALL_MASS, SMALL_INERTIA) if inertias is None else (TINY_MASS, TINY_INERTIA)
    known = link_inertias(plant.machine.urdf_text) if inertias is None else inertias
    _children(spec, root, kinematics.chain[0].parent, plant, kinematics, known, least)
    joints = tuple(str(axis.joint) for axis in plant.machine.axes)
    found = [kinematics.joints[name] for name in joints]
    return Bodies(joints, tuple(j.parent for j in found), tuple(j.child for j in found), True)


def _children(
    spec: Any, body: Any, link: str, plant: Plant, kinematics: Kinematics, inertias: LinkInertias, least: tuple[float, float]
) -> None:
    """Add what hangs on a link, with its joints; ``least`` mass [kg] and inertia [kg·m²] of a body."""
    mass, centre, inertia = inertias.get(link, (np.zeros(1), np.zeros(3), np.zeros((3, 3))))
    body.explicitinertial = True
    body.mass, body.ipos = max(float(mass[0]), least[0]), centre
    moments = inertia + least[1] * np.eye(3)
    body.fullinertia = [moments[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    if link == kinematics.tip:
        site = body.add_site(name="ee")
        site.pos = tip_offset(plant, kinematics)
    for joint in kinematics.joints.values():
        if joint.parent != link:
            continue
        child = body.add_body(name=joint.child)
        child.pos, child.quat = stretched(joint, plant, kinematics), quaternion(joint.origin[:3, :3])
        length = float(np.linalg.norm(child.pos))
        if length > DRAWN:
            body.add_geom(type=_mujoco().mjtGeom.mjGEOM_CAPSULE, fromto=[0.0, 0.0, 0.0, *child.pos], size=[DRAWN, 0.0, 0.0],
                          contype=0, conaffinity=0, group=1, mass=0.0)  # fmt: skip
        if joint.kind != "fixed" and joint.name in kinematics.drives:
            _joint(spec, child, joint, kinematics)
        _children(spec, child, joint.child, plant, kinematics, inertias, least)


def _joint(spec: Any, child: Any, joint: Joint, kinematics: Kinematics) -> None:
    kinds = _mujoco().mjtJoint
    added = child.add_joint(name=joint.name, axis=joint.axis)
    added.type = kinds.mjJNT_SLIDE if joint.prismatic else kinds.mjJNT_HINGE
    drive = kinematics.drives[joint.name]
    master = kinematics.actuated[drive.column]
    if joint.name != master:  # a passive joint follows its axis
        equality = spec.add_equality(name=f"{joint.name}_follows", name1=joint.name, name2=master)
        equality.type, equality.objtype = _mujoco().mjtEq.mjEQ_JOINT, _mujoco().mjtObj.mjOBJ_JOINT
        equality.data[:5] = [drive.offset, drive.ratio, 0.0, 0.0, 0.0]


def _plain_bodies(spec: Any, plant: Plant) -> Bodies:
    """A body for each axis, side by side: hinges about z, slides along x."""
    mujoco, names = _mujoco(), []
    for k, axis in enumerate(plant.machine.axes):
        body = spec.worldbody.add_body(name=f"{axis.name}_body", pos=[0.0, APART * k, 0.0])
        body.mass, body.ipos = SMALL_MASS, np.zeros(3)
        body.explicitinertial, body.fullinertia = True, [*[SMALL_INERTIA] * 3, 0.0, 0.0, 0.0]
        slides = axis.joint_type == "prismatic"
        joint = body.add_joint(name=axis.joint or axis.name, axis=[1.0, 0.0, 0.0] if slides else [0.0, 0.0, 1.0])
        joint.type = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
        names.append(joint.name)
    return Bodies(tuple(names), ("world",) * len(names), tuple(f"{a.name}_body" for a in plant.machine.axes), False)


def passive_joints(plant: Plant) -> list[dict[str, Any]]:
    """Passive joints and the axes that they follow."""
    kinematics = plant.machine.kinematics()
    if kinematics is None:
        return []
    names = plant.machine.axis_names
    return [
        {"joint": joint, "axis": names[drive.column], "ratio": drive.ratio, "offset": drive.offset}
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
