"""Poses of rigid bodies from the columns of a stream, in the machine's base frame, interpolated to other instants.

Poses are arrays (n, 4, 4), NaN where a body is not visible.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid.datasets.recipe import FramePose
from sysid.datasets.resample import interpolate
from sysid.errors import InputError
from sysid.logs import Stream
from sysid.machine.kinematics import rotation_about

Array = npt.NDArray[np.float64]


#: Column names of position and rotation in message types; exports of capture systems have plain columns.
_SPELLINGS = (
    ("{}", "q{}"),
    ("pose.position.{}", "pose.orientation.{}"),
    ("pose.pose.position.{}", "pose.pose.orientation.{}"),
    ("position.{}", "orientation.{}"),
    ("transform.translation.{}", "transform.rotation.{}"),
    ("translation.{}", "rotation.{}"),
    ("point.{}", ""),
)
#: Every field that may be part of the pose of a body or the position of a marker.
POSE_FIELDS = frozenset(
    [place.format(axis) for place, _ in _SPELLINGS for axis in "xyz"]
    + [turn.format(axis) for _, turn in _SPELLINGS if turn for axis in "xyzw"]
)


def body_poses(stream: Stream, frame: FramePose) -> Array:
    """Poses of one rigid body in the machine's base frame, (n, 4, 4).

    Raises:
        InputError: no position and rotation in the stream.
    """
    for place, turn in _SPELLINGS:
        positions, rotations = [place.format(axis) for axis in "xyz"], [turn.format(axis) for axis in "xyzw"]
        if turn and all(name in stream.columns for name in (*positions, *rotations)):
            break
    else:
        missing = next((name for name in ("x", "y", "z", "qx", "qy", "qz", "qw") if name not in stream.columns), "x")
        raise InputError(f"{stream.source}: {stream.name}", f"no column {missing!r}", "position and rotation of a rigid body")
    pose = np.tile(np.eye(4), (len(stream), 1, 1))
    pose[:, :3, :3] = matrices(np.column_stack([stream.columns[name] for name in rotations]))
    pose[:, :3, 3] = np.column_stack([stream.columns[name] for name in positions])
    pose[np.isnan(pose).any(axis=(1, 2))] = np.nan
    return np.asarray(frame_pose(frame) @ pose)


def has_rotation(stream: Stream) -> bool:
    """Whether the stream is a rigid body rather than a marker."""
    return any(turn and all(turn.format(axis) in stream.columns for axis in "xyzw") for _, turn in _SPELLINGS)


def marker_poses(stream: Stream, frame: FramePose) -> Array:
    """Poses (n, 4, 4) whose origins are a marker in the machine's base frame, with the rotation of the capture frame."""
    pose = np.tile(np.eye(4), (len(stream), 1, 1))
    pose[:, :3, 3] = marker_places(stream)
    pose[np.isnan(pose).any(axis=(1, 2))] = np.nan
    return np.asarray(frame_pose(frame) @ pose)


def marker_places(stream: Stream) -> Array:
    """Positions of a marker, or of the origin of a rigid body, in the capture frame, (n, 3).

    Raises:
        InputError: no position in the stream.
    """
    for place, _ in _SPELLINGS:
        names = [place.format(axis) for axis in "xyz"]
        if all(name in stream.columns for name in names):
            return np.column_stack([stream.columns[name] for name in names])
    missing = next((axis for axis in "xyz" if axis not in stream.columns), "x")
    raise InputError(f"{stream.source}: {stream.name}", f"no column {missing!r}", "the position of a marker")


def frame_pose(frame: FramePose) -> Array:
    """The capture frame in the base frame, (4, 4)."""
    pose = np.eye(4)
    for axis, angle in zip(np.eye(3), frame.rpy, strict=True):
        pose[:3, :3] = rotation_about(axis, np.array([angle]))[0] @ pose[:3, :3]
    pose[:3, 3] = frame.translation
    return pose


def matrices(quaternions: Array) -> Array:
    """Unit quaternions x y z w, (n, 4) → rotation matrices (n, 3, 3)."""
    x, y, z, w = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.asarray(np.moveaxis(np.array(rows), 2, 0))


def mean_pose(poses: Array) -> Array:
    """Mean translation, and the rotation nearest to the mean matrix (orthogonal Procrustes), (4, 4)."""
    result = np.eye(4)
    result[:3, 3] = poses[:, :3, 3].mean(axis=0)
    u, _, vt = np.linalg.svd(poses[:, :3, :3].mean(axis=0))
    result[:3, :3] = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return result


def inverse(poses: Array) -> Array:
    """Inverse of rigid transforms (..., 4, 4)."""
    result = np.zeros_like(poses)
    result[..., :3, :3] = np.swapaxes(poses[..., :3, :3], -1, -2)
    result[..., :3, 3] = -np.einsum("...ij,...j->...i", result[..., :3, :3], poses[..., :3, 3])
    result[..., 3, 3] = 1.0
    return result


def poses_at(poses: Array, times: Array, at: Array, max_gap_s: float) -> Array:
    """Poses between frames: positions interpolated linearly, rotations by slerp; NaN outside and in longer gaps.

    Args:
        poses: (n, 4, 4), NaN where not visible.
        times: increasing, (n,) [s].
        at: (m,) [s].
        max_gap_s: the longest gap that is bridged.

    Source: Shoemake, Animating rotation with quaternion curves, SIGGRAPH 1985.
    """
    from scipy.spatial.transform import Rotation, Slerp

    result = np.full((len(at), 4, 4), np.nan)
    seen = ~np.isnan(poses[:, 0, 3])
    poses, times = poses[seen], times[seen]
    if len(times) < 2:
        return result
    places = np.column_stack([interpolate(times, poses[:, index, 3], at, max_gap_s) for index in range(3)])
    inside = ~np.isnan(places[:, 0])
    if inside.any():
        turns = Slerp(times, Rotation.from_matrix(poses[:, :3, :3]))
        result[inside] = np.eye(4)
        result[inside, :3, :3] = turns(np.clip(at[inside], times[0], times[-1])).as_matrix()
        result[inside, :3, 3] = places[inside]
    return result
