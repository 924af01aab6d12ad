"""The crane's own forward kinematics, written out for its four joints.

Base frame: x forward at slew zero, z up, origin on the slewing axis at the foot. Boom and stick turn about the horizontal axis,
positive upwards; the stick is in line with the boom at zero; the telescope extends along the stick.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from simulated_bench.compiled import compiled
from simulated_bench.recipe import GeometrySettings

Array = npt.NDArray[np.float64]


@compiled
def tip_position(
    slew: float, boom: float, stick: float, telescope: float, height: float, boom_length: float, stick_length: float
) -> tuple[float, float, float]:
    """Boom tip in the base frame [m]."""
    outer = stick_length + telescope
    reach = boom_length * math.cos(boom) + outer * math.cos(boom + stick)
    z = height + boom_length * math.sin(boom) + outer * math.sin(boom + stick)
    return reach * math.cos(slew), reach * math.sin(slew), z


def link_poses(geometry: GeometrySettings, joints: Array, rod: Array) -> dict[str, tuple[Array, Array]]:
    """Rotation (n, 3, 3) and origin (n, 3) of every link that carries a rigid body, in the base frame.

    Args:
        joints: slew, boom, stick, telescope, (n, 4) [rad, rad, rad, m].
        rod: from the boom tip to the tool point, (n, 3) [m]; zero length = the tool points straight down.
    """
    slew, boom, stick, telescope = joints.T
    n = len(joints)
    yaw = _about_z(slew)
    boom_rotation = yaw @ _pitched_up(boom)
    stick_rotation = yaw @ _pitched_up(boom + stick)
    column = np.tile([0.0, 0.0, geometry.height], (n, 1))
    elbow = column + geometry.boom * boom_rotation[:, :, 0]
    tip = elbow + (geometry.stick + telescope)[:, None] * stick_rotation[:, :, 0]
    return {
        "column": (yaw, np.zeros((n, 3))),
        "boom": (boom_rotation, column),
        "stick": (stick_rotation, elbow),
        "tip": (stick_rotation, tip),
        "gripper": (yaw @ _hanging(yaw, rod), tip + rod),
    }


def _about_z(angle: Array) -> Array:
    rotation = np.zeros((len(angle), 3, 3))
    rotation[:, 0, 0] = rotation[:, 1, 1] = np.cos(angle)
    rotation[:, 1, 0] = np.sin(angle)
    rotation[:, 0, 1] = -rotation[:, 1, 0]
    rotation[:, 2, 2] = 1.0
    return rotation


def _pitched_up(angle: Array) -> Array:
    """x axis raised by ``angle``: a turn about −y."""
    rotation = np.zeros((len(angle), 3, 3))
    rotation[:, 0, 0] = rotation[:, 2, 2] = np.cos(angle)
    rotation[:, 2, 0] = np.sin(angle)
    rotation[:, 0, 2] = -rotation[:, 2, 0]
    rotation[:, 1, 1] = 1.0
    return rotation


def _hanging(yaw: Array, rod: Array) -> Array:
    """Gripper in the frame that turns with the slew: first passive joint about y, second about the x it has turned."""
    length = np.linalg.norm(rod, axis=1, keepdims=True)
    down = np.where(length > 0.0, rod / np.where(length > 0.0, length, 1.0), [0.0, 0.0, -1.0])
    d = np.einsum("nji,nj->ni", yaw, down)
    roll = np.arcsin(np.clip(d[:, 1], -1.0, 1.0))
    pitch = np.arctan2(-d[:, 0], -d[:, 2])
    about_x = np.zeros((len(rod), 3, 3))
    about_x[:, 0, 0] = 1.0
    about_x[:, 1, 1] = about_x[:, 2, 2] = np.cos(roll)
    about_x[:, 2, 1] = np.sin(roll)
    about_x[:, 1, 2] = -about_x[:, 2, 1]
    return np.asarray(_pitched_up(-pitch) @ about_x)
