"""Models of a pose set beside the selected one: evidence, and errors on poses that the fit has not seen.

Every model is fitted anew in each of :data:`FOLDS` folds of the poses, the selection of optional parameters included.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.networks.geometry import Geometry
from sysid.networks.geometry_evidence import SubsetEvidence
from sysid.networks.pose_fit import PoseFit, PoseSet, fit_poses

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

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    @staticmethod
    def from_json(entry: Mapping[str, Any]) -> ComparedModel:
        return ComparedModel(**entry)


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
