"""Effects of the geometry as places of frames: lengths of links, offset of the tip, pose of the base."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid.machine.kinematics import Joint, Kinematics, rotation_about
from sysid.plant import Plant

Array = npt.NDArray[np.float64]


def base_pose(plant: Plant) -> tuple[Array, Array]:
    """Rotation (3, 3) and place (3,) [m] of the base in the measured frame."""
    item = plant.effect("base_misalignment", "base")
    if item is None:
        return np.eye(3), np.zeros(3)
    rotation = np.asarray(item.parameters["rotation"], dtype=np.float64)
    angle = float(np.linalg.norm(rotation))
    turn = rotation_about(rotation / angle, np.array([angle]))[0] if angle > 0.0 else np.eye(3)
    return turn, np.asarray(item.parameters["translation"], dtype=np.float64)


def stretched(joint: Joint, plant: Plant, kinematics: Kinematics) -> Array:
    """Place of a joint's frame, with the length error of the link that the joint before it in the chain moves.

    Fixed joints in between belong to that link: each is stretched by the same share.
    """
    place = joint.origin[:3, 3].copy()
    names = [j.name for j in kinematics.chain]
    if joint.name not in names:
        return place
    moved = [j for j in kinematics.chain[: names.index(joint.name)] if j.name in kinematics.drives]
    if not moved or moved[-1].name not in kinematics.actuated:
        return place
    target = plant.machine.axis_names[kinematics.actuated.index(moved[-1].name)]
    error = plant.effect("link_length_error", target)
    length = link_length(kinematics, moved[-1].name)
    if error is None or length < 1e-9:
        return place
    return place * (1.0 + float(np.asarray(error.parameters["error"])) / length)


def link_length(kinematics: Kinematics, joint: str) -> float:
    """Distance from the frame of a joint of the chain to that of the next joint that moves, or to the tip [m]."""
    names = [j.name for j in kinematics.chain]
    frame = np.eye(4)
    for step in kinematics.chain[names.index(joint) + 1 :]:
        frame = frame @ step.origin
        if step.name in kinematics.drives:
            break
    return float(np.linalg.norm(frame[:3, 3]))


def tip_offset(plant: Plant, kinematics: Kinematics) -> Array:
    """Offset of the tip in the frame of its link, (3,) [m]; the effect has it in the frame that the last joint moves."""
    item = plant.effect("tip_offset", "ee")
    if item is None:
        return np.zeros(3)
    turn = np.eye(3)
    for joint in reversed(kinematics.chain):
        if joint.name in kinematics.drives:
            break
        turn = joint.origin[:3, :3] @ turn
    return np.asarray(turn.T @ np.asarray(item.parameters["translation"], dtype=np.float64))
