"""Kinematic calibration from poses: geometry, elasticity, frame and markers of a URDF, with intervals and identifiability.

All parameters are estimated together. Geometry, frame and markers are always free; scales of readings, joint compliances and
lateral compliances only where the evidence of the poses supports them (:mod:`sysid.networks.pose_fit`). The posterior
covariance gives the intervals; a parameter whose posterior is hardly narrower than its prior is not determined. Beside the
selected model stand others with their evidence, and their errors on poses that the fit has not seen: every model is fitted anew
in each of :data:`FOLDS` folds of the poses, the selection of optional parameters included.

Combinations of parameters that poses do not determine follow from the Jacobian, scaled by noise and prior. A right singular
vector whose singular value is below one is a combination about which the poses contain less information than the prior: only
sums that are orthogonal to it are determined.

Sources: Hollerbach, Khalil, Gautier, Springer Handbook of Robotics, ch. 8 (2016); geometric and elastic parameters together:
Khalil and Besnard, IEEE Trans. Robot. Autom. 18 (2002), 915–922; Nubiola and Bonev, Robot. Comput.-Integr. Manuf. 29 (2013),
236–245; singular values of the scaled identification Jacobian as measure of identifiability: Hollerbach and Wampler, Int. J.
Robot. Res. 15 (1996), 573–591.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from sysid.errors import ExcitationError
from sysid.networks.calibrated_chain import FoldedChain, GeometryParameter
from sysid.networks.geometry import Geometry
from sysid.networks.pose_fit import PoseFit, PoseSet, SubsetEvidence, Support, fit_poses, registered

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

FOLDS = 5


@dataclass(frozen=True)
class ComparedModel:
    """A model beside others.

    Args:
        parameters: number of its parameters.
        log_evidence: relative to the selected model [nats]; None where its parameters are not among the compared subsets.
        held_out_rmse, held_out_median: distance between measured and predicted points of poses that the fit has not seen [m].
        worse, standard_error: mean over poses of its squared held-out error less the selected model's [m²].
    """

    name: str
    parameters: int
    log_evidence: float | None
    held_out_rmse: float
    held_out_median: float
    worse: float
    standard_error: float


def selected_fit(
    geometry: Geometry, poses: PoseSet, elastic: bool = True, start: PoseFit | None = None
) -> tuple[PoseFit, SubsetEvidence]:
    """The fit with the optional parameters that the poses support, and the evidence that selected them.

    Args:
        start: fit to begin at, of other poses of the same machine.
    """
    allowed = np.ones(len(geometry.parameters), dtype=bool) if elastic else ~geometry.elastic
    stated = bool(np.isfinite(poses.point_noise).all())
    first = fit_poses(geometry, poses, ~geometry.optional) if start is None else start
    fit = fit_poses(geometry, poses, allowed, first.values, first.scale)
    evidence = SubsetEvidence(fit, stated)
    free = ~geometry.optional
    free[list(evidence.selected())] = True
    return fit_poses(geometry, poses, free, fit.values, fit.scale), evidence


def compared(fit: PoseFit, poses: PoseSet, evidence: SubsetEvidence, elastic: bool) -> tuple[ComparedModel, ...]:
    """The selected model first, then the others from the smallest to the largest."""
    geometry = fit.geometry
    best = _members(fit.free, geometry)
    errors = {"selected": _held_out(poses, lambda part: selected_fit(geometry, part, elastic, fit)[0])}
    subsets: dict[str, tuple[int, float | None]] = {"selected": (int(fit.free.sum()), 0.0)}
    for name, free in _alternatives(geometry, elastic).items():
        errors[name] = _held_out(poses, lambda part, free=free: fit_poses(geometry, part, free, fit.values, fit.scale))  # type: ignore[misc]
        whole = bool((free | geometry.optional).all())
        relative = evidence(_members(free, geometry)) - evidence(best) if whole else None
        subsets[name] = (int(free.sum()), relative)
    own = np.nansum(errors["selected"] ** 2, axis=(1, 2))
    found = []
    for name, each in errors.items():
        distance = np.sqrt((each**2).sum(axis=2))
        worse = np.nansum(each**2, axis=(1, 2)) - own
        found.append(
            ComparedModel(
                name,
                *subsets[name],
                float(np.sqrt(np.nanmean(distance**2))),
                float(np.nanmedian(distance)),
                float(worse.mean()),
                float(worse.std() / np.sqrt(len(worse))),
            )
        )
    return tuple(found)


def _alternatives(geometry: Geometry, elastic: bool) -> dict[str, Mask]:
    """Parameters of the models that are compared with the selected one."""
    kinds = np.array([parameter.kind for parameter in geometry.parameters])
    frame = np.array([p.kind == "point" or (p.kind == "displacement" and p.joint == 0) for p in geometry.parameters])
    rigid = ~geometry.optional
    found = {"frame and markers": frame, "geometry": rigid, "geometry, scales": rigid | (kinds == "scale")}
    if elastic:
        found["geometry, compliance"] = rigid | (kinds == "compliance")
    return found


def _members(free: Mask, geometry: Geometry) -> frozenset[int]:
    return frozenset(np.flatnonzero(free & geometry.optional).tolist())


def _held_out(poses: PoseSet, fitted: Callable[[PoseSet], PoseFit]) -> Array:
    """Measured − predicted points (n, points, 3) [m], each pose predicted by a fit of the other folds."""
    errors = np.empty_like(poses.points)
    fold = np.random.default_rng(0).permutation(len(poses)) % FOLDS
    for number in range(FOLDS):
        held = np.flatnonzero(fold == number)
        fit = fitted(poses.take(np.flatnonzero(fold != number)))
        errors[held] = poses.points[held] - fit.geometry.points(poses.q[held], fit.values)
    return errors


Combination = tuple[tuple[str, float], ...]

#: A combination is non-identifiable where the information of the poses is less than that of the prior.
MAX_INFORMATION = 1.0
#: Components of a combination below this share of the largest are not listed.
MIN_COMPONENT = 0.1


def non_identifiable(parameters: Sequence[GeometryParameter], information: Array) -> tuple[Combination, ...]:
    """Basis of the non-identifiable combinations, in reduced echelon form so that each has few parameters.

    Args:
        parameters: estimated ones; ``information``: of the poses about them, in units of their priors.

    Returns:
        Of each combination the parameters and their weights in SI.
    """
    strengths, directions = np.linalg.eigh(information)
    basis = directions[:, strengths < MAX_INFORMATION].T.copy()
    found = []
    for row in _reduced_echelon(basis):
        found.append(
            tuple(
                (parameter.key, float(part * parameter.prior))
                for parameter, part in zip(parameters, row, strict=True)
                if abs(part) >= MIN_COMPONENT * np.abs(row).max()
            )
        )
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


Status = Literal["determined", "partly determined", "not determined"]

#: Least number of poses.
MIN_POSES = 10
#: A parameter is determined where its posterior standard deviation is less than this share of the prior's, and partly
#: determined below the second share.
DETERMINED_SHARE, PARTLY_SHARE = 0.1, 0.9
_QUANTILE = 1.959964


@dataclass(frozen=True)
class CalibratedParameter:
    """One parameter after calibration.

    Args:
        value: departure from the URDF; ``deviation``: standard deviation of its posterior.
        status: whether the poses determine it.
        support: of an optional parameter.
    """

    parameter: GeometryParameter
    value: float
    deviation: float
    status: Status
    support: Support | None = None

    @property
    def interval95(self) -> tuple[float, float]:
        return self.value - _QUANTILE * self.deviation, self.value + _QUANTILE * self.deviation

    @property
    def identified(self) -> bool:
        return self.status == "determined"

    def to_json(self) -> dict[str, Any]:
        """SI units."""
        own = self.parameter
        found: dict[str, Any] = {"key": own.key, "kind": own.kind, "value": self.value, "unit": own.unit}
        found |= {"interval95": list(self.interval95), "prior": own.prior, "status": self.status}
        if self.support is not None:
            found |= {"log_evidence": self.support.gain, "alternative": self.support.alternative}
        return found


@dataclass(frozen=True)
class Calibration:
    """A calibrated geometry.

    Args:
        values: (P,), in the order of ``geometry.parameters``.
        covariance: of the values, (P, P); zero of parameters that the model does not have.
        noise: standard deviation of the residuals of a tip coordinate [m], joint noise included.
        non_identifiable: combinations of parameters, with weights [SI], that do not move the points at any of these poses.
        free: parameters of the model, (P,); all if None.
        supports: of the optional ones, by index.
        models: comparison with other models; empty where none was made.
    """

    geometry: Geometry
    values: Array
    covariance: Array
    noise: float
    non_identifiable: tuple[Combination, ...]
    free: Mask | None = None
    supports: dict[int, Support] | None = None
    models: tuple[ComparedModel, ...] = ()

    @property
    def estimated(self) -> Mask:
        """Parameters of the model, (P,)."""
        return np.ones(len(self.values), dtype=bool) if self.free is None else self.free

    @property
    def parameters(self) -> tuple[CalibratedParameter, ...]:
        """Those of the model."""
        errors = np.sqrt(np.diag(self.covariance))
        supports = self.supports or {}
        return tuple(
            CalibratedParameter(
                parameter,
                float(value),
                float(error),
                _status(float(error) / parameter.prior),
                supports.get(index),
            )
            for index, (parameter, value, error) in enumerate(zip(self.geometry.parameters, self.values, errors, strict=True))
            if self.estimated[index]
        )

    @property
    def elastic(self) -> bool:
        """Whether joints deflect under load."""
        return self._folded is None

    def predict(self, q: Array) -> Array:
        """Tip at joint values ``q`` (n, n_axes), (n, 3) [m]."""
        return self.geometry.tip(q, self.values) if self._folded is None else self._folded.tip(q)

    @cached_property
    def _folded(self) -> FoldedChain | None:
        return self.geometry.folded(self.values)

    def spread(self, q: Array) -> Array:
        """Standard deviation of the prediction from the parameter covariance, (n, 3) [m]."""
        slopes = self.geometry.slopes(q, self.values)
        return np.asarray(np.sqrt(np.einsum("ncp,pk,nck->nc", slopes, self.covariance, slopes)))

    def to_json(self) -> dict[str, Any]:
        """For results, in SI."""
        return {
            "parameters": [parameter.to_json() for parameter in self.parameters],
            "non_identifiable": [[list(part) for part in combination] for combination in self.non_identifiable],
            "models": [asdict(model) for model in self.models],
            "noise": self.noise,
            "frame": self.geometry.frame.tolist(),
        }


def _status(share: float) -> Status:
    return "determined" if share < DETERMINED_SHARE else "partly determined" if share < PARTLY_SHARE else "not determined"


def calibrate(
    geometry: Geometry,
    q: Array,
    points: Array,
    joint_noise: Array,
    point_noise: Array,
    elastic: bool = True,
    compare: bool = False,
) -> Calibration:
    """Fit the geometry to poses; scales and compliances where the poses support them.

    Args:
        q: joint values, (n, n_axes) [rad or m].
        points: measured tips in the frame of the measurement, (n, 3) [m], or tips and markers, (n, points, 3).
        joint_noise, point_noise: standard deviations of the sensors, (n_axes,) and (3,) or (points, 3); NaN where unknown. Only
            their ratio matters: the noise level is estimated from the residuals.
        elastic: whether joints may deflect.
        compare: whether other models are fitted to folds of the poses beside it.

    Raises:
        ExcitationError: fewer than :data:`MIN_POSES` poses.
    """
    if len(q) < MIN_POSES:
        raise ExcitationError(
            "calibration",
            f"{len(q)} poses",
            f"at least {MIN_POSES}",
            "Record more static poses, spread over the joints' ranges.",
        )
    poses = PoseSet(q, points.reshape(len(q), -1, 3), joint_noise, point_noise.reshape(-1, 3))
    return calibrate_poses(registered(geometry, poses), poses, elastic, compare)


def calibrate_poses(geometry: Geometry, poses: PoseSet, elastic: bool = True, compare: bool = False) -> Calibration:
    """:func:`calibrate` of a registered geometry; with the comparison with other models on folds of the poses."""
    fit, evidence = selected_fit(geometry, poses, elastic)
    members = _members(fit.free, geometry)
    information, priors = fit.information, geometry.priors[fit.free]
    covariance = np.zeros((len(fit.free), len(fit.free)))
    covariance[np.ix_(fit.free, fit.free)] = np.linalg.inv(information + np.eye(len(priors))) * np.outer(priors, priors)
    noise = fit.scale * float(np.sqrt(np.nanmean(fit.sigma**2)))
    estimated = [parameter for parameter, free in zip(geometry.parameters, fit.free, strict=True) if free]
    combinations = non_identifiable(estimated, information)
    models = compared(fit, poses, evidence, elastic) if compare else ()
    return Calibration(geometry, fit.values, covariance, noise, combinations, fit.free, evidence.support(members), models)


def put_result(calibration: Calibration) -> dict[str, Any]:
    """Entries for JSON: combinations, parameters of the model, their supports, comparison with other models."""
    keys = [parameter.key for parameter in calibration.geometry.parameters]
    supports = calibration.supports or {}
    return {
        "open": [[list(part) for part in combination] for combination in calibration.non_identifiable],
        "free": [key for key, free in zip(keys, calibration.estimated, strict=True) if free],
        "supports": {keys[index]: [support.gain, support.alternative] for index, support in supports.items()},
        "models": [asdict(model) for model in calibration.models],
    }


def take_result(entry: Mapping[str, Any], calibration: Calibration) -> Calibration:
    """The calibration with the entries of :func:`put_result`; a version of an earlier release has only the combinations."""
    keys = [parameter.key for parameter in calibration.geometry.parameters]
    combinations = tuple(tuple((str(key), float(weight)) for key, weight in part) for part in entry["open"])
    free = np.isin(keys, entry["free"]) if "free" in entry else calibration.estimated
    supports = {keys.index(key): Support(float(gain), other) for key, (gain, other) in entry.get("supports", {}).items()}
    models = tuple(ComparedModel(**model) for model in entry.get("models", ()))
    return replace(calibration, non_identifiable=combinations, free=free, supports=supports, models=models)
