"""The capture frame from a rotation of one revolute axis alone, in which points move on circles about the axis."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from sysid.datasets.frames.base_frame import FrameProposal, frame_of, main_extents, rms_of, three
from sysid.errors import InputError

Array = npt.NDArray[np.float64]

#: Least rotation of the axis [rad], and largest distance of points from circles (share of the largest radius).
MIN_TURN, MAX_OFF_CIRCLE = math.radians(30.0), 0.02
#: Frames used of each point, and blocks for the interval, since errors of neighbouring frames are correlated.
TURN_FRAMES, BLOCKS = 600, 12


def from_turn(
    tracks: Mapping[str, Array], point: Sequence[float] | Array, direction: Sequence[float] | Array, axis: str, where: object
) -> FrameProposal:
    """The pose that maps the observed axis of rotation onto the axis of the machine.

    The rotation about the axis and the position along it are not determined: the smallest rotation and no shift are proposed.

    Args:
        tracks: point → positions while the axis turns alone, (n, 3) [m].
        point, direction: the axis in the base frame; about ``direction`` it turns in the positive sense first.
        axis: its name, for messages.

    Raises:
        InputError: no point turns far enough, or on circles about one axis.
    """
    used = {name: _thinned(track[~np.isnan(track).any(axis=1)]) for name, track in tracks.items()}
    used = {name: track for name, track in used.items() if len(track) >= 2 * BLOCKS}
    if not used:
        raise InputError(where, f"no point that is visible in {2 * BLOCKS} frames", f"points that turn with {axis!r}")
    sizes = {name: float(main_extents(track)[0]) / math.sqrt(len(track)) for name, track in used.items()}
    if max(sizes.values()) < 0.01:
        raise InputError(where, f"no point moves by more than {1e3 * max(sizes.values()):.1f} mm", f"a turn of {axis!r}")
    normal, centre, radii, covariance, off = _circles(list(used.values()))
    turned, first = _turn_of(list(used.values()), normal, centre, int(np.argmax(radii)))
    if turned < MIN_TURN:
        found, expected = f"{axis!r} turned by {math.degrees(turned):.0f}°", f"{math.degrees(MIN_TURN):.0f}° at least"
        raise InputError(where, found, expected, "Record a longer turn.")
    rms = rms_of(off)
    if rms > MAX_OFF_CIRCLE * max(radii):
        raise InputError(
            where,
            f"the points depart from circles by {1e3 * rms:.1f} mm (largest radius {max(radii):.3f} m)",
            f"circles about one axis: {axis!r} alone moves",
            "Record a survey in which no other axis moves.",
        )
    normal = normal * first
    along = np.asarray(direction, dtype=np.float64) / np.linalg.norm(direction)
    pose = np.eye(4)
    pose[:3, :3] = _shortest_turn(normal, along)
    at = np.asarray(point, dtype=np.float64)
    shift = at - pose[:3, :3] @ centre
    pose[:3, 3] = shift - along * float(along @ (shift - at))
    spread = pose[:3, :3] @ covariance[0] @ pose[:3, :3].T, pose[:3, :3] @ covariance[1] @ pose[:3, :3].T
    sideways = np.abs(along) < 1.0 - 1e-9
    squares = (np.maximum(np.diag(part), 0.0) for part in spread)  # along the axis it is zero but for rounding
    tilt, place = (np.where(sideways | (np.abs(along) < 0.5), np.sqrt(own), np.inf) for own in squares)
    opened = (
        f"the rotation about the axis of {axis!r} (yaw): survey one more marker away from the axis, or one direction",
        f"the position along the axis of {axis!r} (height): measure one height",
    )
    notes = (
        f"{axis!r} is assumed to turn first as in the recipe (sense = 1 or −1): otherwise the frame is upside down",
        "the interval of the position holds at the height of the points",
    )
    return FrameProposal(
        frame_of(pose), "turn", tuple(used), rms, float(np.abs(off).max()), three(place), three(tilt), opened, notes
    )


def _circles(tracks: Sequence[Array]) -> tuple[Array, Array, list[float], tuple[Array, Array], Array]:
    """Circles about one axis: its direction, the point on it nearest to the mean, radii, squared half widths as matrices (of
    the direction as a small rotation, and of the point), and the residuals along and across (k, 2)."""
    from scipy.optimize import least_squares
    from scipy.stats import t

    mean = np.mean([track.mean(axis=0) for track in tracks], axis=0)
    centred = np.concatenate([track - track.mean(axis=0) for track in tracks])
    frame = np.linalg.svd(centred, full_matrices=False)[2]
    frame[2] *= np.sign(np.linalg.det(frame))
    local = [(track - mean) @ frame.T for track in tracks]
    # Initial values from Kåsa's linear fit with one centre.
    rows = [np.column_stack([2 * p[:, :2], np.zeros((len(p), len(local)))]) for p in local]
    for number, row in enumerate(rows):
        row[:, 2 + number] = 1.0
    squares = np.concatenate([np.sum(p[:, :2] ** 2, axis=1) for p in local])
    start = np.linalg.lstsq(np.concatenate(rows), squares, rcond=None)[0]
    radii = [math.sqrt(max(float(c + start[:2] @ start[:2]), 1e-12)) for c in start[2:]]

    def residuals(parameters: Array) -> Array:
        tilt, centre = parameters[:2], parameters[2:4]
        normal = np.array([tilt[0], tilt[1], 1.0]) / math.sqrt(1.0 + float(tilt @ tilt))
        parts = []
        for number, p in enumerate(local):
            from_centre = p - [centre[0], centre[1], 0.0]
            height = from_centre @ normal
            radius = np.linalg.norm(from_centre - height[:, None] * normal, axis=1)
            parts.append(np.column_stack([radius - parameters[4 + 2 * number], height - parameters[5 + 2 * number]]))
        return np.concatenate(parts).ravel()

    first = [0.0, 0.0, start[0], start[1]]
    for radius, p in zip(radii, local, strict=True):
        first += [radius, float(p[:, 2].mean())]
    fit = least_squares(residuals, first, x_scale="jac")
    normal = np.array([fit.x[0], fit.x[1], 1.0]) / math.sqrt(1.0 + float(fit.x[:2] @ fit.x[:2]))
    # Errors of neighbouring frames are correlated: blocks of them are treated as independent.
    jacobian = np.asarray(fit.jac, dtype=np.float64)
    bread = np.linalg.pinv(jacobian.T @ jacobian)
    scores = jacobian * fit.fun[:, None]
    ends = np.cumsum([0, *(2 * len(p) for p in local)])
    blocks = [part.sum(axis=0) for a, b in pairwise(ends) for part in np.array_split(scores[a:b], BLOCKS)]
    count = len(blocks)
    meat = np.einsum("bi,bj->ij", blocks, blocks) * count / max(count - 4, 1)
    covariance = bread @ meat @ bread * float(t.ppf(0.975, max(count - 4, 1))) ** 2
    turns = np.zeros((3, 3))
    turns[:2, :2] = np.array([[0.0, -1.0], [1.0, 0.0]]) @ covariance[:2, :2] @ np.array([[0.0, -1.0], [1.0, 0.0]]).T
    places = np.zeros((3, 3))
    places[:2, :2] = covariance[2:4, 2:4]
    centre = mean + frame.T @ np.array([fit.x[2], fit.x[3], 0.0])
    off = fit.fun.reshape(-1, 2)
    return (
        frame.T @ normal,
        centre,
        [float(fit.x[4 + 2 * number]) for number in range(len(local))],
        (frame.T @ turns @ frame, frame.T @ places @ frame),
        off,
    )


def _turn_of(tracks: Sequence[Array], normal: Array, centre: Array, which: int) -> tuple[float, float]:
    """Rotation of the point with the largest radius [rad], and the sign of its first turn about ``normal``."""
    from_centre = tracks[which] - centre
    flat = from_centre - (from_centre @ normal)[:, None] * normal
    x = flat[0] / np.linalg.norm(flat[0])
    angle = np.unwrap(np.arctan2(flat @ np.cross(normal, x), flat @ x))
    span = float(np.ptp(angle))
    away = angle[np.abs(angle - angle[0]) > 0.2 * span]
    return span, float(np.sign(away[0] - angle[0])) if len(away) else 1.0


def _shortest_turn(start: Array, end: Array) -> Array:
    """The smallest rotation that turns one unit vector into another, (3, 3)."""
    from scipy.spatial.transform import Rotation

    axis = np.cross(start, end)
    size = float(np.linalg.norm(axis))
    if size < 1e-12:
        if float(start @ end) > 0.0:
            return np.eye(3)
        across = np.linalg.svd(start[None])[2][1]
        return np.asarray(Rotation.from_rotvec(math.pi * across).as_matrix())
    return np.asarray(Rotation.from_rotvec(axis / size * math.atan2(size, float(start @ end))).as_matrix())


def _thinned(track: Array) -> Array:
    return track[:: max(len(track) // TURN_FRAMES, 1)]
