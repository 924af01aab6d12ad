"""Rigidly connected markers → a rigid body, as a capture system exports it.

The shape of the set is the median over the aligned frames; the pose in a frame is the best fit to the visible markers (at least
three). The frame of the body follows from the shape alone and is thus the same in every recording: origin in the centre of all
markers, x from the first to the second, z normal to the plane of the first three.

Source of the fit: Kabsch, Acta Cryst. A32 (1976) 922.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid.datasets.frames.rigid import marker_places
from sysid.datasets.recipe import StreamMap
from sysid.errors import InputError, SettingsError, nearest
from sysid.logs import Stream
from sysid.logs.capture import from_matrices

Array = npt.NDArray[np.float64]

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
