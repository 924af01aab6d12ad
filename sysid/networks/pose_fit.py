"""Maximum a posteriori fit of a geometry to poses.

Each coordinate is weighted by the noise that its own sensor and those of the joints cause there, a soft-L1 loss reduces the
weight of outliers, and the noise level is estimated from the residuals. Gauss-Newton steps with reweighting minimise the loss
at constant gravity loads; loads, weights by the joints' noise and noise level are renewed until they no longer change.

Where the measured poses lie far from those of the URDF, the frame of the measurement and the places of the points are found
first: rotation, translation and one offset for each point are fitted to the nominal chain by least squares with a soft-L1 loss,
from several starts. A calibration keeps its parameters near the URDF, so that it needs such a start in the frame of a camera.

Which optional parameters the poses support is compared by Bayesian evidence. At a fit the model is linear, y = X·β + e, with
β ~ N(0, 1) in units of the priors and e ~ N(0, s²) in units of the stated noise. Any subset of the parameters then has its
evidence in closed form, with the noise s at its maximum (type II likelihood):

    log Z = −N·log s − ½·log|1 + H/s²| − ½·(yᵀy − bᵀ(H + s²)⁻¹b)/s²        H = XᵀX, b = Xᵀy

A compliance is not negative: its prior is the half of a Gaussian above zero, which multiplies Z by 2·Φ(mean/deviation) of its
posterior. Scales, compliances and lateral compliances enter one after the other, the most probable first, leave again where
they are not needed any more, and are exchanged for others, until no step raises the evidence by :data:`MIN_GAIN`.

Sources: weights by the propagated noise of the joints are those of total least squares to first order (Fuller, Measurement
Error Models, 1987); iteratively reweighted least squares: Holland and Welsch, Commun. Statist. A6 (1977), 813–827; MacKay,
Neural Computation 4 (1992), 415–447 (evidence); Kass and Raftery, J. Am. Stat. Assoc. 90 (1995), 773–795: a Bayes factor of 20,
log 3, is strong evidence.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
import scipy

from sysid.machine.kinematics import pose_of
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
            step = scipy.linalg.cho_solve(scipy.linalg.cho_factor(matrix), gradient)
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
    frame = pose_of(Rotation.from_rotvec(best[:3]).as_matrix(), best[3:6])
    return replace(geometry, frame=frame @ geometry.frame, offsets=geometry.offsets_of_points + best[6:].reshape(count, 3))


Set = frozenset[int]

#: Least gain of an accepted parameter, and below which two alternatives are a tie [nats].
MIN_GAIN = 3.0
#: Standard deviation of the noise about the stated noise (natural logarithm), where one is stated.
NOISE_SPREAD = 1.0
#: Noise levels at which the evidence is evaluated, in steps of a fifth of e.
_LEVELS = np.exp(np.arange(-8.0, 8.0, 0.1))
_MOST_STEPS = 100


@dataclass(frozen=True)
class Support:
    """Support of one optional parameter in the selected model.

    Args:
        gain: log evidence lost without it [nats].
        alternative: key of the parameter that would replace it best, where the evidence would fall by less than
            :data:`MIN_GAIN`: the poses do not distinguish the two.
    """

    gain: float
    alternative: str | None


@dataclass
class SubsetEvidence:
    """Log evidence of subsets of the optional parameters beside those that are always estimated.

    Args:
        fit: of a model in which all of them were free.
        noise_stated: whether the noise of the points is known up to :data:`NOISE_SPREAD`.
    """

    fit: PoseFit
    noise_stated: bool
    known: dict[Set, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        fit = self.fit
        free = np.flatnonzero(fit.free)
        priors = fit.geometry.priors[free]
        root = np.sqrt(fit.weights)[:, None]
        columns = root * fit.slopes
        target = root[:, 0] * (fit.residual + fit.slopes @ (fit.values[free] / priors))
        self._products, self._slope, self._square = columns.T @ columns, columns.T @ target, float(target @ target)
        self._rows = len(target)
        self._place = {int(parameter): place for place, parameter in enumerate(free)}
        optional = fit.geometry.optional
        self._always = [self._place[int(parameter)] for parameter in free if not optional[parameter]]
        self.candidates = tuple(int(parameter) for parameter in free if optional[parameter])

    def __call__(self, members: Set) -> float:
        if members not in self.known:
            self.known[members] = self._evidence(members)
        return self.known[members]

    def _evidence(self, members: Set) -> float:
        places = np.array([*self._always, *(self._place[parameter] for parameter in sorted(members))], dtype=np.intp)
        strengths, directions = np.linalg.eigh(self._products[np.ix_(places, places)])
        strengths = np.maximum(strengths, 0.0)
        along = directions.T @ self._slope[places]
        square = _LEVELS[:, None] ** 2
        explained = (along**2 / (strengths + square)).sum(axis=1)
        value = -self._rows * np.log(_LEVELS) - 0.5 * (self._square - explained) / square[:, 0]
        value -= 0.5 * np.log1p(strengths / square).sum(axis=1)
        if self.noise_stated:
            value -= 0.5 * (np.log(_LEVELS) / NOISE_SPREAD) ** 2
        best = int(np.argmax(value))
        square = float(square[best, 0])
        mean = directions @ (along / (strengths + square))
        variance = (directions**2 / (strengths / square + 1.0)).sum(axis=1)
        elastic = self.fit.geometry.elastic
        one_sided = [k for k, parameter in enumerate(sorted(members), len(self._always)) if elastic[parameter]]
        half = np.log(2.0) + scipy.special.log_ndtr(mean[one_sided] / np.sqrt(variance[one_sided]))
        return float(value[best] + half.sum())

    def selected(self, start: Set = frozenset()) -> Set:
        """The subset from which no addition, exchange or removal raises the evidence by :data:`MIN_GAIN`."""
        best = start
        for _ in range(_MOST_STEPS):
            smaller = [best - {parameter} for parameter in sorted(best)]
            larger = [best | {parameter} for parameter in self.candidates if parameter not in best]
            for neighbours, price in ((smaller, -MIN_GAIN), (larger, MIN_GAIN)):
                found = max(neighbours, key=self, default=best)
                if found != best and self(found) > self(best) + price:
                    best = found
                    break
            else:
                exchanged = max(self._exchanged(best), key=self, default=best)
                if self(exchanged) <= self(best) + 1e-6:
                    return best
                best = exchanged
        return best

    def support(self, members: Set) -> dict[int, Support]:
        """Of every member of a subset."""
        keys = [parameter.key for parameter in self.fit.geometry.parameters]
        found = {}
        for parameter in sorted(members):
            rest = members - {parameter}
            alternative = max(
                (other for other in self.candidates if other not in members),
                key=lambda other: self(rest | {other}),
                default=None,
            )
            instead = None
            if alternative is not None and self(rest | {alternative}) > self(members) - MIN_GAIN:
                instead = keys[alternative]
            found[parameter] = Support(self(members) - self(rest), instead)
        return found

    def _exchanged(self, members: Set) -> list[Set]:
        """One parameter for one other of the same joint or of the same kind."""
        parameters = self.fit.geometry.parameters
        return [
            (members - {old}) | {new}
            for old in sorted(members)
            for new in self.candidates
            if new not in members
            and (parameters[old].joint == parameters[new].joint or parameters[old].kind == parameters[new].kind)
        ]
