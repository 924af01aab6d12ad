"""Frame of the measurement and places of the points, where the measured poses lie far from those of the URDF.

Rotation, translation and one offset for each point are fitted to the nominal chain by least squares with a soft-L1 loss, from
several starts. A calibration keeps its parameters near the URDF, so that it needs such a start in the frame of a camera.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from sysid.networks.geometry import Geometry
from sysid.networks.pose_fit import PoseSet

Array = npt.NDArray[np.float64]

#: Poses farther than this many prior standard deviations from the URDF's are measured in another frame.
FAR = 3.0
#: Distance beyond which the loss grows linearly [m].
_KNEE = 5e-3


def registered(geometry: Geometry, poses: PoseSet) -> Geometry:
    """The geometry in the frame of the measurement, its points where they were measured; unchanged where the poses are as near
    to those of the URDF as the priors expect."""
    nothing = np.zeros(len(geometry.parameters))
    rigid = ~geometry.optional
    nominal = geometry.points(poses.q, nothing)
    slopes = geometry.point_slopes(poses.q, nothing, geometry.loads(poses.q, nothing))[..., rigid] * geometry.priors[rigid]
    expected = np.sqrt((slopes**2).sum(axis=(2, 3)))
    distance = np.linalg.norm(poses.points - nominal, axis=2)
    if not np.nanmedian(distance / expected) > FAR:
        return geometry
    return _fitted(geometry, poses)


def _fitted(geometry: Geometry, poses: PoseSet) -> Geometry:
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    turns, places = geometry.point_frames(poses.q)
    measured = np.isfinite(poses.points)
    count = poses.points.shape[1]

    def errors(v: Array) -> Array:
        points = places + np.einsum("npij,pj->npi", turns, v[6:].reshape(count, 3))
        turned = points @ Rotation.from_rotvec(v[:3]).as_matrix().T + v[3:6]
        return np.asarray((turned - poses.points)[measured])

    starts = [np.r_[turn.as_rotvec(), np.zeros(3 + 3 * count)] for turn in Rotation.create_group("O")]
    for start in starts:
        turn = Rotation.from_rotvec(start[:3]).as_matrix()
        start[3:6] = np.nanmedian(poses.points - places @ turn.T, axis=(0, 1))
    fits = (least_squares(errors, start, loss="soft_l1", f_scale=_KNEE) for start in starts)
    best = min(fits, key=lambda fit: float(fit.cost)).x
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = Rotation.from_rotvec(best[:3]).as_matrix(), best[3:6]
    return replace(geometry, frame=frame @ geometry.frame, offsets=geometry.offsets_of_points + best[6:].reshape(count, 3))
