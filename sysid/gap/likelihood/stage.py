"""The statistical model of one stage: the prediction of a set of effects, timing, discrepancy, disturbance and noise.

    y = plant(θ) + half a sample of timing + Φ·β + disturbance + noise,      β_j ~ N(0, τ²_group(j)),   θ_j ~ N(c_j, s_j²)

Noise and disturbance whiten the residual once; timing and discrepancy are linear and are marginalised in closed form; θ is
found by Gauss–Newton. The marginal likelihood (evidence) is Laplace's approximation. The variances are estimated with the
richest model and shared by all models of the stage (:mod:`sysid.gap.likelihood.variances`).

The discrepancy is orthogonal to the effects of a model over the free run, so that θ is the best fit of the output.

Sources: Kennedy and O'Hagan 2001 (discrepancy); Plumlee, JASA 112 (2017), 1274–1285 (orthogonal to the model); Kristensen,
Madsen and Jørgensen, Automatica 40 (2004), 225–237 (stochastic grey-box models); MacKay, Information Theory, Inference, and
Learning Algorithms, 2003, ch. 27–28 (evidence).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from sysid.gap.candidates import Candidate, Unknown
from sysid.gap.fit import place
from sysid.gap.likelihood.block_products import (
    ROUNDING,
    BlockProducts,
    factored,
    posterior_covariance,
    predictive_densities,
    products_by_block,
)
from sysid.gap.likelihood.discrepancy import Discrepancy
from sysid.gap.likelihood.disturbance import Disturbance, Filter, filter_of
from sysid.gap.likelihood.rows import Series, StageRows

Array = npt.NDArray[np.float64]

#: Prior standard deviation of a parameter, in the largest distance of a start value from nominal.
PRIOR_WIDTH = 10.0
#: The same in its negligible change, where the nominal value is the only start value.
PRIOR_WIDTH_NEGLIGIBLE = 100.0
#: Smallest plausible size of an effect, in its negligible change.
FINEST = 0.1
#: Directions of the linear part with a prior variance below this share of the noise's are left out.
NEGLIGIBLE = 0.02
#: Ridge of the regression on effects, for effects with the same output.
RIDGE = 1e-10
#: Columns of more noise floors come from a simulation that diverges.
DIVERGED = 1e6
#: Innovations beyond so many standard deviations count less (Huber 1964).
HUBER = 4.0


@dataclass(frozen=True)
class Variances:
    """Variances that all models of a stage share.

    Args:
        disturbances: one for each signal.
        groups: standard deviation τ of the coefficients of each group of the discrepancy, (g,).
        weights: square root of the weight of each row, (rows,): outliers of the richest model count less.
        left: remaining error of the richest model beyond noise, the limit of each group [noise floors]; infinite where errors
            accumulate.
    """

    disturbances: tuple[Disturbance, ...]
    groups: Array
    weights: Array
    left: float = np.inf


@dataclass(frozen=True)
class Linear:
    """The linear part, whitened and in unit prior: ``columns`` (rows, p), their products ``gram`` (p, p).

    ``weights``: of the columns of the discrepancy (m,) in each of them, (m, p).
    """

    columns: Array
    gram: Array
    weights: Array

    @cached_property
    def alone(self) -> Orthogonal:
        """Without effects."""
        none = np.zeros((len(self.columns), 0))
        return Orthogonal(self.columns, none, np.zeros((0, len(self.gram))), _factor(self.gram))

    def beside(self, slopes: Array, share: Array) -> Orthogonal:
        """Less ``share`` (k, p) of the effects of a model: ``slopes`` (rows, k) whitened.

        Computed from products, without a table of rows.
        """
        both = share.T @ (slopes.T @ self.columns)
        gram = self.gram - both - both.T + share.T @ (slopes.T @ slopes) @ share
        return Orthogonal(self.columns, slopes, share, _factor(gram))


@dataclass(frozen=True)
class Orthogonal:
    """The linear part less ``share`` (k, p) of the ``slopes`` (rows, k) of a model's effects, with its factor."""

    whole: Array
    slopes: Array
    share: Array
    factor: Array

    def products(self, columns: Array, rows: slice = slice(None)) -> Array:
        """Of ``columns`` (n, m), which belong to some of the rows, with the linear part there, (p, m)."""
        return np.asarray(self.whole[rows].T @ columns - self.share.T @ (self.slopes[rows].T @ columns))

    def solved(self, products: Array) -> Array:
        """``products`` (p, m) of some columns in an orthonormal basis of the linear part, (p, m)."""
        return np.asarray(solve_triangular(self.factor, products, lower=True))

    def projected(self, columns: Array) -> Array:
        """Projection of ``columns`` (rows, m) on the linear part, (p, m), to be subtracted from their products."""
        return self.solved(self.products(columns))


