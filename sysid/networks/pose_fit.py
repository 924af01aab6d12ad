"""Maximum a posteriori fit of a geometry to poses.

Each coordinate is weighted by the noise that its own sensor and those of the joints cause there, a soft-L1 loss reduces the
weight of outliers, and the noise level is estimated from the residuals. Gauss-Newton steps with reweighting minimise the loss
at constant gravity loads; loads, weights by the joints' noise and noise level are renewed until they no longer change.

Where the measured poses lie far from those of the URDF, the frame of the measurement and the places of the points are found
first: rotation, translation and one offset for each point are fitted to the nominal chain by least squares with a soft-L1 loss,
from several starts. A calibration keeps its parameters near the URDF, so that it needs such a start in the frame of a camera.

Source: weights by the propagated noise of the joints are those of total least squares to first order (Fuller, Measurement Error
Models, 1987); iteratively reweighted least squares: Holland and Welsch, Commun. Statist. A6 (1977), 813–827.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve

from sysid.networks.geometry import Geometry

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

#: Lower bound of the estimated noise, as a share of the stated noise.
MIN_NOISE_SCALE = 1e-3
#: Residual, in standard deviations, beyond which the loss grows linearly.
KNEE = 3.0
#: Noise of a coordinate whose sensor states none [m]; the level is estimated.
UNKNOWN_NOISE = 1e-3
#: Renewals of loads and noise; Gauss-Newton steps each; the decrease of the loss below which they end [nats].
_RENEWALS, _STEPS, _CONVERGED = 5, 30, 1e-4
#: Relative change of the noise level below which the renewals end.
_SETTLED = 3e-3


@dataclass(frozen=True)
class PoseSet:
    """Measured poses.

    Args:
        q: joint values, (n, n_axes) [rad or m].
        points: tip and markers, (n, points, 3) [m]; NaN where one is not measured.
        joint_noise, point_noise: standard deviations of the sensors, (n_axes,) and (points, 3); NaN where unknown.
    """

    q: Array
    points: Array
    joint_noise: Array
    point_noise: Array

    def __len__(self) -> int:
        return len(self.q)

    def take(self, rows: npt.NDArray[np.intp]) -> PoseSet:
        return PoseSet(self.q[rows], self.points[rows], self.joint_noise, self.point_noise)


@dataclass(frozen=True)
class PoseFit:
    """A fitted geometry.

    Args:
        free: parameters that were estimated, (P,); the others are zero.
        values: (P,).
        sigma: noise of every coordinate up to the factor ``scale``, (n, points, 3); NaN where not measured.
        scale: estimated noise over stated noise.
        residual: measured − modelled, in ``sigma``, of the measured coordinates, (rows,).
        slopes: derivatives of the modelled coordinates by the free parameters in units of prior and ``sigma``, (rows, free).
        weights: of the rows in the loss, (rows,).
    """

    geometry: Geometry
    free: Mask
    values: Array
    sigma: Array
    scale: float
    residual: Array
    slopes: Array
    weights: Array

    @property
    def information(self) -> Array:
        """Fisher information about the free parameters in units of their priors, (free, free)."""
        return np.asarray(self.slopes.T @ self.slopes) / self.scale**2


def fit_poses(geometry: Geometry, poses: PoseSet, free: Mask, start: Array | None = None, scale: float = 1.0) -> PoseFit:
    """Estimate the free parameters, the others being zero, from the values ``start``."""
    priors = geometry.priors[free]
    values = np.where(free, start, 0.0) if start is not None else np.zeros(len(free))
    measured = np.isfinite(poses.points)

    def rows(sigma: Array, loads: Array) -> tuple[Array, Array]:
        slopes = geometry.point_slopes(poses.q, values, loads)[..., free] * priors
        return (slopes / sigma[..., None])[measured], residual_of(values, sigma, loads)

    def residual_of(at: Array, sigma: Array, loads: Array) -> Array:
        return np.asarray(((poses.points - geometry.points_at(poses.q, at, loads)) / sigma)[measured])

    for _ in range(_RENEWALS):
        loads = geometry.loads(poses.q, values)
        sigma = _noise(geometry, poses, values, loads)
        before = scale
        for _ in range(_STEPS):
            slopes, residual = rows(sigma, loads)
            scaled = values[free] / priors
            weights = _weights(residual / scale)
            weighted = slopes.T * (weights / scale)
            matrix = weighted @ slopes / scale + np.eye(len(priors))
            gradient = weighted @ residual / scale - scaled
            step = cho_solve(cho_factor(matrix), gradient)
            loss, share = _loss(residual / scale) + 0.5 * scaled @ scaled, 1.0
            promised = 0.5 * float(step @ gradient)
            while share > 1e-3:
                moved = values.copy()
                moved[free] += share * priors * step
                new = moved[free] / priors
                if _loss(residual_of(moved, sigma, loads) / scale) + 0.5 * new @ new <= loss:
                    values = moved
                    break
                share *= 0.5
            if promised < _CONVERGED or share <= 1e-3:
                break
        slopes, residual = rows(sigma, loads)
        information = slopes.T @ slopes / scale**2
        used = float(np.trace(np.linalg.solve(information + np.eye(len(priors)), information)))
        left = max(residual.size - used, 0.25 * residual.size)
        # The median is robust against outliers.
        scale = max(1.4826 * float(np.median(np.abs(residual))) * math.sqrt(residual.size / left), MIN_NOISE_SCALE)
        if abs(math.log(scale / before)) < _SETTLED:
            break
    return PoseFit(
        geometry, free, values, np.where(measured, sigma, np.nan), scale, residual, slopes, _weights(residual / scale)
    )


def _noise(geometry: Geometry, poses: PoseSet, values: Array, loads: Array) -> Array:
    """Standard deviation of every coordinate, (n, points, 3), up to a common factor: its sensor's noise and the joints'."""
    own = np.where(np.isnan(poses.point_noise), UNKNOWN_NOISE, poses.point_noise)
    joints = np.nan_to_num(poses.joint_noise)
    if not joints.any():
        return np.broadcast_to(own, poses.points.shape).copy()
    slopes = geometry.joint_slopes(poses.q, values, loads)
    return np.asarray(np.sqrt(own**2 + np.sum((slopes * joints) ** 2, axis=3)))


def _weights(residual: Array) -> Array:
    """Weight of each row in reweighted least squares."""
    return np.asarray(1.0 / np.sqrt(1.0 + (residual / KNEE) ** 2))


def _loss(residual: Array) -> float:
    """Soft-L1 loss, half the sum of squares of small residuals."""
    return float(KNEE**2 * np.sum(np.sqrt(1.0 + (residual / KNEE) ** 2) - 1.0))


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
