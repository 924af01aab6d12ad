"""A proposal for the pose of the capture frame in the machine's base frame: from static markers with known positions, or from a
rotation of one revolute axis alone, in which points move on circles about the axis.

A proposal is never applied automatically, and uses the kinematics only for the position of one axis: a base that is fitted
through the kinematics would hide errors of the machine.

Sources of the fit to markers: Kabsch, Acta Cryst. A32 (1976) 922; Umeyama, IEEE PAMI 13 (1991) 376, without its scale.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from sysid.datasets.chunked import Array
from sysid.datasets.recipe import FramePose
from sysid.errors import InputError


@dataclass(frozen=True)
class FrameProposal:
    """A pose of the capture frame with its uncertainty.

    Args:
        frame: for the recipe.
        method: ``markers`` or ``turn``.
        names: of the markers used.
        rms_m, max_m: residuals between survey and capture [m].
        translation95, rotation95: half widths of 95 % intervals [m], and about the base axes [rad]; infinite where not
            determined. After a turn the position is that of the axis, at the height of the points.
        open: what the survey does not determine, as sentences.
        notes: possible mistakes.
    """

    frame: FramePose
    method: str
    names: tuple[str, ...]
    rms_m: float
    max_m: float
    translation95: tuple[float, float, float]
    rotation95: tuple[float, float, float]
    open: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def lines(self) -> str:
        """The TOML table for the recipe."""
        numbers = [", ".join(f"{value:.6f}" for value in values) for values in (self.frame.translation, self.frame.rpy)]
        return f"[streams.frame]\ntranslation = [{numbers[0]}]\nrpy = [{numbers[1]}]"


def frame_of(pose: Array) -> FramePose:
    """The pose (4, 4) with roll, pitch and yaw about fixed axes; at a pitch of ±90° the roll is zero."""
    r = pose[:3, :3]
    pitch = math.atan2(-r[2, 0], math.hypot(r[0, 0], r[1, 0]))
    if math.hypot(r[0, 0], r[1, 0]) < 1e-9:
        roll, yaw = 0.0, math.atan2(-r[0, 1], r[1, 1])
    else:
        roll, yaw = math.atan2(r[2, 1], r[2, 2]), math.atan2(r[1, 0], r[0, 0])
    return FramePose(three(pose[:3, 3]), (roll, pitch, yaw))


def main_extents(points: Array) -> Array:
    """Extents of points (n, 3) along their three main directions, times √n [m]."""
    return np.append(np.linalg.svd(points - points.mean(axis=0), compute_uv=False), [0.0, 0.0])[:3]


def rms_of(off: Array) -> float:
    """Root mean square distance [m] of residuals (n, k)."""
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def three(values: Array) -> tuple[float, float, float]:
    """Three numbers as a tuple."""
    return (float(values[0]), float(values[1]), float(values[2]))


#: Markers nearer to one line do not determine a rotation; nearer to one plane, they do not show a mirror image (ratio of
#: extents).
MIN_WIDTH = 0.02
#: Another assignment of the markers (mirrored, two exchanged, one omitted) is reported if its residual is below this share,
#: which does not happen by chance.
BETTER = 1.0 / 3.0
#: A larger difference of distances from the surveyed ones is reported (share).
MAX_SCALE = 0.01


def from_markers(seen: Mapping[str, Array], known: Mapping[str, Sequence[float]], where: object) -> FrameProposal:
    """The pose with the least distances of static markers from their surveyed positions.

    Args:
        seen: marker → position in the capture frame (3,) [m].
        known: marker → position in the base frame [m]; the same markers.
        where: for messages.

    Raises:
        InputError: fewer than three markers, collinear markers, a mirrored frame, lengths of another unit.
    """
    names = tuple(known)
    capture, base = np.array([seen[name] for name in names]), np.array([known[name] for name in names], dtype=np.float64)
    if len(names) < 3:
        raise InputError(where, f"{len(names)} static marker{'s' * (len(names) != 1)}", "three that are not collinear")
    for what, points in (("surveyed", base), ("captured", capture)):
        extents = main_extents(points)
        if extents[1] < MIN_WIDTH * extents[0]:
            remedy = "The rotation about that line is not determined: add a marker."
            raise InputError(where, f"the {what} markers are collinear", "three that are not", remedy)
    notes = []
    scale = math.sqrt(float(_spread(capture) / _spread(base)))
    if not 0.5 < scale < 2.0:
        raise InputError(where, f"distances {scale:.4g} times the surveyed ones", "metres on both sides", "Check the units.")
    if abs(scale - 1.0) > MAX_SCALE:
        notes.append(f"distances are {scale:.4f} times the surveyed ones: the survey, or the calibration of the capture system")
    pose, off = _kabsch(capture, base)
    rms = rms_of(off)
    extents = main_extents(base)
    if extents[2] < MIN_WIDTH * extents[0]:
        notes.append("the markers are coplanar: a mirrored capture frame would not be detected")
    elif rms > 1e-9 and rms_of(_kabsch(capture, base, mirrored=True)[1]) < BETTER * rms:
        raise InputError(
            where, f"the markers fit mirrored only ({1e3 * rms:.1f} mm as they are)", "a right-handed frame", "Check the axes."
        )
    notes += _confused(names, capture, base, rms)
    half = _half_widths(pose, capture, off)
    return FrameProposal(
        frame_of(pose), "markers", names, rms, float(np.linalg.norm(off, axis=1).max()), three(half[:3]), three(half[3:]), (),
        tuple(notes),
    )  # fmt: skip


def _confused(names: Sequence[str], capture: Array, base: Array, rms: float) -> list[str]:
    """Notes about exchanged markers, or one that is not at its surveyed position."""
    if rms < 1e-6:
        return []
    found = []
    for first, second in combinations(range(len(names)), 2):
        order = np.arange(len(names))
        order[[first, second]] = order[[second, first]]
        other = rms_of(_kabsch(capture[order], base)[1])
        if other < BETTER * rms:
            found.append((other, f"{names[first]!r} and {names[second]!r} look exchanged"))
    if len(names) > 3:
        for index, name in enumerate(names):
            rest = np.delete(np.arange(len(names)), index)
            if main_extents(base[rest])[1] > MIN_WIDTH * main_extents(base[rest])[0]:
                other = rms_of(_kabsch(capture[rest], base[rest])[1])
                if other < BETTER * rms:
                    found.append((other, f"{name!r} does not fit the others: moved, confused, or wrongly surveyed"))
    if not found:
        return []
    other, text = min(found)
    return [f"{text}; without that the residual is {1e3 * other:.2f} mm instead of {1e3 * rms:.2f} mm"]


def _kabsch(capture: Array, base: Array, mirrored: bool = False) -> tuple[Array, Array]:
    """Pose (4, 4) that maps ``capture`` (n, 3) onto ``base``, and residuals (n, 3); with a reflection if ``mirrored``."""
    centre, target = capture.mean(axis=0), base.mean(axis=0)
    u, _, vt = np.linalg.svd((capture - centre).T @ (base - target))
    handed = np.sign(np.linalg.det(u) * np.linalg.det(vt)) * (-1.0 if mirrored else 1.0)
    rotation = vt.T @ np.diag([1.0, 1.0, handed]) @ u.T
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, target - rotation @ centre
    return pose, base - capture @ rotation.T - pose[:3, 3]


def _half_widths(pose: Array, capture: Array, off: Array) -> Array:
    """95 % half widths of translation [m] and of small rotations about the base axes [rad], (6,)."""
    from scipy.stats import t

    x, y, z = (capture @ pose[:3, :3].T).T
    zero = np.zeros(len(capture))
    # A small rotation w moves a point p by w × p.
    turns = np.moveaxis(np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]]), 2, 0)
    jacobian = np.concatenate([np.concatenate([np.eye(3), turn], axis=1) for turn in turns])
    freedom = 3 * len(capture) - 6
    variance = float(np.sum(off**2)) / freedom
    return np.asarray(t.ppf(0.975, freedom) * np.sqrt(variance * np.diag(np.linalg.pinv(jacobian.T @ jacobian))))


def _spread(points: Array) -> float:
    return float(np.sum((points - points.mean(axis=0)) ** 2))


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
