"""A survey in the recipe → a proposal for the capture frame, which is neither stored nor applied."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from sysid.datasets.channel import in_order, seconds
from sysid.datasets.channels import read_streams
from sysid.datasets.chunked import Array, Rows
from sysid.datasets.frames.base_frame import FrameProposal, from_markers, from_turn
from sysid.datasets.frames.bodies import STILL
from sysid.datasets.frames.rigid import body_poses, frame_pose, has_rotation, inverse, marker_places
from sysid.datasets.recipe import FramePose, IngestRecipe, StreamMap, Survey
from sysid.errors import InputError, SettingsError, nearest
from sysid.logs import Stream
from sysid.machine import Machine

#: Distance of points from the origin of a rigid body by which its rotation is used [m]: about the size of a machine's links.
LEVER = 0.5


@dataclass(frozen=True)
class SurveyResult:
    """A proposal, its file, and its distance from the present recipe in what it determines [m, rad]."""

    source: Path
    proposal: FrameProposal
    moved_m: float
    turned_rad: float


def propose_frames(paths: Sequence[Path], recipe: IngestRecipe, machine: Machine, where: object) -> tuple[SurveyResult, ...]:
    """A proposal for every stream of the recipe that has a survey.

    Args:
        paths: files, folders of one recording, or folders of recordings.
        where: the recipe, for messages.

    Raises:
        SettingsError: no survey in the recipe, an axis that other axes move, a marker that is not in the file.
        InputError: no such file; markers that move; a survey that does not determine the frame.
    """
    surveys = [(stream, stream.survey) for stream in recipe.streams if stream.survey is not None]
    if not surveys:
        expected = "[streams.survey] with the known places of static markers, or an axis that turns alone"
        raise SettingsError(where, "no survey", expected, 'See "The capture frame" in docs/recipes.md.')
    return tuple(_proposal(paths, stream, survey, machine) for stream, survey in surveys)


def _proposal(paths: Sequence[Path], mapping: StreamMap, survey: Survey, machine: Machine) -> SurveyResult:
    path = _file(paths, mapping, survey)
    names = (*survey.turning, *survey.markers)
    # Read as bodies, because anything with a position can be surveyed, and marker sets are made where they are named.
    streams = read_streams(path, replace(mapping, signals={}, points={}, bodies=dict.fromkeys(names, "")))
    known = {stream.name: stream for stream in streams}
    for name in names:
        if name not in known:
            raise SettingsError(f"{path}: survey", f"no marker {name!r}", nearest(name, known), "Correct the recipe.")
    origin = min(int(known[name].on_clock(mapping.clock).min()) for name in names)
    rows = {name: _rows(known[name], mapping, survey, origin) for name in names}
    if survey.axis is not None:
        point, direction = axis_line(machine, survey.axis)
        moving: dict[str, Array] = {}
        for name in survey.turning:
            moving |= _levers(known[name], rows[name])
        proposal = from_turn(moving, point, survey.sense * direction, survey.axis, f"{path}: survey")
        moved, turned = _axes_apart(mapping.frame, proposal.frame, point, direction)
    else:
        static = {name: _static(marker_places(known[name])[rows[name]], f"{path}: {name}") for name in survey.markers}
        proposal = from_markers(static, survey.markers, f"{path}: survey")
        moved, turned = _apart(mapping.frame, proposal.frame)
    return SurveyResult(path, proposal, moved, turned)


def _file(paths: Sequence[Path], mapping: StreamMap, survey: Survey) -> Path:
    found: list[Path] = []
    for path in paths:
        if not path.exists():
            raise InputError(path, "no such file or folder", "the recording of the survey", "Check the path.")
        inside = (
            [path] if path.is_file() else sorted(entry for pattern in ("*", "*/*", "*/*/*") for entry in path.glob(pattern))
        )
        for entry in inside:
            if not mapping.applies_to(entry.parent.name) and path != entry:
                continue
            meant = survey.recording is None or fnmatchcase(entry.parent.name, survey.recording) or path == entry
            if meant and entry.is_file() and fnmatchcase(entry.name, Path(mapping.files).name):
                found.append(entry)
    if not found:
        within = f" in a recording {survey.recording!r}" if survey.recording is not None else ""
        listed = ", ".join(map(str, paths))
        raise InputError(listed, f"no file {mapping.files!r}{within}", "the recording of the survey", "Correct the path.")
    return found[0]


def _rows(stream: Stream, mapping: StreamMap, survey: Survey, origin: int) -> Rows:
    """Rows within the seconds of the survey, in the order of their stamps."""
    stamps = stream.on_clock(mapping.clock)
    order, _ = in_order(stamps, f"{stream.source}: {stream.name}")
    if survey.seconds is None:
        return order
    at = seconds(stamps[order], origin)
    return np.asarray(order[(at >= survey.seconds[0]) & (at <= survey.seconds[1])])


def _levers(stream: Stream, rows: Rows) -> dict[str, Array]:
    """Positions of a marker; of a rigid body, which may be on the axis, also of points :data:`LEVER` along its axes."""
    places = {stream.name: marker_places(stream)[rows]}
    if not has_rotation(stream):
        return places
    poses = body_poses(stream, FramePose())[rows]
    return places | {
        f"{stream.name} {sign}{axis}": poses[:, :3, 3] + (LEVER if sign == "+" else -LEVER) * poses[:, :3, index]
        for index, axis in enumerate("xyz")
        for sign in "+-"
    }


def _static(places: Array, where: str) -> Array:
    """The position of a marker at rest, (3,)."""
    known = places[~np.isnan(places).any(axis=1)]
    if not len(known):
        raise InputError(where, "visible in no frame of the survey", "one at least", "Choose other seconds.")
    parts = [np.median(part, axis=0) for part in np.array_split(known, min(5, len(known)))]
    spread = float(np.ptp(parts, axis=0).max())
    if spread > STILL:
        found = f"moves by {1e3 * spread:.1f} mm during the survey"
        raise InputError(where, found, "a marker at rest", "Choose other seconds, or leave it out.")
    return np.asarray(np.median(known, axis=0))


def axis_line(machine: Machine, axis: str) -> tuple[Array, Array]:
    """A point on a revolute axis and its direction in the base frame.

    Raises:
        SettingsError: no kinematics, no such axis, a prismatic axis, or one that other axes move.
    """
    kinematics = machine.kinematics()
    if kinematics is None:
        raise SettingsError("survey.axis", repr(axis), "a machine with a urdf", "Survey static markers instead.")
    pose = np.eye(4)
    for joint in kinematics.chain:
        pose = pose @ joint.origin
        if joint.name == machine.axis(axis).joint:
            if joint.prismatic:
                raise SettingsError(
                    "survey.axis", f"{axis!r} is prismatic", "a revolute axis", "Survey static markers instead."
                )
            return pose[:3, 3], pose[:3, :3] @ joint.axis
        if joint.kind != "fixed":
            raise SettingsError("survey.axis", f"{axis!r} is moved by other axes", f"the first one, {_first(machine)!r}")
    raise SettingsError("survey.axis", repr(axis), nearest(axis, machine.axis_names))


def _first(machine: Machine) -> str:
    kinematics = machine.kinematics()
    moved = [joint.name for joint in kinematics.chain if joint.kind != "fixed"] if kinematics is not None else []
    return next((axis.name for axis in machine.axes if moved and axis.joint == moved[0]), machine.axis_names[0])


def _apart(before: FramePose, after: FramePose) -> tuple[float, float]:
    """Distance [m] and angle [rad] between two frames."""
    first, second = frame_pose(before), frame_pose(after)
    cosine = (np.trace(first[:3, :3].T @ second[:3, :3]) - 1.0) / 2.0
    return float(np.linalg.norm(second[:3, 3] - first[:3, 3])), float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _axes_apart(before: FramePose, after: FramePose, point: Array, direction: Array) -> tuple[float, float]:
    """Displacement of the axis perpendicular to itself, at ``point`` [m], and its tilt [rad]."""
    change = frame_pose(after) @ inverse(frame_pose(before))
    tilted = change[:3, :3] @ direction
    shift = change[:3, :3] @ point + change[:3, 3] - point
    across = shift - direction * float(direction @ shift)
    return float(np.linalg.norm(across)), float(np.arccos(np.clip(tilted @ direction, -1.0, 1.0)))
