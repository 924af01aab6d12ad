"""Motion capture → joints and points, from rigid bodies on links, without the frames in which the system confused bodies or
markers.

``T_base_body = T_base_capture · T_capture_body`` with the surveyed capture frame. In the reference pose the joint values are
known, so the URDF gives the pose of each link, and the mount of the body on it, ``T_link_body``, follows. Then
``T_base_link = T_base_body · T_link_body⁻¹`` at any time, and a joint's value is its child's pose relative to its parent about
the joint's axis. Poses are arrays (n, 4, 4), NaN where a body is not visible.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sysid.datasets.channel import Channel, RowCounts, counts_of, in_order, seconds
from sysid.datasets.checks.flag import Flag
from sysid.datasets.chunked import Array, Mask, Stamps, stretches
from sysid.datasets.frames.rigid import body_poses, inverse, marker_poses, mean_pose, poses_at
from sysid.datasets.recipe import Reference, StreamMap
from sysid.datasets.resample import GAP_PERIODS
from sysid.errors import InputError, SettingsError, nearest
from sysid.logs import Stream
from sysid.machine import Kinematics, Machine
from sysid.machine.kinematics import Joint

#: Largest speed [m/s] and acceleration [m/s²] of a point of the machine; a body beyond them was confused with another.
MAX_SPEED, MAX_ACCELERATION = 3.0, 20.0
#: Tolerance for noise [m]; a smaller mistake is not detected as a jump.
JUMP = 0.02
#: Largest distance of a body from its position before a mistake [m], beyond its motion at its 95th percentile of speed.
NEAR = 0.1
#: Largest mean marker error of a body: in metres, and as a multiple of its median.
MAX_MARKER_ERROR, MARKER_ERROR_RATIO = 0.002, 8.0


@dataclass(frozen=True)
class MissingFrames:
    """Frames of a body that have been set to missing; seconds on the capture clock from its first frame."""

    body: str
    reason: str
    start_s: float
    end_s: float
    frames: int


def without_mistakes(
    body: str, poses: Array, seconds: Array, error: Array | None = None
) -> tuple[Array, tuple[MissingFrames, ...]]:
    """The poses without frames in which the body was mistaken (swapped markers or bodies), and the dropped frames.

    A frame is dropped if the markers do not fit the body's shape, or the body jumps faster than a machine moves. After jumps,
    the longest sequence of feasible moves is kept.

    Args:
        poses: (n, 4, 4), NaN where not visible.
        seconds: increasing, (n,).
        error: mean marker error (n,) [m], where the system gives it.
    """
    bad = np.zeros(len(poses), dtype=bool)
    flags: list[MissingFrames] = []
    if error is not None and np.isfinite(error).any():
        limit = max(MAX_MARKER_ERROR, MARKER_ERROR_RATIO * float(np.nanmedian(error)))
        misfit = np.nan_to_num(error) > limit
        flags += _dropped(body, "markers do not fit the body", misfit, seconds)
        bad |= misfit
    seen = np.flatnonzero(~np.isnan(poses[:, 0, 3]) & ~bad)
    jumped = np.zeros(len(poses), dtype=bool)
    jumped[seen[~_plausible(poses[seen, :3, 3], seconds[seen])]] = True
    flags += _dropped(body, "jumped further than a machine can move", jumped, seconds)
    result = poses.copy()
    result[bad | jumped] = np.nan
    return result, tuple(flags)


def _plausible(positions: Array, seconds: Array) -> Mask:
    """Mask of the frames on the longest chain of runs with feasible jumps between them, (n,)."""
    if len(positions) < 2:
        return np.ones(len(positions), dtype=bool)
    breaks = np.flatnonzero(_jumps(positions, seconds)) + 1
    runs = np.split(np.arange(len(positions)), breaks)
    usual = float(np.quantile(np.linalg.norm(np.diff(positions, axis=0), axis=1) / np.diff(seconds), 0.95))
    weight = np.array([float(len(run)) for run in runs])
    best = weight.copy()
    before = np.full(len(runs), -1)
    for i in range(1, len(runs)):
        for j in range(max(0, i - 50), i - 1):  # neighbouring runs are separated by a jump
            gap = np.linalg.norm(positions[runs[i][0]] - positions[runs[j][-1]])
            time = seconds[runs[i][0]] - seconds[runs[j][-1]]
            # A long time between two runs alone does not make a far jump feasible.
            if gap <= min(MAX_SPEED * time + JUMP, usual * time + NEAR) and best[j] + weight[i] > best[i]:
                best[i], before[i] = best[j] + weight[i], j
    keep = np.zeros(len(positions), dtype=bool)
    run = int(np.argmax(best))
    while run >= 0:
        keep[runs[run]] = True
        run = int(before[run])
    return keep


def _jumps(positions: Array, seconds: Array) -> Mask:
    """Mask of the steps between neighbours that a machine cannot make, (n − 1,).

    Too far for their time; or, between frames without a gap, different from the step before and the step after by more than
    the largest acceleration, which detects mistakes along and against the motion alike.
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


