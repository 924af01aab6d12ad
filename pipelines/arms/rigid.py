"""A serial arm of rigid links, as a URDF for the owner and as MJCF for the simulator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Link:
    """A moving link and the joint before it; the joint's frame is the link's frame.

    Args:
        origin: of the joint in the frame of the link before [m].
        rpy: of the joint's frame, about fixed axes [rad].
        axis: of the joint in its own frame.
        limits: [rad].
        effort: rated torque [N·m].
        mass: [kg].
        centre: centre of mass [m].
        inertia: about the centre of mass, xx, yy, zz, xy, xz, yz [kg·m²].
        armature: rotor inertia behind the gear, at the joint [kg·m²].
    """

    name: str
    origin: tuple[float, float, float]
    axis: tuple[int, int, int]
    limits: tuple[float, float]
    effort: float
    mass: float
    centre: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]
    armature: float = 0.0
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Payload:
    """A body that the last link carries: mass [kg], centre in the frame of the tip [m], inertia about it (a sphere) [kg·m²]."""

    mass: float
    centre: tuple[float, float, float]
    inertia: float


@dataclass(frozen=True)
class RigidArm:
    """Links in kinematic order and the tip in the frame of the last one [m]."""

    links: tuple[Link, ...]
    tip: tuple[float, float, float]
    payload: Payload | None = None

    @property
    def names(self) -> list[str]:
        return [link.name for link in self.links]

    @property
    def limits(self) -> Array:
        """(axes, 2)."""
        return np.array([link.limits for link in self.links])


def solid(mass: float, size: Sequence[float], draw: np.random.Generator | None = None) -> tuple[float, ...]:
    """Inertia of a box about its centre, xx, yy, zz, xy, xz, yz [kg·m²]; turned a little where ``draw`` is given."""
    x, y, z = size
    tensor = np.diag([y * y + z * z, x * x + z * z, x * x + y * y]) * mass / 12.0
    if draw is not None:
        tilt = draw.normal(0.0, 0.1, 3)
        turn = np.eye(3) + np.array([[0, -tilt[2], tilt[1]], [tilt[2], 0, -tilt[0]], [-tilt[1], tilt[0], 0]])
        turn, _ = np.linalg.qr(turn)
        tensor = turn @ tensor @ turn.T
    return (*np.diag(tensor).tolist(), float(tensor[0, 1]), float(tensor[0, 2]), float(tensor[1, 2]))


def urdf_text(arm: RigidArm) -> str:
    """URDF of the arm without its payload; joints are named ``<link>_joint``, the end is ``tip``."""
    parts = ['<?xml version="1.0"?>\n<robot name="arm">\n  <link name="base"/>']
    parent = "base"
    for link in arm.links:
        xx, yy, zz, xy, xz, yz = link.inertia
        parts.append(
            f'  <joint name="{link.name}_joint" type="revolute"><parent link="{parent}"/><child link="{link.name}_link"/>'
            f'<origin xyz="{_text(link.origin)}" rpy="{_text(link.rpy)}"/><axis xyz="{_text(link.axis)}"/>'
            f'<limit lower="{link.limits[0]:.9g}" upper="{link.limits[1]:.9g}" velocity="4" effort="{link.effort:.9g}"/>'
            "</joint>\n"
            f'  <link name="{link.name}_link"><inertial><origin xyz="{_text(link.centre)}"/><mass value="{link.mass:.9g}"/>'
            f'<inertia ixx="{xx:.9g}" iyy="{yy:.9g}" izz="{zz:.9g}" ixy="{xy:.9g}" ixz="{xz:.9g}" iyz="{yz:.9g}"/>'
            "</inertial></link>"
        )
        parent = f"{link.name}_link"
    parts.append(
        f'  <joint name="tip_joint" type="fixed"><parent link="{parent}"/><child link="tip"/><origin xyz="{_text(arm.tip)}"/>'
        '</joint>\n  <link name="tip"/>\n</robot>\n'
    )
    return "\n".join(parts)


def mjcf_text(arm: RigidArm, step: float) -> str:
    """MJCF of the arm with its payload, without actuators, friction or limits: all forces are applied by the caller."""
    parts = [
        f'<mujoco><compiler angle="radian" eulerseq="XYZ"/><option timestep="{step:.9g}" gravity="0 0 -9.81">'
        '<flag contact="disable" constraint="disable"/></option><worldbody>',
        '<body name="base">',
    ]
    for link in arm.links:
        xx, yy, zz, xy, xz, yz = link.inertia
        parts.append(
            f'<body name="{link.name}" pos="{_text(link.origin)}" euler="{_text(link.rpy)}">'
            f'<joint name="{link.name}" type="hinge" axis="{_text(link.axis)}" armature="{link.armature:.12g}"/>'
            f'<inertial pos="{_text(link.centre)}" mass="{link.mass:.12g}" '
            f'fullinertia="{xx:.12g} {yy:.12g} {zz:.12g} {xy:.12g} {xz:.12g} {yz:.12g}"/>'
        )
    parts.append(f'<site name="tip" pos="{_text(arm.tip)}"/>')
    if arm.payload is not None:
        at = np.add(arm.tip, arm.payload.centre)
        parts.append(
            f'<body name="payload" pos="{_text(at)}"><inertial pos="0 0 0" mass="{arm.payload.mass:.12g}" '
            f'diaginertia="{_text([arm.payload.inertia] * 3)}"/></body>'
        )
    parts += ["</body>"] * (len(arm.links) + 1) + ["</worldbody></mujoco>"]
    return "\n".join(parts)


def mujoco_model(arm: RigidArm, step: float = 5e-4) -> tuple[Any, Any]:
    """MuJoCo's model and data of an arm."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(mjcf_text(arm, step))
    return model, mujoco.MjData(model)


def inverse_dynamics(arm: RigidArm, q: Array, v: Array, a: Array) -> Array:
    """Joint torques (n, axes) of the frictionless arm with its payload for a motion, each (n, axes)."""
    import mujoco

    model, data = mujoco_model(arm)
    found = np.empty_like(q)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        found[k] = data.qfrc_inverse
    return found


def _text(values: Any) -> str:
    return " ".join(f"{value:.12g}" for value in values)
