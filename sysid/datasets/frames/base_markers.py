"""The capture frame from static markers with known positions in the base frame.

Sources: Kabsch, Acta Cryst. A32 (1976) 922; Umeyama, IEEE PAMI 13 (1991) 376, without its scale.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt

from sysid.datasets.frames.base_frame import FrameProposal, frame_of, main_extents, rms_of, three
from sysid.errors import InputError

Array = npt.NDArray[np.float64]

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
