"""Motion capture → joints and points: rigid bodies on links, seen in the capture frame.

``T_base_body = T_base_capture · T_capture_body`` with the surveyed capture frame. In the reference pose the joint values are
known, so the URDF says where each link is and what is left is where the body sits on it, ``T_link_body`` (its mount). Then
``T_base_link = T_base_body · T_link_body⁻¹`` at any time, and a joint's value is its child's pose relative to its parent about
the joint's axis. Poses are arrays (n, 4, 4); a body that was not seen has NaN.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recipe import Frame, Reference, StreamMap
from sysid.errors import InputError, SettingsError, nearest
from sysid.logs import Stream
from sysid.machine import Kinematics, Machine
from sysid.machine.kinematics import Joint, rotation_about

Array = npt.NDArray[np.float64]

#: No point of such a machine moves faster [m/s] or accelerates more [m/s²]; a body that seems to has been mistaken for another.
MAX_SPEED, MAX_ACCELERATION = 3.0, 20.0
#: Room for noise on top of that [m]; a smaller mistake is not seen as a jump.
JUMP = 0.02
#: How far a body can be after a mistake from where it was before [m], beyond what it moves at its own usual top speed.
NEAR = 0.1
#: A body whose markers do not fit its shape (mean marker error) is not where it seems to be: metres, and times its median.
MAX_MARKER_ERROR, MARKER_ERROR_RATIO = 0.002, 8.0
#: The machine counts as standing still in the reference pose while bodies stay within this [m].
STILL = 2e-3


@dataclass(frozen=True)
class Flag:
    """Frames of a body that have been set to missing; seconds on the capture clock from its first frame."""

    body: str
    reason: str
    start_s: float
    end_s: float
    frames: int


def body_poses(stream: Stream, frame: Frame) -> Array:
    """Poses of one rigid body in the machine's base frame, (n, 4, 4)."""
    columns = stream.columns
    for name in ("x", "y", "z", "qx", "qy", "qz", "qw"):
        if name not in columns:
            raise InputError(f"{stream.source}: {stream.name}", f"no column {name!r}", "position and rotation of a rigid body")
    pose = np.tile(np.eye(4), (len(stream), 1, 1))
    pose[:, :3, :3] = matrices(np.column_stack([columns[f"q{axis}"] for axis in "xyzw"]))
    pose[:, :3, 3] = np.column_stack([columns[axis] for axis in "xyz"])
    pose[np.isnan(pose).any(axis=(1, 2))] = np.nan
    return np.asarray(frame_pose(frame) @ pose)


def marker_poses(stream: Stream, frame: Frame) -> Array:
    """Poses (n, 4, 4) whose origins are a marker in the machine's base frame; their rotation means nothing."""
    pose = np.tile(np.eye(4), (len(stream), 1, 1))
    for index, axis in enumerate("xyz"):
        if axis not in stream.columns:
            raise InputError(f"{stream.source}: {stream.name}", f"no column {axis!r}", "the position of a marker")
        pose[:, index, 3] = stream.columns[axis]
    pose[np.isnan(pose).any(axis=(1, 2))] = np.nan
    return np.asarray(frame_pose(frame) @ pose)


def frame_pose(frame: Frame) -> Array:
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


def without_mistakes(stream: Stream, poses: Array, seconds: Array) -> tuple[Array, tuple[Flag, ...]]:
    """``poses`` with the frames set to NaN in which the body was mistaken (swapped markers or bodies), and what was dropped.

    Two signs: the markers do not fit the body's shape (mean marker error), or the body jumps faster than a machine moves. After
    a jump the frames are kept that form the longest sequence of moves a machine can make.
    """
    bad = np.zeros(len(poses), dtype=bool)
    flags: list[Flag] = []
    error = stream.columns.get("error")
    if error is not None and np.isfinite(error).any():
        limit = max(MAX_MARKER_ERROR, MARKER_ERROR_RATIO * float(np.nanmedian(error)))
        misfit = np.nan_to_num(error) > limit
        flags += _flags(stream.name, "markers do not fit the body", misfit, seconds)
        bad |= misfit
    seen = np.flatnonzero(~np.isnan(poses[:, 0, 3]) & ~bad)
    jumped = np.zeros(len(poses), dtype=bool)
    jumped[seen[~_plausible(poses[seen, :3, 3], seconds[seen])]] = True
    flags += _flags(stream.name, "jumped further than a machine can move", jumped, seconds)
    result = poses.copy()
    result[bad | jumped] = np.nan
    return result, tuple(flags)


