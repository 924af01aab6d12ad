"""95 % intervals of the unknowns of a stage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.stats import norm

from sysid.datasets.roles.needs import is_pose_set
from sysid.gap.candidates import Candidate
from sysid.gap.data import Data
from sysid.gap.equivalence import equivalent_half
from sysid.gap.fit import spread_of
from sysid.gap.intervals import jackknifed, known_of
from sysid.gap.likelihood.rows import SPANS
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.prepare.case import Case, Stage
from sysid.gap.stage_model import StageFit
from sysid.gap.stage_result import StageResult
from sysid.gap.thresholds import EXPLAINED, Z

Array = npt.NDArray[np.float64]


def with_intervals_of(stage: Stage, alone: Stage) -> Stage:
    """The stage with the intervals of its names alone: the effects adjusted beside them compensate for the formulas."""
    result, names = stage.found, alone.found
    assert result.limits is not None
    assert names.limits is not None
    limits = _with_names(result, result.limits, names, names.limits)
    presence = result.presence
    if presence is not None and names.presence is not None:
        presence = _with_names(result, presence, names, names.presence)
    return replace(stage, result=replace(result, limits=limits, presence=presence))


def _with_names(result: StageResult, limits: Array, names: StageResult, alone: Array) -> Array:
    """Intervals ``limits`` (k, 2) of a result with those of its names ``alone`` in place of theirs."""
    found = limits.copy()
    for kept in names.named:  # an effect that ties with others is not among them
        here, there = result.fit.rows_of(kept.candidate), names.fit.rows_of(kept.candidate)
        found[here, 0] = np.minimum(alone[there, 0], result.fit.values[here])
        found[here, 1] = np.maximum(alone[there, 1], result.fit.values[here])
    return found


def with_intervals(case: Case, stage: Stage) -> Stage:
    """The stage with the intervals of its unknowns, where it has names: the hull of those of both likelihoods.

    The posterior of the decision's model includes the discrepancy; the profile of :mod:`sysid.gap.intervals` bounds, thresholds
    and noise of the input. Values of the latter replace those of the model where they leave a tenth less of the free runs, or
    less, if the search has averaged its input, whose extremes determine backlash.
    """
    result = stage.found
    if not result.named or result.stage_fit is None:
        return stage
    regression = is_pose_set(case.dataset) or stage.problem.stage == "links"  # smooth: the posterior is exact
    if case.adapter is not None or regression:
        return replace(stage, result=replace(result, limits=limits_of(result)))
    seen = Data(stage.problem, stage.split.seen, stage.sigma)
    own = limits_of(result, _spread_of_parts(seen, stage.theta, result.stage_fit))
    known = known_of(seen, stage.theta, result.fit, case.noise, case.seed)
    limits = _hull(own, known.limits)
    presence = None
    if result.accumulates:
        squares = known_of(replace(seen, drifting=False), stage.theta, result.fit, case.noise, case.seed)
        presence = _hull(own, squares.limits)
    before, after = (spread_of(seen.residuals(f.theta[None])) for f in (result.fit, known.fit))
    margin = 1.0 if stage.problem.stage in SPANS else EXPLAINED
    fit = known.fit if margin * after < before else result.fit
    return replace(stage, result=replace(result, fit=fit, limits=limits, presence=presence))


def _hull(one: Array, other: Array) -> Array:
    """The intervals (k, 2) that contain those of both."""
    return np.column_stack([np.minimum(one[:, 0], other[:, 0]), np.maximum(one[:, 1], other[:, 1])])


def _spread_of_parts(seen: Data, theta: Array, fitted: StageFit) -> Array | None:
    """Half-widths of the least-squares values by the jackknife, where formulas are wrong: the best values depend on motion."""
    alone = fitted.least_squares
    if fitted.decision.exact or not alone.unknowns:
        return None
    return jackknifed(seen, theta, alone.unknowns, alone.values)


def limits_of(result: StageResult, spread: Array | None = None) -> Array:
    """95 % intervals of the unknowns of the chosen model, (k, 2), within their bounds.

    The hull of the interval of the stage's likelihood and that of the free run with the named effects alone, which differ where
    the formulas are wrong. Where their errors accumulate, of the likelihood only the estimate counts.

    Args:
        spread: half-widths of the latter by the differences between parts of the recordings.
    """
    fitted = result.stage_fit
    assert fitted is not None
    model, alone = fitted.decision.model, fitted.least_squares
    limits, least = (_interval(f, fitted.decision.exact, wide) for f, wide in ((model, None), (alone, spread)))
    for candidate in alone.candidates:
        if candidate.label in model.labels:
            here, there = model.rows_of(candidate), least[alone.rows_of(candidate)]
            kept = np.repeat(model.values[here, None], 2, axis=1) if result.accumulates else limits[here]
            limits[here, 0], limits[here, 1] = np.minimum(kept[:, 0], there[:, 0]), np.maximum(kept[:, 1], there[:, 1])
    low = np.array([u.bounds[0] for u in model.unknowns])
    high = np.array([u.bounds[1] for u in model.unknowns])
    return np.clip(limits, low[:, None], high[:, None])


def may_be_absent(result: StageResult, candidate: Candidate, limits: Array) -> bool:
    """Whether the intervals of all its parameters reach into the region of practical equivalence around the known value."""
    here = limits[result.fit.rows_of(candidate)]
    nominal = np.array([u.nominal for u in candidate.unknowns])
    half = np.zeros(len(nominal))
    if result.stage_fit is not None and candidate.label in result.stage_fit.decision.model.labels:
        half = equivalent_half(candidate, result.stage_fit.decision.model)
    return bool(((here[:, 0] <= nominal + half) & (nominal - half <= here[:, 1])).all())


def _interval(model: ModelFit, exact: bool, spread: Array | None) -> Array:
    """95 % intervals of a normal posterior, (k, 2), at least ``spread`` to both sides.

    Where the formulas are wrong, they include what the discrepancy could do in place of an effect.
    """
    half = Z * np.hypot(np.sqrt(np.diag(model.covariance)), 0.0 if exact else model.confounded)
    half = half if spread is None else np.maximum(half, spread)
    return np.asarray(model.values[:, None] + half[:, None] * [-1.0, 1.0])


def simultaneous(values: Array, limits: Array) -> Array:
    """Intervals (n, 2) that contain all ``n`` components of a vector with 95 % (Bonferroni), from those of each component."""
    wider = norm.ppf(1.0 - 0.025 / len(values)) / Z
    return np.asarray(values[:, None] + wider * (limits - values[:, None]))