def share_of(effects: Array, products: Array) -> Array:
    """Least-squares coefficients (k, p) of the columns of a discrepancy on the effects' outputs (rows, k), in noise floors.

    ``products`` (k, p): of the effects with these columns. The effects are in units of their prior, which suppresses effects
    without a slope.
    """
    scale = np.maximum(np.linalg.norm(effects, axis=0), 1.0)
    unit = effects / scale
    normal = unit.T @ unit + np.diag(scale**-2.0) + RIDGE * np.eye(len(scale))
    return np.asarray(np.linalg.solve(normal, products / scale[:, None]) / scale[:, None])


@dataclass(frozen=True, eq=False)
class ModelFit:
    """A set of effects fitted.

    Args:
        values: of ``unknowns``, (k,).
        covariance: of the values, the linear part marginalised, (k, k).
        evidence: log marginal likelihood.
        predictive: log density of each block, parameters and discrepancy from the other blocks, (blocks,).
        rms: root mean square of the whitened rows that neither effects nor discrepancy explain.
        confounded: standard deviations of each unknown by what the discrepancy could do in its place, (k,); zero where errors
            accumulate, where the free run decides.
        response: RMS change of the output per unit of each unknown, in noise floors, (k,).
        left: RMS error of the output beside the effects, in noise floors.
    """

    candidates: tuple[Candidate, ...]
    unknowns: tuple[Unknown, ...]
    values: Array
    theta: Array
    covariance: Array
    confounded: Array
    evidence: float
    predictive: Array
    rms: float
    response: Array
    left: float

    @property
    def labels(self) -> frozenset[str]:
        return frozenset(c.label for c in self.candidates)

    def rows_of(self, candidate: Candidate) -> slice:
        """Which of ``unknowns`` belong to one of the candidates."""
        at = 0
        for known in self.candidates:
            if known.label == candidate.label:
                return slice(at, at + len(known.unknowns))
            at += len(known.unknowns)
        raise KeyError(candidate.label)

    def values_of(self, candidate: Candidate) -> Array:
        return self.values[self.rows_of(candidate)]

    def with_values(self, other: ModelFit) -> ModelFit:
        """The same set of effects with the values of another fit of it and their error; evidence and predictions stay."""
        if other is self:
            return self
        return replace(
            self, values=other.values, theta=other.theta, covariance=other.covariance, confounded=other.confounded,
            response=other.response, left=other.left,
        )  # fmt: skip

    def deviations_of(self, candidate: Candidate) -> Array:
        """Standard deviations of its values."""
        here = self.rows_of(candidate)
        return np.asarray(np.sqrt(np.diag(self.covariance)[here]))