def _plausible(positions: Array, seconds: Array) -> npt.NDArray[np.bool_]:
    """Frames on the heaviest chain of runs between which no jump is too large, (n,)."""
    if len(positions) < 2:
        return np.ones(len(positions), dtype=bool)
    breaks = np.flatnonzero(_jumps(positions, seconds)) + 1
    runs = np.split(np.arange(len(positions)), breaks)
    usual = float(np.quantile(np.linalg.norm(np.diff(positions, axis=0), axis=1) / np.diff(seconds), 0.95))
    weight = np.array([float(len(run)) for run in runs])
    best = weight.copy()
    before = np.full(len(runs), -1)
    for i in range(1, len(runs)):
        for j in range(max(0, i - 50), i - 1):  # neighbours are parted by a jump: never one after the other
            gap = np.linalg.norm(positions[runs[i][0]] - positions[runs[j][-1]])
            time = seconds[runs[i][0]] - seconds[runs[j][-1]]
            # Time alone must not make a far jump plausible: a long mistake would be as near as any place.
            if gap <= min(MAX_SPEED * time + JUMP, usual * time + NEAR) and best[j] + weight[i] > best[i]:
                best[i], before[i] = best[j] + weight[i], j
    keep = np.zeros(len(positions), dtype=bool)
    run = int(np.argmax(best))
    while run >= 0:
        keep[runs[run]] = True
        run = int(before[run])
    return keep


def _jumps(positions: Array, seconds: Array) -> npt.NDArray[np.bool_]:
    """Which steps between neighbours no machine can make, (n − 1,).

    Too far for its time; or, between frames without a gap, unlike the step before and the step after by more than an
    acceleration explains: that sees a mistake alike whether it goes with or against the motion.
    """
    steps, times = np.diff(positions, axis=0), np.diff(seconds)
    too_fast = np.linalg.norm(steps, axis=1) > MAX_SPEED * times + JUMP
    regular = times < 1.5 * float(np.median(times))
    change = np.full(len(steps) + 1, np.inf)
    change[1:-1] = np.linalg.norm(np.diff(steps, axis=0), axis=1)
    change[1:-1][~(regular[1:] & regular[:-1])] = np.inf
    alone = np.minimum(change[:-1], change[1:])
    sudden = regular & np.isfinite(alone) & (alone > MAX_ACCELERATION * times**2 + JUMP)
    return np.asarray(too_fast | sudden)


def _flags(body: str, reason: str, bad: npt.NDArray[np.bool_], seconds: Array) -> list[Flag]:
    rows = np.flatnonzero(bad)
    if not len(rows):
        return []
    groups = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    return [Flag(body, reason, float(seconds[g[0]]), float(seconds[g[-1]]), len(g)) for g in groups]


