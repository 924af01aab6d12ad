"""Kinematic calibration from poses: geometry, elasticity, frame and markers of a URDF, with intervals and identifiability.

All parameters are estimated together. Geometry, frame and markers are always free; scales of readings, joint compliances and
lateral compliances only where the evidence of the poses supports them (:mod:`sysid.networks.geometry_evidence`). The posterior
covariance gives the intervals; a parameter whose posterior is hardly narrower than its prior is not determined.

Sources: Hollerbach, Khalil, Gautier, Springer Handbook of Robotics, ch. 8 (2016); geometric and elastic parameters together:
Khalil and Besnard, IEEE Trans. Robot. Autom. 18 (2002), 915–922; Nubiola and Bonev, Robot. Comput.-Integr. Manuf. 29 (2013),
236–245.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from sysid.errors import ExcitationError
from sysid.networks.calibration_models import ComparedModel, compared, selected_fit
from sysid.networks.folded import FoldedChain
from sysid.networks.geometry import Geometry
from sysid.networks.geometry_evidence import Support
from sysid.networks.geometry_parameters import GeometryParameter
from sysid.networks.identifiability import Combination, non_identifiable
from sysid.networks.pose_fit import PoseSet
from sysid.networks.registration import registered

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
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
            "models": [model.to_json() for model in self.models],
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
    members = frozenset(np.flatnonzero(fit.free & geometry.optional).tolist())
    information, priors = fit.information, geometry.priors[fit.free]
    covariance = np.zeros((len(fit.free), len(fit.free)))
    covariance[np.ix_(fit.free, fit.free)] = np.linalg.inv(information + np.eye(len(priors))) * np.outer(priors, priors)
    noise = fit.scale * float(np.sqrt(np.nanmean(fit.sigma**2)))
    estimated = [parameter for parameter, free in zip(geometry.parameters, fit.free, strict=True) if free]
    combinations = non_identifiable(estimated, information)
    models = compared(fit, poses, evidence, elastic) if compare else ()
    return Calibration(geometry, fit.values, covariance, noise, combinations, fit.free, evidence.support(members), models)