@dataclass(frozen=True)
class Prior:
    """Normal prior of some unknowns: ``centre`` and ``width``, (k,) each; bounds ``low`` and ``high``.

    ``finest``: the smallest plausible width, (k,); equal to ``width`` where the nominal value is far from the start values.
    """

    centre: Array
    width: Array
    low: Array
    high: Array
    finest: Array

    def at_scale(self, values: Array) -> tuple[Array, float]:
        """Widths of maximum evidence at ``values`` (k,), and the cost of their being unknown [nats].

        The size of an effect is unknown over decades: the logarithm of a width is uniform between ``finest`` and ``width``. A
        normal density is largest where its width equals the distance; Laplace's approximation over the logarithm (curvature 2)
        gives a factor of √π / ln(width / finest).
        """
        decades = np.log(self.width / self.finest)
        known = decades <= 0.0
        widths = np.where(known, self.width, np.clip(np.abs(values - self.centre), self.finest, self.width))
        cost = np.where(known, 0.0, np.log(np.maximum(decades, np.sqrt(np.pi))) - 0.5 * np.log(np.pi))
        return widths, float(cost.sum())


def prior_of(candidates: Sequence[Candidate]) -> Prior:
    """Prior centred at the nominal values, with widths from the start values.

    An unknown whose nominal value is far from all start values (a limit that is never reached) is centred among them.
    """
    centre, width, low, high, finest = [], [], [], [], []
    for candidate in candidates:
        starts = np.array(candidate.starts)
        for k, unknown in enumerate(candidate.unknowns):
            values = starts[:, k]
            span = max(float(np.abs(values).max()), float(np.ptp(values)), unknown.negligible)
            far = float(np.abs(unknown.nominal - values).min()) > 3.0 * span
            centre.append(float(np.mean(values)) if far else unknown.nominal)
            away = np.abs(values - unknown.nominal)
            reach = span if far else float(np.max(away)) or PRIOR_WIDTH_NEGLIGIBLE * unknown.negligible
            width.append(PRIOR_WIDTH * reach)
            finest.append(PRIOR_WIDTH * reach if far else min(FINEST * unknown.negligible, PRIOR_WIDTH * reach))
            low.append(unknown.bounds[0])
            high.append(unknown.bounds[1])
    return Prior(np.array(centre), np.array(width), np.array(low), np.array(high), np.array(finest))


def whitening_of(rows: StageRows, k: int, disturbance: Disturbance, extra: Array) -> Filter:
    """The filter of series ``k``; ``extra`` as in :func:`filter_of`."""
    s = rows.series[k]
    span, integrates = rows.spans[s.signal], rows.problem.kind.integrates
    return filter_of(disturbance, s.step, s.activity, s.present, s.restart, extra, span, integrates)


