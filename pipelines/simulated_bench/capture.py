"""The motion capture system: markers on rigid bodies with noise, occlusions and confusions, on a separate clock.

A rigid body is defined in the parked pose of the machine: its axes are those of the capture frame, its origin the centre of
its markers or a given pivot. The pose in each frame is the best fit of that definition to the visible markers.

Source of the fit: Kabsch, Acta Cryst. A32 (1976) 922.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from simulated_bench.capture_recipe import BodySettings
from simulated_bench.crane import link_poses
from simulated_bench.machine import Truth
from simulated_bench.recipe import BenchRecipe, RecordingSettings
from simulated_bench.stepping import zeros_of

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class BodyTrack:
    """One rigid body as exported; NaN where it is occluded.

    Args:
        quaternion: x, y, z, w, (n, 4).
        position: (n, 3) [m] in the capture frame.
        marker_error: mean distance of the markers from their places in the body (n,) [m].
        markers: (n, m, 3) [m].
    """

    name: str
    quaternion: Array
    position: Array
    marker_error: Array
    markers: Array


@dataclass(frozen=True)
class CaptureClock:
    """``t_machine = t_capture·(1 + 1e-6·skew) + offset`` [s] of stamps, both from the start of the recording."""

    offset: float
    skew: float

    def to_machine(self, times: Array) -> Array:
        return times * (1.0 + 1e-6 * self.skew) + self.offset


@dataclass(frozen=True)
class Dropout:
    """Occlusion of a body between two times on the capture clock [s]."""

    body: str
    start: float
    end: float


@dataclass(frozen=True)
class Capture:
    """A take: frame numbers (n,), their times on the capture clock (n,) [s], the bodies, and the occlusions."""

    frames: npt.NDArray[np.int64]
    time: Array
    rate: float
    bodies: tuple[BodyTrack, ...]
    clock: CaptureClock
    dropouts: tuple[Dropout, ...]


def capture(recipe: BenchRecipe, recording: RecordingSettings, truth: Truth, rng: np.random.Generator) -> Capture:
    """Export of the capture system: all frames of a motion, and those of the still phases of the calibration routine."""
    settings = recipe.capture
    clock = CaptureClock(rng.uniform(*settings.offset), settings.skew)
    rate = settings.pose_rate if recording.is_calibration else settings.rate
    span = (truth.time[-1] - clock.offset) / (1.0 + 1e-6 * clock.skew)
    frames = np.arange(math.floor(max(span, 0.0) * rate) + 1)
    time = frames / rate
    machine_time = clock.to_machine(time)
    if recording.is_calibration:
        seen = np.searchsorted(truth.still.ravel(), machine_time) % 2 == 1
        frames, time, machine_time = frames[seen], time[seen], machine_time[seen]
    # Frames are stamped late by the latency: they show an earlier state.
    shown = machine_time - settings.latency
    joints, tool, ee = truth.at(shown, truth.joint), truth.at(shown, truth.tool), truth.at(shown, truth.ee)
    parked = truth.joint[:1]
    hanging = np.array([[0.0, 0.0, -recipe.gripper.length]])
    zeros = zeros_of(recipe)
    poses = link_poses(recipe.built_geometry, joints + zeros, tool - ee)
    created = link_poses(recipe.built_geometry, parked + zeros, hanging)
    dropouts = _draw_dropouts(recipe, float(time[-1]), rng)
    tracks = []
    for body in settings.bodies:
        definition, pivot = _define(recipe, body, created)
        markers = _seen_markers(recipe, body, poses, rng)
        for swap in settings.swaps:
            if swap.recording == recording.name and swap.body == body.name:
                confused = (time >= swap.at) & (time < swap.at + swap.duration)
                first, second = swap.markers
                markers[confused, first], markers[confused, second] = markers[confused, second], markers[confused, first].copy()
        track = _track(body.name, definition - pivot, markers)
        gone = np.zeros(len(time), dtype=bool)
        for dropout in dropouts:
            if dropout.body == body.name:
                gone |= (time >= dropout.start) & (time < dropout.end)
        for values in (track.quaternion, track.position, track.marker_error, track.markers):
            values[gone] = np.nan
        tracks.append(track)
    return Capture(frames, time, rate, tuple(tracks), clock, dropouts)


def frame_rotation(rpy: tuple[float, float, float]) -> Array:
    """Fixed-axis roll, pitch, yaw as a matrix (3, 3)."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy), np.cos(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def turn_about(vector: tuple[float, float, float]) -> Array:
    """Rotation matrix (3, 3) of a rotation vector [rad]."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = np.array(vector) / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross)


def _in_capture_frame(recipe: BenchRecipe, points: Array) -> Array:
    """Base frame → capture frame, (…, 3) [m]."""
    settings = recipe.capture
    if any(settings.tilt) or any(settings.shift):
        points = points @ turn_about(settings.tilt).T + np.array(settings.shift)
    return np.asarray((points - np.array(settings.translation)) @ frame_rotation(settings.rpy))


def _define(recipe: BenchRecipe, body: BodySettings, created: dict[str, tuple[Array, Array]]) -> tuple[Array, Array]:
    """Marker places (m, 3) and pivot (3,) of a body in the capture frame at its creation."""
    rotation, origin = created[body.link]
    local = np.array(body.markers)
    pivot = local.mean(axis=0) if body.pivot is None else np.array(body.pivot)
    both = np.vstack([local, pivot[None]]) @ rotation[0].T + origin[0]
    placed = _in_capture_frame(recipe, both)
    return placed[:-1], placed[-1]


def _seen_markers(
    recipe: BenchRecipe, body: BodySettings, poses: dict[str, tuple[Array, Array]], rng: np.random.Generator
) -> Array:
    rotation, origin = poses[body.link]
    world = np.einsum("nij,mj->nmi", rotation, np.array(body.markers)) + origin[:, None, :]
    seen = _in_capture_frame(recipe, world)
    return np.asarray(seen + recipe.capture.noise * rng.standard_normal(seen.shape))


def _draw_dropouts(recipe: BenchRecipe, end: float, rng: np.random.Generator) -> tuple[Dropout, ...]:
    """Occlusions after the start of the motion, in the order of time."""
    settings = recipe.capture
    count = rng.poisson(settings.dropouts_per_minute * end / 60.0) if settings.bodies else 0
    dropouts = []
    for start in np.sort(rng.uniform(recipe.operator.parked, max(end, recipe.operator.parked), count)):
        body = settings.bodies[int(rng.integers(len(settings.bodies)))].name
        dropouts.append(Dropout(body, float(start), float(start + rng.uniform(*settings.dropout_seconds))))
    return tuple(dropouts)


def _track(name: str, definition: Array, markers: Array) -> BodyTrack:
    """Best rotation and translation of ``definition`` (m, 3) onto ``markers`` (n, m, 3)."""
    centre = definition.mean(axis=0)
    centres = markers.mean(axis=1)
    covariance = np.einsum("mi,nmj->nij", definition - centre, markers - centres[:, None, :])
    u, _, vt = np.linalg.svd(covariance)
    mirror = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    vt[:, 2, :] *= mirror[:, None]
    rotation = np.einsum("nik,nkj->nji", u, vt)
    position = centres - np.einsum("nij,j->ni", rotation, centre)
    fitted = np.einsum("nij,mj->nmi", rotation, definition) + position[:, None, :]
    error = np.linalg.norm(fitted - markers, axis=2).mean(axis=1)
    return BodyTrack(name, quaternions(rotation), position, error, markers)


def quaternions(rotation: Array) -> Array:
    """x, y, z, w with w ≥ 0 of rotation matrices (n, 3, 3) → (n, 4)."""
    r = rotation
    # The largest of the four follows from the diagonal and the others from it, without division by a small number.
    squares = np.stack(
        [
            1.0 + r[:, 0, 0] - r[:, 1, 1] - r[:, 2, 2],
            1.0 - r[:, 0, 0] + r[:, 1, 1] - r[:, 2, 2],
            1.0 - r[:, 0, 0] - r[:, 1, 1] + r[:, 2, 2],
            1.0 + r[:, 0, 0] + r[:, 1, 1] + r[:, 2, 2],
        ],
        axis=1,
    )
    x = np.stack([squares[:, 0], r[:, 1, 0] + r[:, 0, 1], r[:, 0, 2] + r[:, 2, 0], r[:, 2, 1] - r[:, 1, 2]], axis=1)
    y = np.stack([x[:, 1], squares[:, 1], r[:, 2, 1] + r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0]], axis=1)
    z = np.stack([x[:, 2], y[:, 2], squares[:, 2], r[:, 1, 0] - r[:, 0, 1]], axis=1)
    w = np.stack([x[:, 3], y[:, 3], z[:, 3], squares[:, 3]], axis=1)
    rows = np.stack([x, y, z, w], axis=1)
    chosen = rows[np.arange(len(r)), np.argmax(squares, axis=1)]
    chosen /= np.linalg.norm(chosen, axis=1, keepdims=True)
    return np.asarray(np.where(chosen[:, 3:] < 0.0, -chosen, chosen))
