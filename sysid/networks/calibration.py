"""Geometry from poses: a URDF's lengths, angles, zeros, frame and marker, with intervals, and what no pose can tell apart.

Maximum a posteriori: the prior of :mod:`sysid.networks.geometry` keeps what the poses leave open near the drawing, soft-L1
forgives mistaken poses, and every coordinate of a pose counts by the noise that its own sensors and those of the joints cause
there. The posterior covariance gives the intervals; where it is hardly narrower than the prior, a value says nothing.

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

#: Fewer poses than this cannot tell noise from geometry.
MIN_POSES = 10
#: Perfect poses still count as if their sensors had this share of the noise that they are said to have.
LEAST = 1e-3
#: A parameter is known where the poses narrow its prior to less than this share.
KNOWN = 0.5
#: A combination counts as open where the poses say less about it than the prior does.
OPEN = 1.0
#: Parts of a combination that are smaller than this share of its largest are left out of its name.
PART = 0.1
_QUANTILE = 1.959964


@dataclass(frozen=True)
class Calibrated:
    """One parameter after calibration: departure from the URDF, its 95 % interval, whether the poses say anything of it."""

    parameter: GeometryParameter
    value: float
    interval95: tuple[float, float]
    known: bool


@dataclass(frozen=True)
class Calibration:
    """What the poses say of a geometry.

    Args:
        values: (P,), in the order of ``geometry.parameters``.
        covariance: of them, (P, P).
        noise: standard deviation of a tip coordinate that is left [m], joint noise included.
        open_combinations: groups of parameters with weights (in m, rad) that move the tip alike at all these poses.
    """

    geometry: Geometry
    values: Array
    covariance: Array
    noise: float
    open_combinations: tuple[tuple[tuple[str, float], ...], ...]

    @property
    def parameters(self) -> tuple[Calibrated, ...]:
        errors = np.sqrt(np.diag(self.covariance))
        return tuple(
            Calibrated(
                parameter,
                float(value),
                (float(value - _QUANTILE * error), float(value + _QUANTILE * error)),
                bool(error < KNOWN * parameter.prior),
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
        """Standard deviation of the prediction by what the poses leave open of the geometry, (n, 3) [m]."""
        slopes = self.geometry.slopes(q, self.values)
        return np.asarray(np.sqrt(np.einsum("ncp,pk,nck->nc", slopes, self.covariance, slopes)))


def calibrate(geometry: Geometry, q: Array, tip: Array, joint_noise: Array, tip_noise: Array) -> Calibration:
    """Fit the geometry to poses.

    Args:
        q: joint values, (n, n_axes) [rad or m].
        tip: measured tips in the base frame, (n, 3) [m].
        joint_noise, tip_noise: standard deviations of the sensors, (n_axes,) and (3,); NaN where unknown. Their ratio matters,
            not their size: the scale of the noise is estimated from what is left.

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
    scale = 1.0  # of the noise, in what the sensors are said to have
    for _ in range(4):
        sigma = _noise(geometry, q, values, joint_noise, tip_noise)

        def errors(scaled: Array, sigma: Array = sigma, scale: float = scale) -> Array:
            left = (tip - geometry.tip(q, scaled * priors)) / (scale * sigma)
            return np.concatenate([_forgiven(left).ravel(), scaled])

        def slopes(scaled: Array, sigma: Array = sigma, scale: float = scale) -> Array:
            left = (tip - geometry.tip(q, scaled * priors)) / (scale * sigma)
            rows = -geometry.slopes(q, scaled * priors) * priors * (_slope(left) / (scale * sigma))[:, :, None]
            return np.vstack([rows.reshape(-1, len(priors)), np.eye(len(priors))])

        values = priors * least_squares(errors, values / priors, slopes).x
        left = (tip - geometry.tip(q, values)) / sigma
        information = _information(geometry, q, values, scale * sigma)
        used = float(np.trace(np.linalg.solve(information + np.eye(len(priors)), information)))
        free = max(left.size - used, 0.25 * left.size)
        # The median: a pose that is mistaken by a hand's breadth says nothing about the noise of the others.
        scale = max(1.4826 * float(np.median(np.abs(left))) * math.sqrt(left.size / free), LEAST)
    information = _information(geometry, q, values, scale * sigma)
    covariance = np.linalg.inv(information + np.eye(len(priors))) * np.outer(priors, priors)
    noise = scale * float(np.sqrt(np.mean(sigma**2)))
    return Calibration(geometry, values, covariance, noise, _open(geometry, information))


def _noise(geometry: Geometry, q: Array, values: Array, joint_noise: Array, tip_noise: Array) -> Array:
    """Standard deviation of every tip coordinate, (n, 3), up to a common factor."""
    own = np.where(np.isnan(tip_noise), 1e-3, tip_noise)
    slopes = geometry.joint_slopes(q, values)
    return np.asarray(np.sqrt(own**2 + np.sum((slopes * np.nan_to_num(joint_noise)) ** 2, axis=2)))


def _forgiven(left: Array) -> Array:
    """Residuals whose square is the soft-L1 loss with its knee at three standard deviations."""
    knee = 3.0
    return np.asarray(np.sign(left) * knee * np.sqrt(2.0 * (np.sqrt(1.0 + (left / knee) ** 2) - 1.0)))


def _slope(left: Array) -> Array:
    """Derivative of :func:`_forgiven`."""
    knee = 3.0
    root = np.sqrt(1.0 + (left / knee) ** 2)
    return np.asarray(np.sqrt((root + 1.0) / 2.0) / root)


def _information(geometry: Geometry, q: Array, values: Array, sigma: Array) -> Array:
    """What the poses say about the parameters in units of their priors, (P, P)."""
    slopes = geometry.slopes(q, values) * geometry.priors / sigma[:, :, None]
    flat = slopes.reshape(-1, slopes.shape[2])
    return np.asarray(flat.T @ flat)


def _open(geometry: Geometry, information: Array) -> tuple[tuple[tuple[str, float], ...], ...]:
    """Combinations that the poses leave open, each with as few parameters as can be."""
    strengths, directions = np.linalg.eigh(information)
    basis = directions[:, strengths < OPEN].T.copy()
    found = []
    for row in _echelon(basis):
        weights = row * geometry.priors
        named = [
            (parameter.key, float(weight))
            for parameter, weight, part in zip(geometry.parameters, weights, row, strict=True)
            if abs(part) >= PART * np.abs(row).max()
        ]
        found.append(tuple(named))
    return tuple(found)


def _echelon(basis: Array) -> Array:
    """The same space by rows that have a parameter each which no other row has (reduced echelon form, pivots by size)."""
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