class StageLikelihood:
    """Marginal likelihoods of models of one stage under shared variances.

    Args:
        extra: of each series, as in :func:`filter_of`.
        clusters: of each block, (blocks,): errors within one are dependent for the covariance of the unknowns; the block itself
            by default.
        predicts: whether predictive densities of blocks are computed.
        converged: relative gain in cost below which a fit ends; at least :data:`CONVERGED`.
    """

    def __init__(
        self,
        rows: StageRows,
        discrepancy: Discrepancy,
        variances: Variances,
        extra: Sequence[Array],
        clusters: npt.NDArray[np.int64] | None = None,
        predicts: bool = True,
        converged: float = 0.0,
    ) -> None:
        self.predicts, self.converged = predicts, converged
        self.rows, self.discrepancy, self.variances, self.extra = rows, discrepancy, variances, extra
        self.clusters = np.arange(rows.blocks) if clusters is None else clusters

    @cached_property
    def filters(self) -> tuple[Filter, ...]:
        """The filter of each series."""
        rows, disturbances = self.rows, self.variances.disturbances
        return tuple(whitening_of(rows, k, disturbances[s.signal], self.extra[k]) for k, s in enumerate(rows.series))

    @cached_property
    def log_scale(self) -> float:
        return float(sum(f.log_scale for f in self.filters))

    @cached_property
    def linear(self) -> Linear:
        """Principal directions of timing and discrepancy, computed without a table of all whitened columns."""
        rows, discrepancy = self.rows, self.discrepancy
        scale = self.variances.groups[discrepancy.group]
        active = (scale > 0.0) & (rows.in_floors(discrepancy.columns) * scale < DIVERGED)

        def part(s: Series) -> Array:
            return np.column_stack([discrepancy.timing[s.rows], discrepancy.columns[s.rows][:, active] * scale[active]])

        gram = np.zeros((1 + int(active.sum()),) * 2)
        for k, s in enumerate(rows.series):
            whitened = self.whitened_series(k, part(s))
            gram += whitened.T @ whitened
        values, vectors = np.linalg.eigh(gram)
        there = values > NEGLIGIBLE
        kept = vectors[:, there]
        columns = np.empty((rows.count, int(there.sum())))
        for k, s in enumerate(rows.series):
            columns[s.rows] = self.whitened_series(k, part(s) @ kept)
        weights = np.zeros((len(scale), kept.shape[1]))
        weights[active] = scale[active, None] * kept[1:]
        return Linear(columns, np.diag(values[there]), weights)

    def share(self, effects: Array) -> Array:
        """:func:`share_of` of the linear part, (k, p): its part by the discrepancy on ``effects`` (rows, k) in noise floors."""
        return share_of(effects, self.rows.products_in_floors(effects, self.discrepancy.columns) @ self.linear.weights)

    @cached_property
    def _linear_products(self) -> Array:
        """Products of the linear part in each block, (blocks, p, p)."""
        return products_by_block(self.linear.columns, self.linear.columns, self.rows.block, self.rows.blocks)

    def products_beside(self, slopes: Array, residual: Array) -> BlockProducts:
        """Of the linear part and ``slopes`` (rows, k) side by side with a ``residual`` (rows,), all whitened."""
        rows, p, k = self.rows, self.linear.columns.shape[1], slopes.shape[1]
        own = np.column_stack([slopes, residual])
        across = products_by_block(self.linear.columns, own, rows.block, rows.blocks)
        within = products_by_block(own, own, rows.block, rows.blocks)
        gram = np.empty((rows.blocks, p + k, p + k))
        gram[:, :p, :p], gram[:, :p, p:], gram[:, p:, p:] = self._linear_products, across[:, :, :k], within[:, :k, :k]
        gram[:, p:, :p] = np.swapaxes(across[:, :, :k], 1, 2)
        return BlockProducts(gram, np.hstack([across[:, :, k], within[:, :k, k]]), within[:, k, k])

    def whitened_series(self, k: int, columns: Array) -> Array:
        """Weighted innovations of columns (n, m) of series ``k``."""
        out = np.empty(columns.shape)
        self.filters[k].whiten(np.ascontiguousarray(columns), out)
        out *= self.variances.weights[self.rows.series[k].rows, None]
        return out

    def whitened(self, columns: Array) -> Array:
        """Innovations of columns (rows, m), weighted."""
        out = np.empty(columns.shape)
        for k, s in enumerate(self.rows.series):
            out[s.rows] = self.whitened_series(k, columns[s.rows])
        return out

    def residuals(self, thetas: Array) -> Array:
        """Residuals of parameter vectors, (rows, lanes)."""
        return np.ascontiguousarray(self.rows.residuals(thetas).T)

    def innovations(self, thetas: Array) -> Array:
        """Whitened residuals of parameter vectors, (rows, lanes)."""
        return self.whitened(self.residuals(thetas))

    def innovation_parts(self, thetas: Array) -> Iterator[tuple[slice, Array]]:
        """:meth:`innovations` recording by recording: its rows, and the innovations there, (n, lanes)."""
        signals = len(self.rows.problem.signals)
        for r, (here, part) in enumerate(self.rows.residual_parts(thetas)):
            out = np.empty((part.shape[1], len(thetas)))
            for k in range(r * signals, (r + 1) * signals):
                rows = self.rows.series[k].rows
                own = slice(rows.start - here.start, rows.stop - here.start)
                out[own] = self.whitened_series(k, part[:, own].T)
            yield here, out

    def costs(self, thetas: Array, linear: Orthogonal) -> Array:
        """Half the squared length of the innovations of parameter vectors beside the linear part, (lanes,)."""
        squares, products = np.zeros(len(thetas)), np.zeros((linear.whole.shape[1], len(thetas)))
        for here, part in self.innovation_parts(thetas):
            squares += (part**2).sum(axis=0)
            products += linear.products(part, here)
        z = linear.solved(products)
        return np.asarray(0.5 * (squares - (z**2).sum(axis=0)))


