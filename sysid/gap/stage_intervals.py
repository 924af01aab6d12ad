"""95 % intervals of the unknowns of a stage: of its posterior, of its profile, and from parts of the recordings.

Where the formulas of a stage are wrong, the best values depend on the motion, and each part of the recordings has its own. The
jackknife leaves out each part in turn,

    θ₍g₎ − θ = −(DᵀD − D_gᵀD_g)⁻¹ D_gᵀ e_g,      V = (G − 1)/G · Σ_g (θ₍g₎ − θ)(θ₍g₎ − θ)ᵀ,

with the residuals ``e`` and their slopes ``−D``, and Student's t with G − 1 degrees of freedom. Unlike the sandwich of summed
scores it is not too small where there are few parts or one of them determines a parameter.

Sources: Efron and Stein, Ann. Stat. 9 (1981), 586–596; Bell and McCaffrey, Survey Methodology 28 (2002), 169–181; MacKinnon,
Nielsen and Webb, J. Econometrics 232 (2023), 272–299.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy import stats
from scipy.stats import norm

from sysid.gap.candidates import Candidate, Unknown, sizes_of
from sysid.gap.comparison import equivalent_half
from sysid.gap.data import Data
from sysid.gap.fit import place, spread_of
from sysid.gap.intervals import known_of
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.prepare.case import Case, Stage
from sysid.gap.stage_model import StageFit
from sysid.gap.stage_result import StageResult
from sysid.gap.thresholds import TENTH, Z

Array = npt.NDArray[np.float64]


def with_intervals_of(stage: Stage, alone: Stage) -> Stage:
    """The stage with the intervals of its names alone: the effects adjusted beside them compensate for the formulas."""
    result, names = stage.found, alone.found
    assert result.limits is not None
    assert names.limits is not None
    return replace(stage, result=replace(result, limits=_with_names(result, result.limits, names, names.limits)))


def _with_names(result: StageResult, limits: Array, names: StageResult, alone: Array) -> Array:
    """Intervals ``limits`` (k, 2) of a result with those of its names ``alone`` in place of theirs."""
    found = limits.copy()
    for kept in names.named:  # an effect that ties with others is not among them
        here, there = result.fit.rows_of(kept.candidate), names.fit.rows_of(kept.candidate)
        found[here, 0] = np.minimum(alone[there, 0], result.fit.values[here])
        found[here, 1] = np.maximum(alone[there, 1], result.fit.values[here])
    return found


def with_intervals(case: Case, stage: Stage) -> Stage:
    """The stage with the intervals of its unknowns, where it has names: the hull of two.

    The posterior of the decision's model includes the discrepancy; the profile of :mod:`sysid.gap.intervals` bounds, thresholds
    and noise of the input. Values of the latter replace those of the model where they leave a tenth less of the free runs, or
    less, if the search has averaged its input, whose extremes determine backlash.
    """
    result = stage.found
    if not result.named or result.stage_fit is None:
        return stage
    if case.adapter is not None or stage.problem.kind.regression:
        return replace(stage, result=replace(result, limits=limits_of(result)))
    seen = Data(stage.problem, stage.split.seen, stage.sigma)
    own = limits_of(result, _spread_of_parts(seen, stage.theta, result.stage_fit))
    known = known_of(seen, stage.theta, result.fit, case.noise, case.seed)
    limits = _hull(own, known.limits)
    before, after = (spread_of(seen.residuals(f.theta[None])) for f in (result.fit, known.fit))
    margin = 1.0 if stage.problem.kind.static else TENTH
    fit = known.fit if margin * after < before else result.fit
    return replace(stage, result=replace(result, fit=fit, limits=limits))


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
    limits, least = (interval_of(f, fitted.decision.exact, wide) for f, wide in ((model, None), (alone, spread)))
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
    (first, _), (last, _) = (sizes_of(candidate.unknowns, ends) for ends in here.T)
    nominal, _ = sizes_of(candidate.unknowns, np.array([u.nominal for u in candidate.unknowns]))
    half = np.zeros(len(nominal))
    if result.stage_fit is not None and candidate.label in result.stage_fit.decision.model.labels:
        model = result.stage_fit.decision.model
        half = equivalent_half(candidate, model) * sizes_of(candidate.unknowns, model.values_of(candidate))[1]
    low, high = np.minimum(first, last), np.maximum(first, last)
    return bool(((low <= nominal + half) & (nominal - half <= high)).all())


def interval_of(model: ModelFit, exact: bool, spread: Array | None) -> Array:
    """95 % intervals of a normal posterior, (k, 2), at least ``spread`` to both sides; of sizes (:func:`sizes_of`).

    Where the formulas are wrong, they include what the discrepancy could do in place of an effect.
    """
    half = Z * np.hypot(np.sqrt(np.diag(model.covariance)), 0.0 if exact else model.confounded)
    half = half if spread is None else np.maximum(half, spread)
    ends = model.values[:, None] + half[:, None] * [-1.0, 1.0]
    inverse = np.array([u.reciprocal for u in model.unknowns], dtype=bool)
    size, slope = sizes_of(model.unknowns, model.values)
    low, high = size - slope * half, size + slope * half
    infinite = np.divide(1.0, low, out=np.full(len(low), np.inf), where=low > 0.0)
    ends[inverse] = np.column_stack([1.0 / high[inverse], infinite[inverse]])
    return np.asarray(ends)


def simultaneous(values: Array, limits: Array) -> Array:
    """Intervals (n, 2) that contain all ``n`` components of a vector with 95 % (Bonferroni), from those of each component."""
    wider = norm.ppf(1.0 - 0.025 / len(values)) / Z
    return np.asarray(values[:, None] + wider * (limits - values[:, None]))


# -- differences between parts of the recordings -----------------------------------------------------------------------------

Clusters = npt.NDArray[np.int64]

#: Correlation length of the errors of a free run [s].
CORRELATED = 25.0
#: Least number of clusters beyond that of the unknowns.
MIN_FREE = 2
#: Steps of the slopes, in the negligible change. Within a short step no motion, or one alone, begins at another sample.
SMOOTH, STEPWISE = 0.1, 1.0
#: Prior standard deviation of an unknown, in its negligible change.
PRIOR = 1e3


def jackknifed(data: Data, theta: Array, unknowns: Sequence[Unknown], values: Array) -> Array:
    """Half-widths (k,) of 95 % intervals of least-squares ``values`` (k,), from parts of the correlation length.

    Args:
        theta: vector of the plant under test.
    """
    prior = np.array([1.0 / (PRIOR * u.negligible) ** 2 for u in unknowns])
    return half_widths(*_linearised(data, theta, unknowns, values), prior)


def half_widths(errors: Array, slopes: Array, clusters: Clusters, prior: Array) -> Array:
    """Half-widths (k,) by the jackknife.

    Args:
        errors: residuals at the optimum (n,); slopes: of the prediction (n, k).
        clusters: of each row (n,). prior: inverse variances (k,).
    """
    k = slopes.shape[1]
    names = np.unique(clusters)
    free = len(names) - 1
    if len(names) < k + MIN_FREE:
        return np.zeros(k)
    whole = slopes.T @ slopes + np.diag(prior)
    scale = 1.0 / np.sqrt(np.diag(whole))
    moved = np.empty((len(names), k))
    for g, name in enumerate(names):
        D, e = slopes[clusters == name] * scale, errors[clusters == name]
        moved[g] = -scale * np.linalg.solve(whole * np.outer(scale, scale) - D.T @ D, D.T @ e)
    variance = free / len(names) * (moved**2).sum(axis=0)
    return np.asarray(stats.t.ppf(0.975, free) * np.sqrt(variance))


def _linearised(data: Data, theta: Array, unknowns: Sequence[Unknown], values: Array) -> tuple[Array, Array, Clusters]:
    """Residuals in noise floors (n,), slopes of the prediction (n, k), and the part of each row (n,)."""
    low, high = np.array([u.bounds for u in unknowns]).T
    steps = np.array([(STEPWISE if u.stepwise else SMOOTH) * u.negligible for u in unknowns])
    above, below = np.minimum(values + steps, high), np.maximum(values - steps, low)
    k = len(values)
    lanes = np.repeat(values[None], 2 * k + 1, axis=0)
    lanes[np.arange(1, k + 1), np.arange(k)] = above
    lanes[np.arange(k + 1, 2 * k + 1), np.arange(k)] = below
    errors, slopes, parts, count = [], [], [], 0
    for recording, table in zip(data.recordings, data.residuals(place(theta, unknowns, lanes)), strict=True):
        rows, signals = table.shape[1:]
        length = max(1, round(CORRELATED * data.problem.rate(recording)))
        part = count + np.repeat(np.arange(rows) // length, signals)
        count += -(-rows // length)
        flat = table.reshape(len(lanes), -1)
        there = ~np.isnan(flat).any(axis=0)
        errors.append(flat[0, there])
        slopes.append(((flat[k + 1 :] - flat[1 : k + 1]) / (above - below)[:, None])[:, there].T)
        parts.append(part[there])
    return np.concatenate(errors), np.concatenate(slopes), np.concatenate(parts)