def find_mounts(streams: Sequence[Stream], mapping: StreamMap, machine: Machine) -> dict[str, list[Array]]:
    """Body → its mount ``T_link_body`` (as a list, so that several recordings can be averaged), from the reference pose.

    Raises:
        InputError: a body is not seen, or moves, in the seconds of the reference.
        SettingsError: a body that the file does not have, joint values that are not given.
    """
    reference = mapping.reference
    kinematics = machine.kinematics()
    if reference is None or kinematics is None:
        raise SettingsError(
            f"streams {mapping.files!r}: bodies", "no reference pose", "[streams.reference] with known joint values"
        )
    links = kinematics.link_poses(np.array([_reference_values(reference, machine)]))
    mounts: dict[str, list[Array]] = {}
    for body, link in mapping.bodies.items():
        stream = _named(streams, body)
        seconds = (stream.stamps["capture"] - stream.stamps["capture"][0]) * 1e-9
        inside = (seconds >= reference.seconds[0]) & (seconds <= reference.seconds[1])
        poses = body_poses(stream, mapping.frame)[inside]
        poses = poses[~np.isnan(poses[:, 0, 3])]
        where = f"{stream.source}: {body}"
        if len(poses) < 3:
            raise InputError(
                where, f"seen in {len(poses)} frames of the reference pose", "at least three", "Choose other seconds."
            )
        # Medians of parts, so that noise is no motion.
        parts = np.array_split(poses[:, :3, 3], min(5, len(poses) // 3))
        spread = float(np.ptp([np.median(part, axis=0) for part in parts], axis=0).max())
        if spread > STILL:
            found = f"moves by {1e3 * spread:.1f} mm in the reference pose"
            raise InputError(where, found, "a machine that stands still", "Choose other seconds.")
        if link not in links:
            raise SettingsError(where, f"link {link!r} is not moved by an axis", nearest(link, links), "Use `points` for it.")
        mounts.setdefault(body, []).append(inverse(links[link][0]) @ mean_pose(poses))
    return mounts


def _reference_values(reference: Reference, machine: Machine) -> list[float]:
    values = []
    for axis in machine.axes:
        if axis.name not in reference.joints:
            raise SettingsError("streams.reference.joints", f"no value for axis {axis.name!r}", "a value for every axis")
        values.append(reference.joints[axis.name])
    return values


def _named(streams: Sequence[Stream], body: str) -> Stream:
    for stream in streams:
        if stream.name == body:
            return stream
    source = streams[0].source if streams else "motion capture"
    raise SettingsError(f"{source}: bodies", f"no rigid body {body!r}", nearest(body, [stream.name for stream in streams]))


def joints_and_points(
    streams: Sequence[Stream], mapping: StreamMap, mounts: Mapping[str, Array], machine: Machine
) -> tuple[dict[str, Array], tuple[Flag, ...]]:
    """Signal → values (n,) on the frames of the export, and the frames that were dropped."""
    signals: dict[str, Array] = {}
    flags: dict[str, tuple[Flag, ...]] = {}
    poses: dict[str, Array] = {}
    markers = [point.marker for point in mapping.points.values() if point.marker is not None]
    for name in (*mapping.bodies, *(point.body for point in mapping.points.values() if point.body is not None), *markers):
        if name not in poses:
            stream = _named(streams, name)
            seconds = (stream.stamps["capture"] - stream.stamps["capture"][0]) * 1e-9
            seen = marker_poses(stream, mapping.frame) if name in markers else body_poses(stream, mapping.frame)
            poses[name], flags[name] = without_mistakes(stream, seen, seconds)
    kinematics = machine.kinematics()
    if kinematics is not None and mapping.bodies:
        links = {link: poses[body] @ inverse(mounts[body]) for body, link in mapping.bodies.items()}
        for axis in machine.axes:
            values = _joint_values(kinematics.joints[axis.joint or ""], links, kinematics, len(streams[0]))
            if values is not None:
                signals[f"{axis.name}.joint"] = values
    for point, entry in mapping.points.items():
        at = np.array([*entry.at, 1.0])
        for index, axis_name in enumerate("xyz"):
            signals[f"{point}.{axis_name}"] = (poses[entry.body or entry.marker or ""] @ at)[:, index]
    return signals, tuple(flag for group in flags.values() for flag in group)


def _joint_values(joint: Joint, links: Mapping[str, Array], kinematics: Kinematics, frames: int) -> Array | None:
    """Value of ``joint`` in each frame; None where no body sits on its parent or on its child."""
    parent = _link_pose(joint.parent, links, kinematics, frames)
    child = _link_pose(joint.child, links, kinematics, frames)
    if parent is None or child is None:
        return None
    motion = inverse(joint.origin) @ inverse(parent) @ child
    if joint.prismatic:
        return np.asarray(motion[:, :3, 3] @ joint.axis)
    rotation = motion[:, :3, :3]
    turn = np.stack(
        [rotation[:, 2, 1] - rotation[:, 1, 2], rotation[:, 0, 2] - rotation[:, 2, 0], rotation[:, 1, 0] - rotation[:, 0, 1]], 1
    )
    # For a rotation by q about the axis: turn·axis = 2 sin q, trace − axisᵀ R axis = 2 cos q; the best fit where noise tilts.
    along = np.einsum("i,nij,j->n", joint.axis, rotation, joint.axis)
    angle = np.arctan2(turn @ joint.axis, np.trace(rotation, axis1=1, axis2=2) - along)
    return _continuous(angle, joint.limits)


def _continuous(angle: Array, limits: tuple[float, float]) -> Array:
    """Angles without steps of 2π: into the turn around the middle of the joint's range, or unwrapped where it has none."""
    low, high = limits
    if np.isfinite(low) and np.isfinite(high) and high - low <= 2.0 * np.pi:
        middle = (low + high) / 2.0
        return np.asarray((angle - middle + np.pi) % (2.0 * np.pi) - np.pi + middle)
    known = ~np.isnan(angle)
    angle[known] = np.unwrap(angle[known])
    return angle


def _link_pose(link: str, links: Mapping[str, Array], kinematics: Kinematics, frames: int) -> Array | None:
    """Pose of ``link`` from the body on it, or on a link fixed to it; the root link is the base frame itself."""
    if link in links:
        return links[link]
    if link == kinematics.chain[0].parent:
        return np.tile(np.eye(4), (frames, 1, 1))
    for joint in kinematics.chain:
        if joint.kind == "fixed" and joint.child == link:
            upper = _link_pose(joint.parent, links, kinematics, frames)
            return None if upper is None else upper @ joint.origin
        if joint.kind == "fixed" and joint.parent == link and joint.child in links:
            return links[joint.child] @ inverse(joint.origin)
    return None