def _factor(gram: Array) -> Array:
    """Lower Cholesky factor of products in unit prior."""
    return np.asarray(factored(gram + np.eye(len(gram))))


# -- fitting -------------------------------------------------------------------------------------------------------------

#: Gauss–Newton steps at most, and the gain [nats] below which a fit has converged.
ROUNDS, CONVERGED = 15, 0.05
#: Steps from each start value that is tried.
FIRST_ROUNDS = 2
#: Damping factors; those after the first are tested where a step gains less than this share of the expected gain.
DAMPING, MIN_GAIN_RATIO = (0.0, 1e-2, 0.3, 10.0), 0.5
#: A parameter is flat if its negligible change moves the innovations by less than this (norm).
FLAT = 1e-3
#: Least change of the innovations (norm) over which the slope of a stepwise unknown is taken.
MIN_CHANGE = 2.0
#: Half-widths of the grid around a flat or stepwise parameter, in its negligible change.
GRID = (20.0, 7.5, 2.5, 1.0, 0.4)


def steps_of(unknowns: Sequence[Unknown], values: Array) -> Array:
    """Steps of finite differences, pointing into the bounds."""
    step = np.array([(0.5 if u.stepwise else 0.05) * u.negligible for u in unknowns])
    smooth = np.array([not u.stepwise for u in unknowns], dtype=bool)
    step[smooth] = np.minimum(step, np.maximum(0.05 * np.abs(values), 0.01 * step))[smooth]
    high = np.array([u.bounds[1] for u in unknowns])
    return np.where(values + step > high, -step, step)


def residual_and_slopes(rows: StageRows, unknowns: Sequence[Unknown], values: Array, unit: Array) -> Array:
    """Residual at ``values`` (k,), and its change per ``unit`` (k,) of each unknown, (rows, 1 + k)."""
    steps = steps_of(unknowns, values)
    table = rows.residuals(place(rows.theta, unknowns, np.vstack([values[None], values + np.diag(steps)]))).T
    table[:, 1:] = (table[:, 1:] - table[:, :1]) / steps * unit
    return table


def fit_model(
    likelihood: StageLikelihood, candidates: Sequence[Candidate], starts: Array, rounds: int = ROUNDS, tried: int = 1
) -> ModelFit:
    """Fit the unknowns of ``candidates`` from the best of ``starts`` (s, k), the ``tried`` best compared after a few steps."""
    candidates = tuple(candidates)
    descent = _Descent(likelihood, candidates)
    unknowns, prior, rows = descent.unknowns, descent.prior, likelihood.rows
    if not unknowns:
        return _finished(likelihood, candidates, unknowns, starts[0], rows.residuals(rows.theta[None]).T, prior)
    starts = np.clip(starts, prior.low, prior.high)
    if len(starts) > 1:
        starts = starts[np.argsort(descent.costs(starts, likelihood.linear.alone), kind="stable")[:tried]]
    if len(starts) > 1:
        ends = np.array([descent.run(start, FIRST_ROUNDS)[0] for start in starts])
        starts = ends[[int(np.argmin(descent.costs(ends, likelihood.linear.alone)))]]
    x, raw = descent.run(starts[0], rounds)
    table = raw.copy()
    table[:, 1:] /= prior.width
    for k in np.flatnonzero(descent.stepwise):
        table[:, 1 + k] = _secant(likelihood, unknowns, x, table, int(k), prior)
    return _finished(likelihood, candidates, unknowns, x, table, prior)


