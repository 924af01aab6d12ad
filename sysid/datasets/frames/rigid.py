"""Poses of rigid bodies, from the columns of a stream or from rigidly connected markers, in the machine's base frame,
interpolated to other instants. Poses are arrays (n, 4, 4), NaN where a body is not visible.

The shape of a set of markers is the median over the aligned frames; the pose in a frame is the best fit to the visible markers
(at least three). The frame of the body follows from the shape alone and is thus the same in every recording: origin in the
centre of all markers, x from the first to the second, z normal to the plane of the first three.

Source of the fit: Kabsch, Acta Cryst. A32 (1976) 922.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid.datasets.chunked import Array
from sysid.datasets.recipe import FramePose, StreamMap
from sysid.datasets.resample import interpolate
from sysid.errors import InputError, SettingsError, nearest
from sysid.logs import Stream
from sysid.logs.capture import from_matrices
from sysid.machine.kinematics import rotation_about

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


#: Number of frames for the shape.
SHAPE_FRAMES = 2000
#: Markers nearer to one line (ratio of their extents across and along) do not determine a rotation.
MIN_WIDTH = 0.02


def with_marker_sets(streams: Sequence[Stream], mapping: StreamMap) -> tuple[Stream, ...]:
    """``streams`` and, behind them, a rigid body for each marker set of the recipe.

    Raises:
        SettingsError: a marker that the file does not have.
        InputError: markers that are never visible together, or collinear.
    """
    known = {stream.name: stream for stream in streams}
    bodies = []
    for body, names in mapping.marker_sets.items():
        for name in names:
            if name not in known:
                where = f"{streams[0].source if streams else mapping.files}: marker_sets.{body}"
                raise SettingsError(where, f"no marker {name!r}", nearest(name, known), "Correct the recipe.")
        own = [known[name] for name in names]
        first = own[0]
        for other in own[1:]:
            if not all(np.array_equal(stamps, other.stamps.get(clock, ())) for clock, stamps in first.stamps.items()):
                found = f"marker {other.name!r} has other stamps than {first.name!r}"
                raise InputError(f"{first.source}: {body}", found, "markers of one capture")
        markers = np.stack([marker_places(stream) for stream in own], axis=1)
        try:
            rotation, position, error = rigid_body(markers)
        except ValueError as problem:
            expected = "at least three markers on a rigid body, not in a line"
            raise InputError(f"{first.source}: {body}", str(problem), expected) from None
        columns = dict(zip(("x", "y", "z"), position.T, strict=True)) | {"error": error}
        columns |= dict(zip(("qx", "qy", "qz", "qw"), from_matrices(rotation).T, strict=True))
        units = dict.fromkeys(("x", "y", "z", "error"), "m")
        bodies.append(Stream(body, first.source, first.stamps, columns, units, first.losses))
    return (*streams, *bodies)


def rigid_body(markers: Array) -> tuple[Array, Array, Array]:
    """Rotations (n, 3, 3), positions (n, 3) and mean marker errors (n,) [m] of markers (n, m, 3); NaN with too few visible.

    Raises:
        ValueError: no frame with all markers, or they are collinear.
    """
    seen = np.asarray(np.all(np.isfinite(markers), axis=2))
    whole = np.flatnonzero(seen.all(axis=1))
    if not len(whole):
        raise ValueError("no frame in which all markers are visible")
    shape = _shape(markers[whole[:: max(len(whole) // SHAPE_FRAMES, 1)]])
    rotation, position, error = _fit(shape, np.where(seen[:, :, None], markers, 0.0), seen.astype(np.float64))
    few = (seen.sum(axis=1) < 3) | ~np.isfinite(error)
    for values in (rotation, position, error):
        values[few] = np.nan
    return rotation, position, error


def _shape(markers: Array) -> Array:
    """Marker positions (m, 3) in the frame of the body."""
    first, second = np.triu_indices(markers.shape[1], 1)
    distances = np.linalg.norm(markers[:, first] - markers[:, second], axis=2)
    # Starts from the frame whose distances are nearest to the medians, which has no confused markers.
    shape = markers[np.argmin(np.abs(distances - np.median(distances, axis=0)).sum(axis=1))]
    for _ in range(3):
        rotation, position, _ = _fit(shape, markers, np.ones(markers.shape[:2]))
        shape = np.nanmedian(np.einsum("nji,nmj->nmi", rotation, markers - position[:, None, :]), axis=0)
    along = shape[1] - shape[0]
    normal = np.cross(along, shape[2] - shape[0])
    if np.linalg.norm(normal) < MIN_WIDTH * float(along @ along):
        raise ValueError("the first three markers are collinear")
    x, z = along / np.linalg.norm(along), normal / np.linalg.norm(normal)
    return np.asarray((shape - shape.mean(axis=0)) @ np.column_stack([x, np.cross(z, x), z]))


def _fit(shape: Array, markers: Array, weights: Array) -> tuple[Array, Array, Array]:
    """Best rotation and translation of ``shape`` (m, 3) onto ``markers`` (n, m, 3) with weights (n, m), and mean error (n,)."""
    total = np.maximum(weights.sum(axis=1), 1.0)
    centre = np.einsum("nm,mi->ni", weights, shape) / total[:, None]
    centres = np.einsum("nm,nmi->ni", weights, markers) / total[:, None]
    own = shape[None] - centre[:, None]
    covariance = np.einsum("nm,nmi,nmj->nij", weights, own, markers - centres[:, None])
    u, extent, vt = np.linalg.svd(covariance)
    vt[:, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[:, None]
    rotation = np.einsum("nik,nkj->nji", u, vt)
    position = centres - np.einsum("nij,nj->ni", rotation, centre)
    misfit = np.linalg.norm(np.einsum("nij,mj->nmi", rotation, shape) + position[:, None] - markers, axis=2)
    error = np.einsum("nm,nm->n", weights, misfit) / total
    # The covariance contains squared extents.
    error[extent[:, 1] < MIN_WIDTH**2 * extent[:, 0]] = np.nan
    return rotation, position, np.asarray(error)