def _dropped(body: str, reason: str, bad: Mask, seconds: Array) -> list[MissingFrames]:
    return [
        MissingFrames(body, reason, float(seconds[first]), float(seconds[last - 1]), int(last - first))
        for first, last in zip(*stretches(bad), strict=True)
    ]


#: Largest motion of a body in the reference pose [m].
STILL = 2e-3


@dataclass(frozen=True)
class LinkPoses:
    """Poses of a link in the base frame (n, 4, 4) with stamps (n,) [ns]; a fixed link has one pose (4, 4) and no stamps."""

    stamps: Stamps | None
    poses: Array
    counts: RowCounts = field(default_factory=RowCounts)
    flags: tuple[Flag, ...] = ()


def find_mounts(streams: Sequence[Stream], mapping: StreamMap, machine: Machine) -> dict[str, list[Array]]:
    """Body → its mount ``T_link_body`` (as a list, so that several recordings can be averaged), from the reference pose.

    Raises:
        InputError: a body is not visible, or moves, in the seconds of the reference.
        SettingsError: a body that is not in the file, missing joint values.
    """
    reference = mapping.reference
    kinematics = machine.kinematics()
    if reference is None or kinematics is None:
        raise SettingsError(
            f"streams {mapping.files!r}: bodies", "no reference pose", "[streams.reference] with known joint values"
        )
    links = kinematics.link_poses(np.array([_reference_values(reference, machine)]))
    mounts: dict[str, list[Array]] = {}
    origin = _origin(streams, mapping)
    for body, link in mapping.bodies.items():
        stream = _named(streams, body)
        at = seconds(stream.on_clock(mapping.clock), origin)
        inside = (at >= reference.seconds[0]) & (at <= reference.seconds[1])
        poses = body_poses(stream, mapping.frame)[inside]
        poses = poses[~np.isnan(poses[:, 0, 3])]
        where = f"{stream.source}: {body}"
        if len(poses) < 3:
            found = f"visible in {len(poses)} frames of the reference pose"
            raise InputError(where, found, "at least three", "Choose other seconds.")
        # Medians of parts, so that noise does not count as motion.
        parts = np.array_split(poses[:, :3, 3], min(5, len(poses) // 3))
        spread = float(np.ptp([np.median(part, axis=0) for part in parts], axis=0).max())
        if spread > STILL:
            found = f"moves by {1e3 * spread:.1f} mm in the reference pose"
            raise InputError(where, found, "a machine at rest", "Choose other seconds.")
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


def _origin(streams: Sequence[Stream], mapping: StreamMap) -> int:
    """First stamp of all tracked bodies and markers [ns], from which seconds in recipes and notes count."""
    tracked = {*mapping.bodies, *(point.body or point.marker for point in mapping.points.values())}
    return min((int(s.on_clock(mapping.clock).min()) for s in streams if s.name in tracked and len(s)), default=0)


def joints_and_points(
    streams: Sequence[Stream], mapping: StreamMap, mounts: Mapping[str, Array], machine: Machine
) -> tuple[list[Channel], tuple[MissingFrames, ...]]:
    """The channels of tracked bodies and markers of one file, with the stamps of their bodies, and the dropped frames.

    Bodies of one export share their stamps. Where they do not (topics of a bag), the poses of the one with more samples are
    interpolated to the instants of the other before the joint between them is computed.
    """
    dropped: dict[str, tuple[MissingFrames, ...]] = {}
    tracks: dict[str, LinkPoses] = {}
    origin = _origin(streams, mapping)
    markers = [point.marker for point in mapping.points.values() if point.marker is not None]
    for name in (*mapping.bodies, *(point.body for point in mapping.points.values() if point.body is not None), *markers):
        if name not in tracks:
            stream = _named(streams, name)
            own = stream.on_clock(mapping.clock)
            order, late = in_order(own, f"{stream.source}: {name}")
            stamps = own[order]
            poses = marker_poses(stream, mapping.frame) if name in markers else body_poses(stream, mapping.frame)
            counts = counts_of(own, poses, order, late)
            errors = stream.columns.get("error")
            cleaned, dropped[name] = without_mistakes(
                name,
                poses[order],
                np.asarray((stamps - origin) * 1e-9, dtype=np.float64),
                None if errors is None else errors[order],
            )
            swaps = tuple(_swap(item, (int(stamps[0]) - origin) * 1e-9) for item in dropped[name])
            tracks[name] = LinkPoses(stamps, cleaned, counts, swaps)
    channels = []

    def add(signal: str, stamps: Stamps, values: Array, counts: RowCounts, flags: Sequence[Flag]) -> None:
        channels.append(
            Channel(
                signal=signal,
                source=streams[0].source.name,
                domain=mapping.domain,
                stamps=stamps,
                values=values,
                unit=machine.expected_unit(signal) or "m",
                primary=signal not in mapping.secondary,
                interpolation=mapping.interpolation,
                max_gap_s=mapping.max_gap_s,
                counts=replace(counts, empty=int(np.count_nonzero(np.isnan(values)))),
                flags=tuple(replace(flag, signal=signal) for flag in flags),
            )
        )

    kinematics = machine.kinematics()
    if kinematics is not None and mapping.bodies:
        links = {link: _moved(tracks[body], inverse(mounts[body])) for body, link in mapping.bodies.items()}
        for axis in machine.axes:
            joint = kinematics.joints[axis.joint or ""]
            parent, child = _link_track(joint.parent, links, kinematics), _link_track(joint.child, links, kinematics)
            if parent is not None and child is not None:
                both = _together(parent, child, mapping.max_gap_s)
                if both is not None:
                    stamps, upper, lower, counts, flags = both
                    add(f"{axis.name}.joint", stamps, _joint_values(joint, upper, lower), counts, flags)
    for point, entry in mapping.points.items():
        track = tracks[entry.body or entry.marker or ""]
        places = track.poses @ np.array([*entry.at, 1.0])
        for index, axis_name in enumerate("xyz"):
            if track.stamps is not None:
                add(f"{point}.{axis_name}", track.stamps, places[:, index], track.counts, track.flags)
    return channels, tuple(item for group in dropped.values() for item in group)


def _swap(item: MissingFrames, late_s: float) -> Flag:
    """Dropped frames as a flag; its seconds count from the first stamp of the body."""
    text = f"{item.body}: {item.reason}; set to missing"
    return Flag("", "marker_swap", item.start_s - late_s, item.end_s - late_s, item.frames, text)


def _moved(track: LinkPoses, by: Array) -> LinkPoses:
    return replace(track, poses=track.poses @ by)


def _together(
    parent: LinkPoses, child: LinkPoses, max_gap_s: float | None
) -> tuple[Stamps, Array, Array, RowCounts, tuple[Flag, ...]] | None:
    """Both at the same instants: stamps, poses of the parent and of the child, counts of rows, flags. None without stamps."""
    counts, flags = max(parent.counts, child.counts, key=lambda own: own.rows), (*parent.flags, *child.flags)
    if parent.stamps is None or child.stamps is None:
        stamps = child.stamps if child.stamps is not None else parent.stamps
        return None if stamps is None else (stamps, parent.poses, child.poses, counts, flags)
    if np.array_equal(parent.stamps, child.stamps):
        return child.stamps, parent.poses, child.poses, counts, flags
    if _period(parent.stamps) > _period(child.stamps):
        return parent.stamps, parent.poses, _at(child, parent.stamps, max_gap_s), counts, flags
    return child.stamps, _at(parent, child.stamps, max_gap_s), child.poses, counts, flags


def _at(track: LinkPoses, stamps: Stamps, max_gap_s: float | None) -> Array:
    """Poses of ``track`` at other stamps."""
    if track.stamps is None:
        return np.tile(track.poses, (len(stamps), 1, 1))
    limit = max_gap_s if max_gap_s is not None else GAP_PERIODS * _period(track.stamps) * 1e-9
    zero = track.stamps[0]
    return poses_at(track.poses, (track.stamps - zero) * 1e-9, (stamps - zero) * 1e-9, limit)


def _period(stamps: Stamps) -> float:
    return float(np.median(np.diff(stamps))) if len(stamps) > 1 else np.inf


def _joint_values(joint: Joint, parent: Array, child: Array) -> Array:
    """Value of ``joint`` between poses of its parent, (n, 4, 4) or a fixed one (4, 4), and of its child."""
    motion = inverse(joint.origin) @ inverse(parent) @ child
    if joint.prismatic:
        return np.asarray(motion[:, :3, 3] @ joint.axis)
    rotation = motion[:, :3, :3]
    turn = np.stack(
        [rotation[:, 2, 1] - rotation[:, 1, 2], rotation[:, 0, 2] - rotation[:, 2, 0], rotation[:, 1, 0] - rotation[:, 0, 1]], 1
    )
    # For a rotation by q about the axis: turn·axis = 2 sin q, trace − axisᵀ R axis = 2 cos q; the best fit with noise.
    along = np.einsum("i,nij,j->n", joint.axis, rotation, joint.axis)
    angle = np.arctan2(turn @ joint.axis, np.trace(rotation, axis1=1, axis2=2) - along)
    return _continuous(angle, joint.limits)


def _continuous(angle: Array, limits: tuple[float, float]) -> Array:
    """Angles without steps of 2π: within ±π of the middle of the joint's range, or unwrapped where it has none."""
    low, high = limits
    if np.isfinite(low) and np.isfinite(high) and high - low <= 2.0 * np.pi:
        middle = (low + high) / 2.0
        return np.asarray((angle - middle + np.pi) % (2.0 * np.pi) - np.pi + middle)
    known = ~np.isnan(angle)
    angle[known] = np.unwrap(angle[known])
    return angle


def _link_track(link: str, links: Mapping[str, LinkPoses], kinematics: Kinematics) -> LinkPoses | None:
    """Poses of ``link``, from the body on it or on a link fixed to it; the root link is the base frame."""
    if link in links:
        return links[link]
    if link == kinematics.chain[0].parent:
        return LinkPoses(None, np.eye(4))
    for joint in kinematics.chain:
        if joint.kind == "fixed" and joint.child == link:
            upper = _link_track(joint.parent, links, kinematics)
            return None if upper is None else _moved(upper, joint.origin)
        if joint.kind == "fixed" and joint.parent == link and joint.child in links:
            return _moved(links[joint.child], inverse(joint.origin))
    return None