class _Descent:
    """Damped Gauss–Newton steps for the unknowns of ``candidates``, on a grid where the output is not differentiable."""

    def __init__(self, likelihood: StageLikelihood, candidates: Sequence[Candidate]) -> None:
        self.likelihood, self.prior = likelihood, prior_of(candidates)
        self.unknowns = tuple(u for c in candidates for u in c.unknowns)
        self.stepwise = np.array([u.stepwise for u in self.unknowns], dtype=bool)
        self._negligible = np.array([u.negligible for u in self.unknowns])

    def costs(self, lanes: Array, linear: Orthogonal) -> Array:
        """Of values (lanes, k)."""
        away = 0.5 * (((lanes - self.prior.centre) / self.prior.width) ** 2).sum(axis=1)
        thetas = place(self.likelihood.rows.theta, self.unknowns, lanes)
        return np.asarray(self.likelihood.costs(thetas, linear) + away)

    def run(self, x: Array, rounds: int) -> tuple[Array, Array]:
        """Values after at most so many steps from ``x`` (k,), and the residual there with its slopes, (rows, 1 + k)."""
        raw = self._changes(x)
        for first in (k == 0 for k in range(rounds)):
            better = self._better(x, raw, first)
            if better is None:
                break
            x, raw = better, self._changes(better)
        return x, raw

    def _changes(self, x: Array) -> Array:
        return np.ascontiguousarray(residual_and_slopes(self.likelihood.rows, self.unknowns, x, self.prior.width))

    def _better(self, x: Array, raw: Array, first: bool) -> Array | None:
        """Values of less cost than ``x``, None where none are found."""
        prior, likelihood = self.prior, self.likelihood
        table = likelihood.whitened(raw)
        w, slopes = table[:, 0], table[:, 1:]
        linear = likelihood.linear.beside(slopes, likelihood.share(likelihood.rows.scaled(raw[:, 1:])))
        z = linear.projected(np.column_stack([slopes, w]))
        away = (x - prior.centre) / prior.width
        cost = 0.5 * float(w @ w - z[:, -1] @ z[:, -1] + away @ away)
        hessian = slopes.T @ slopes - z[:, :-1].T @ z[:, :-1] + np.eye(len(x))
        gradient = slopes.T @ w - z[:, :-1].T @ z[:, -1] + away
        flat = np.linalg.norm(slopes, axis=0) * self._negligible < FLAT * prior.width
        coarse = np.flatnonzero(self.stepwise | flat)
        nearest = _stepped(x, hessian, gradient, DAMPING[0], prior)
        away = (x - nearest) / prior.width
        promised = float(gradient @ away - 0.5 * away @ hessian @ away)
        least = max(CONVERGED, likelihood.converged * cost)
        lanes, tried = [x], [cost]

        def attempt(trials: Sequence[Array]) -> float:
            """Gain of the best values so far, ``trials`` included."""
            lanes.extend(trials)
            tried.extend(self.costs(np.array(trials), linear))
            return tried[0] - min(tried)

        gained = 0.0
        if promised > least:
            gained = attempt([nearest])
            if gained < MIN_GAIN_RATIO * promised:
                gained = attempt([_stepped(x, hessian, gradient, damping, prior) for damping in DAMPING[1:]])
        if len(coarse) and (first or gained <= least):
            gained = attempt([moved for k in coarse for moved in _grid(x, int(k), self.unknowns[k], prior)])
        return lanes[int(np.argmin(tried))] if gained > least else None


def _grid(x: Array, k: int, unknown: Unknown, prior: Prior) -> list[Array]:
    """Values with one unknown moved to both sides."""
    reach = np.array(GRID) * unknown.negligible
    found = []
    for offset in (*-reach, *reach):
        moved = x.copy()
        moved[k] += offset
        found.append(np.clip(moved, prior.low, prior.high))
    return found


