"""Kinematic calibration from poses: lengths, angles, zeros, frame and marker of a URDF with intervals and identifiability.

Maximum a posteriori: the prior of :mod:`sysid.networks.geometry` keeps non-identifiable combinations near the URDF, a soft-L1
loss reduces the weight of outliers, and each coordinate is weighted by the noise that its own sensors and those of the joints
cause there. The posterior covariance gives the intervals; a parameter whose posterior is hardly narrower than its prior is not
identified.

Source: Hollerbach, Khalil, Gautier, Springer Handbook of Robotics, ch. 8 (2016); weights by the propagated noise of the joints
are those of total least squares to first order (Fuller, Measurement Error Models, 1987).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from sysid.errors import ExcitationError
from sysid.networks.folded import FoldedChain
from sysid.networks.geometry import Geometry, GeometryParameter

Array = npt.NDArray[np.float64]

#: Least number of poses.
MIN_POSES = 10
#: Lower bound of the estimated noise, as a share of the stated noise.
MIN_NOISE_SCALE = 1e-3
#: A parameter is identified where its posterior standard deviation is less than this share of the prior's.
IDENTIFIED_SHARE = 0.5
#: A combination is non-identifiable where the information of the poses is less than that of the prior.
MAX_INFORMATION = 1.0
#: Components of a combination below this share of the largest are not listed.
MIN_COMPONENT = 0.1
_QUANTILE = 1.959964


@dataclass(frozen=True)
class CalibratedParameter:
    """One parameter after calibration: departure from the URDF, its 95 % interval, and whether it is identified."""

    parameter: GeometryParameter
    value: float
    interval95: tuple[float, float]
    identified: bool


@dataclass(frozen=True)
class Calibration:
    """A calibrated geometry.

    Args:
        values: (P,), in the order of ``geometry.parameters``.
        covariance: of the values, (P, P).
        noise: standard deviation of the residuals of a tip coordinate [m], joint noise included.
        non_identifiable: combinations of parameters, with weights [m, rad], that do not move the tip at any of these poses.
    """

    geometry: Geometry
    values: Array
    covariance: Array
    noise: float
    non_identifiable: tuple[tuple[tuple[str, float], ...], ...]

    @property
    def parameters(self) -> tuple[CalibratedParameter, ...]:
        errors = np.sqrt(np.diag(self.covariance))
        return tuple(
            CalibratedParameter(
                parameter,
                float(value),
                (float(value - _QUANTILE * error), float(value + _QUANTILE * error)),
                bool(error < IDENTIFIED_SHARE * parameter.prior),
            )
            for parameter, value, error in zip(self.geometry.parameters, self.values, errors, strict=True)
        )

    def predict(self, q: Array) -> Array:
        """Tip at joint values ``q`` (n, n_axes), (n, 3) [m]."""
        return self._folded.tip(q)

    @cached_property
    def _folded(self) -> FoldedChain:
        return self.geometry.folded(self.values)

    def spread(self, q: Array) -> Array:
        """Standard deviation of the prediction from the parameter covariance, (n, 3) [m]."""
        slopes = self.geometry.slopes(q, self.values)
        return np.asarray(np.sqrt(np.einsum("ncp,pk,nck->nc", slopes, self.covariance, slopes)))


def calibrate(geometry: Geometry, q: Array, tip: Array, joint_noise: Array, tip_noise: Array) -> Calibration:
    """Fit the geometry to poses.

    Args:
        q: joint values, (n, n_axes) [rad or m].
        tip: measured tips in the base frame, (n, 3) [m].
        joint_noise, tip_noise: standard deviations of the sensors, (n_axes,) and (3,); NaN where unknown. Only their ratio
            matters: the noise level is estimated from the residuals.

    Raises:
        ExcitationError: fewer than :data:`MIN_POSES` poses.
    """
    from scipy.optimize import least_squares

    if len(q) < MIN_POSES:
        raise ExcitationError(
            "calibration",
            f"{len(q)} poses",
            f"at least {MIN_POSES}",
            "Record more static poses, spread over the joints' ranges.",
        )
    priors = geometry.priors
    values = np.zeros(len(priors))
    scale = 1.0  # estimated noise over stated noise
    for _ in range(4):
        sigma = _noise(geometry, q, values, joint_noise, tip_noise)

        def errors(scaled: Array, sigma: Array = sigma, scale: float = scale) -> Array:
            residual = (tip - geometry.tip(q, scaled * priors)) / (scale * sigma)
            return np.concatenate([_soft_l1_residual(residual).ravel(), scaled])

        def slopes(scaled: Array, sigma: Array = sigma, scale: float = scale) -> Array:
            residual = (tip - geometry.tip(q, scaled * priors)) / (scale * sigma)
            rows = -geometry.slopes(q, scaled * priors) * priors * (_soft_l1_derivative(residual) / (scale * sigma))[:, :, None]
            return np.vstack([rows.reshape(-1, len(priors)), np.eye(len(priors))])

        values = priors * least_squares(errors, values / priors, slopes).x
        residual = (tip - geometry.tip(q, values)) / sigma
        information = _information(geometry, q, values, scale * sigma)
        used = float(np.trace(np.linalg.solve(information + np.eye(len(priors)), information)))
        free = max(residual.size - used, 0.25 * residual.size)
        # The median is robust against outliers.
        scale = max(1.4826 * float(np.median(np.abs(residual))) * math.sqrt(residual.size / free), MIN_NOISE_SCALE)
    information = _information(geometry, q, values, scale * sigma)
    covariance = np.linalg.inv(information + np.eye(len(priors))) * np.outer(priors, priors)
    noise = scale * float(np.sqrt(np.mean(sigma**2)))
    return Calibration(geometry, values, covariance, noise, _non_identifiable(geometry, information))


def _noise(geometry: Geometry, q: Array, values: Array, joint_noise: Array, tip_noise: Array) -> Array:
    """Standard deviation of every tip coordinate, (n, 3), up to a common factor: sensor noise and propagated joint noise."""
    own = np.where(np.isnan(tip_noise), 1e-3, tip_noise)
    slopes = geometry.joint_slopes(q, values)
    return np.asarray(np.sqrt(own**2 + np.sum((slopes * np.nan_to_num(joint_noise)) ** 2, axis=2)))


def _soft_l1_residual(residual: Array) -> Array:
    """Residuals whose square is the soft-L1 loss with its knee at three standard deviations."""
    knee = 3.0
    return np.asarray(np.sign(residual) * knee * np.sqrt(2.0 * (np.sqrt(1.0 + (residual / knee) ** 2) - 1.0)))


def _soft_l1_derivative(residual: Array) -> Array:
    """Derivative of :func:`_soft_l1_residual`."""
    knee = 3.0
    root = np.sqrt(1.0 + (residual / knee) ** 2)
    return np.asarray(np.sqrt((root + 1.0) / 2.0) / root)


def _information(geometry: Geometry, q: Array, values: Array, sigma: Array) -> Array:
    """Fisher information of the poses about the parameters in units of their priors, (P, P)."""
    slopes = geometry.slopes(q, values) * geometry.priors / sigma[:, :, None]
    flat = slopes.reshape(-1, slopes.shape[2])
    return np.asarray(flat.T @ flat)


def _non_identifiable(geometry: Geometry, information: Array) -> tuple[tuple[tuple[str, float], ...], ...]:
    """Basis of the non-identifiable combinations, in reduced echelon form so that each has few parameters."""
    strengths, directions = np.linalg.eigh(information)
    basis = directions[:, strengths < MAX_INFORMATION].T.copy()
    found = []
    for row in _reduced_echelon(basis):
        weights = row * geometry.priors
        named = [
            (parameter.key, float(weight))
            for parameter, weight, part in zip(geometry.parameters, weights, row, strict=True)
            if abs(part) >= MIN_COMPONENT * np.abs(row).max()
        ]
        found.append(tuple(named))
    return tuple(found)


def _reduced_echelon(basis: Array) -> Array:
    """Reduced row echelon form with pivots by size: each row has a parameter that no other row has."""
    rows = basis.copy()
    taken: list[int] = []
    for at in range(len(rows)):
        size = np.abs(rows[at:]).copy()
        size[:, taken] = 0.0
        pivot_row, pivot = np.unravel_index(int(np.argmax(size)), size.shape)
        rows[[at, at + int(pivot_row)]] = rows[[at + int(pivot_row), at]]
        rows[at] /= rows[at, pivot]
        for other in range(len(rows)):
            if other != at:
                rows[other] -= rows[other, pivot] * rows[at]
        taken.append(int(pivot))
    return rows