def _secant(likelihood: StageLikelihood, unknowns: Sequence[Unknown], x: Array, table: Array, k: int, prior: Prior) -> Array:
    """Slope of a stepwise unknown over the shortest distance with a significant change, (rows,)."""
    unknown = unknowns[k]
    reach = np.sort(np.array(GRID)) * unknown.negligible
    reach = np.append(reach, np.abs(x[k] - unknown.nominal) * np.array([0.25, 0.5, 1.0]))
    lanes = np.repeat(x[None], 2 * len(reach), axis=0)
    lanes[:, k] = np.clip(x[k] + np.concatenate([-reach, reach]), prior.low[k], prior.high[k])
    away = lanes[:, k] - x[k]
    changes = likelihood.residuals(place(likelihood.rows.theta, unknowns, lanes)) - table[:, :1]
    seen = np.linalg.norm(likelihood.whitened(changes), axis=0)
    order = np.argsort(np.abs(away))
    significant = [j for j in order if seen[j] > MIN_CHANGE and away[j] != 0.0]
    if not significant:
        return table[:, 1 + k]
    return np.asarray(changes[:, significant[0]] / away[significant[0]])


def _stepped(x: Array, hessian: Array, gradient: Array, damping: float, prior: Prior) -> Array:
    """A damped Gauss–Newton step: to the least value of the quadratic within the bounds."""
    size = np.sqrt(np.diag(hessian))
    unit = prior.width / size
    factor = np.linalg.cholesky(hessian / np.outer(size, size) + (damping + ROUNDING) * np.eye(len(x)))
    aim = -solve_triangular(factor, gradient / size, lower=True)
    step = solve_triangular(factor, aim, lower=True, trans="T")
    low, high = (prior.low - x) / unit, (prior.high - x) / unit
    if ((step < low) | (step > high)).any():
        step = lsq_linear(factor.T, aim, (low, high), method="bvls").x
    return np.clip(x + unit * step, prior.low, prior.high)


def _finished(
    likelihood: StageLikelihood,
    candidates: tuple[Candidate, ...],
    unknowns: tuple[Unknown, ...],
    values: Array,
    table: Array,
    prior: Prior,
) -> ModelFit:
    """Evidence, covariance and predictive density at the optimum; ``table`` (rows, 1 + k): residual and its slopes."""
    rows, k = likelihood.rows, len(unknowns)
    size = rows.in_floors(table)
    whitened = likelihood.whitened(np.ascontiguousarray(table))
    w, slopes = whitened[:, 0], whitened[:, 1:]
    share = likelihood.share(rows.scaled(table[:, 1:]) * prior.width)
    confounded = np.zeros(k)
    if k and not rows.problem.kind.integrates:
        confounded = np.linalg.norm(share, axis=1) * prior.width
    basis = likelihood.products_beside(slopes, w)
    p = len(share.T)

    def at_values(widths: Array) -> tuple[BlockProducts, Array, Array]:
        """Products beside effects in units of ``widths``, the coefficients of ``values``, and the pull on these."""
        weights = np.eye(p + k)
        weights[p:, :p] = -prior.width[:, None] * share
        weights[p:, p:] = -np.diag(widths)  # the residual falls where a parameter explains it
        products, here = basis.combined(weights), np.concatenate([np.zeros(p), (values - prior.centre) / widths])
        return products, here, products.right.sum(axis=0) - here

    covariance = np.zeros((0, 0))
    if k:
        products, _, pull = at_values(prior.width)
        covariance = posterior_covariance(products.over(likelihood.clusters), k, pull)
        covariance = covariance * np.outer(prior.width, prior.width)
    widths, cost = prior.at_scale(values)
    products, here, pull = at_values(widths)
    H = products.information
    change: Array = np.linalg.solve(H, pull).astype(np.float64)
    m = here + change
    squares = float(products.remaining_squares(change).sum())
    evidence = -0.5 * (squares + float(m @ m)) - 0.5 * float(np.linalg.slogdet(H)[1]) - likelihood.log_scale - cost
    predictive = predictive_densities(products, pull, H) if likelihood.predicts else np.zeros(rows.blocks)
    theta = place(rows.theta, unknowns, values[None])[0] if k else rows.theta
    rms = float(np.sqrt(max(squares, 0.0) / max(rows.measured_rows, 1)))
    return ModelFit(
        candidates, unknowns, values, theta, covariance, confounded, evidence, predictive, rms, size[1:], rows.left(table[:, 0])
    )
