"""Noise, disturbance and discrepancy of a stage by maximum evidence beside a given model (type II likelihood).

The evidence is maximised alternately over the disturbances (the whitening changes) and over the variances of the groups (from
the Gram matrix of the whitened columns).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from sysid.gap.likelihood.adjoint import gradient_of
from sysid.gap.likelihood.block_products import factored
from sysid.gap.likelihood.discrepancy import Discrepancy
from sysid.gap.likelihood.disturbance import Disturbance, Filter
from sysid.gap.likelihood.rows import Series, StageRows
from sysid.gap.likelihood.stage import (
    HUBER,
    ModelFit,
    StageLikelihood,
    Variances,
    fit_model,
    residual_and_slopes,
    whitening_of,
)
from sysid.plant.model import in_parallel

Array = npt.NDArray[np.float64]

#: Prior of log τ: unknown over some decades.
TAU, TAU_SPREAD = 1e-3, 4.0
#: Prior spreads of the logarithms of noise, disturbance and its correlation time; the latter around MEMORY [s]. The same for
#: the error of the output itself, around the noise and around RIPPLE_MEMORY [s].
NOISE_SPREAD, DISTURBANCE_SPREAD, MEMORY, MEMORY_SPREAD, RIPPLE_MEMORY = 0.5, 3.0, 0.5, 1.0, 0.1
SPREAD = np.array([NOISE_SPREAD, DISTURBANCE_SPREAD, DISTURBANCE_SPREAD, MEMORY_SPREAD, DISTURBANCE_SPREAD, MEMORY_SPREAD])
#: Largest distance of the logarithms from their centres.
MAX_DISTANCE = np.array([2.0, 12.0, 12.0, 3.2, 12.0, 3.2])
#: Least and greatest τ of a group: absent, and a tenth of what a stage does.
ABSENT, LARGEST = 1e-6, 0.1
#: Least limit of the discrepancy: it adds a tenth to the noise floor in quadrature [noise floors].
LEAST_LIMIT = 0.458
#: Rounds of the two maximisations.
ROUNDS = 2


@dataclass(frozen=True)
class Start:
    """Start of the estimation: noise of a row by signal from the data, and the size of a typical disturbance."""

    noise: Array
    disturbance: Array


def first_variances(rows: StageRows, start: Start, groups: int, tau: float) -> Variances:
    """Start values: noise of the data, a small disturbance, every group with coefficients of ``tau``."""
    disturbances = tuple(
        Disturbance(float(n), float(0.1 * d), float(d), MEMORY, float(n), RIPPLE_MEMORY)
        for n, d in zip(start.noise, start.disturbance, strict=True)
    )
    return Variances(disturbances, np.full(groups, tau), np.ones(rows.count))


def estimated(
    rows: StageRows, discrepancy: Discrepancy, variances: Variances, start: Start, extra: Sequence[Array], model: ModelFit
) -> Variances:
    """Variances of maximum evidence beside ``model``."""
    residual, slopes = _linearised(rows, model)
    columns = _Columns(discrepancy, slopes, residual)
    fixed = 1 + slopes.shape[1]
    systematic = float(np.sqrt(max(model.left**2 - 1.0, LEAST_LIMIT**2)))
    variances = replace(variances, left=np.inf if rows.problem.kind.integrates else systematic)
    largest = _largest(rows, discrepancy, variances.left)
    for _ in range(ROUNDS):
        variances = _disturbances(rows, columns, fixed, discrepancy, variances, start, extra)
        gram, _ = _gram(rows, columns, variances, extra)
        variances = replace(variances, groups=group_deviations(gram, fixed, discrepancy.group, variances.groups, largest))
    return variances


@dataclass(frozen=True)
class _Columns:
    """Timing, slopes of a model's unknowns (rows, k), discrepancy and residual (rows,), side by side for each series.

    ``kept``: indices of the columns of the discrepancy; all by default.
    """

    discrepancy: Discrepancy
    slopes: Array
    residual: Array
    kept: npt.NDArray[np.int64] | None = None

    @property
    def count(self) -> int:
        kept = self.discrepancy.columns.shape[1] if self.kept is None else len(self.kept)
        return 2 + int(self.slopes.shape[1]) + int(kept)

    def of(self, s: Series) -> Array:
        """(n, count)."""
        found = self.discrepancy.columns[s.rows]
        found = found if self.kept is None else found[:, self.kept]
        return np.column_stack([self.discrepancy.timing[s.rows], self.slopes[s.rows], found, self.residual[s.rows]])


def own_evidence(likelihood: StageLikelihood, start: Start, model: ModelFit) -> float:
    """Log evidence of a model with the discrepancy estimated beside it alone, noise and disturbance held; with the prior of τ.

    Shared variances favour the model with which they were estimated; this removes the advantage.
    """
    rows, discrepancy, variances, extra = likelihood.rows, likelihood.discrepancy, likelihood.variances, likelihood.extra
    residual, slopes = _linearised(rows, model)
    gram, _ = _gram(rows, _Columns(discrepancy, slopes, residual), variances, extra)
    largest = _largest(rows, discrepancy, variances.left)
    own = replace(variances, groups=group_deviations(gram, 1 + slopes.shape[1], discrepancy.group, variances.groups, largest))
    again = fit_model(StageLikelihood(rows, discrepancy, own, extra), model.candidates, model.values[None], rounds=0)
    return again.evidence + log_prior(own, start)


def _linearised(rows: StageRows, model: ModelFit) -> tuple[Array, Array]:
    """Residual of a model (rows,) and its slopes by the unknowns, in units of their size (rows, k)."""
    sizes = np.array([max(u.negligible, abs(v)) for u, v in zip(model.unknowns, model.values, strict=True)])
    table = residual_and_slopes(rows, model.unknowns, model.values, sizes)
    return table[:, 0], table[:, 1:]


def _gram(
    rows: StageRows, columns: _Columns, variances: Variances, extra: Sequence[Array], signals: Sequence[int] | None = None
) -> tuple[Array, float]:
    """Products of all whitened columns of some signals (of all), and the log scale of their innovations."""
    total, scale = np.zeros((columns.count, columns.count)), 0.0
    for k, s in enumerate(rows.series):
        if signals is not None and s.signal not in signals:
            continue
        whitener = whitening_of(rows, k, variances.disturbances[s.signal], extra[k])
        out = np.empty((len(s.step), columns.count))
        whitener.whiten(columns.of(s), out)
        out *= variances.weights[s.rows, None]
        total += out.T @ out
        scale += whitener.log_scale
    return total, scale


def evidence_and_slope(gram: Array, scale: Array) -> tuple[float, Array]:
    """Log evidence up to the log scale, and the factor of whitened columns (n, m + 1) for the slope of its negative.

    ``scale``: prior standard deviations of all columns but the last, (m,).

    With X the columns in unit prior, H = XᵀX + 1 and e = r − X·m, m = H⁻¹·Xᵀr: the negative is e·r/2 + log|H|/2, and its
    derivatives are e with respect to r and X·H⁻¹ − e·mᵀ with respect to X, linear in the columns.
    """
    H = gram[:-1, :-1] * np.outer(scale, scale) + np.eye(len(scale))
    factor = factored(H, partial(cho_factor, lower=True))
    g = gram[:-1, -1] * scale
    m = cho_solve(factor, g)
    value = float(-0.5 * (gram[-1, -1] - g @ m) - np.log(np.diag(factor[0])).sum())
    residual = np.append(-scale * m, 1.0)
    by_column = np.outer(residual, residual)
    by_column[:-1, :-1] += cho_solve(factor, np.eye(len(scale))) * np.outer(scale, scale)
    return value, by_column


def _scales(fixed: int, group: npt.NDArray[np.int64], taus: Array) -> Array:
    return np.concatenate([[1.0], np.full(fixed - 1, 3.0), taus[group]])


def _disturbances(
    rows: StageRows,
    columns: _Columns,
    fixed: int,
    discrepancy: Discrepancy,
    variances: Variances,
    start: Start,
    extra: Sequence[Array],
) -> Variances:
    """Noise, amplitude and correlation time of every signal, the groups held."""
    signals = len(variances.disturbances)
    scale = _scales(fixed, discrepancy.group, variances.groups)
    present = scale > 10.0 * ABSENT
    table, scale = replace(columns, kept=np.flatnonzero(present[fixed:])), scale[present]
    first = _table(variances)
    centre = _centre(start)
    width = first.shape[1]

    def variances_of(z: Array) -> Variances:
        found = np.exp(z.reshape(signals, width))
        return replace(variances, disturbances=tuple(Disturbance(*map(float, row)) for row in found))

    z = np.log(first)
    for k in range(signals):  # each signal of a stage has its own filters
        rest = _gram(rows, table, variances_of(z), extra, [j for j in range(signals) if j != k])[0]
        one = _Signal(rows, k, table, scale, rest, variances.weights, extra, np.log(centre[k]))
        low, high = np.log(centre[k]) - MAX_DISTANCE, np.log(centre[k]) + MAX_DISTANCE
        bounds = [(float(a), float(b)) for a, b in zip(low, high, strict=True)]
        # Disturbances at rest and in motion are separate local optima: descend from the two best start values.
        begins = sorted((np.clip(row, low, high) for row in _beginnings(z[k])), key=one.cost)[:2]
        found = _descents(one, begins, bounds)
        z[k] = min(found)[1]
    return variances_of(z)


def _descents(one: _Signal, begins: Sequence[Array], bounds: list[tuple[float, float]]) -> list[tuple[float, list[float]]]:
    """Least cost from each start value, and where it is; side by side."""
    found: list[tuple[float, list[float]]] = [(np.inf, [])] * len(begins)

    def descend(k: int) -> None:
        best = minimize(
            one.cost_and_slope, begins[k], jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 12, "ftol": 1e-7}
        )
        found[k] = float(best.fun), best.x.tolist()

    in_parallel(descend, len(begins), one.columns.count * sum(len(one.rows.series[k].step) for k in one.series))
    return found


@dataclass(frozen=True)
class _Signal:
    """Negative log evidence as a function of the logarithms of one signal's disturbance, (6,).

    Args:
        columns: made for each series when it is whitened; together they would be a table of all rows.
        rest: products of the columns whitened for the other signals.
        centre: of the prior, (6,).
    """

    rows: StageRows
    signal: int
    columns: _Columns
    scale: Array
    rest: Array
    weights: Array
    extra: Sequence[Array]
    centre: Array

    @property
    def series(self) -> list[int]:
        """Indices of the series of the signal."""
        return [k for k, s in enumerate(self.rows.series) if s.signal == self.signal]

    def cost(self, z: Array) -> float:
        return self._cost(z, self._filters_at(z))[0]

    def cost_and_slope(self, z: Array) -> tuple[float, Array]:
        filters = self._filters_at(z)
        cost, by_column = self._cost(z, filters)
        slope = (z - self.centre) / SPREAD**2
        for k in filters:  # whitened again: kept, they would be a table of all rows
            columns = self.columns.of(self.rows.series[k])
            by_innovation = (self._whitened(k, columns, filters[k]) @ by_column) * self._weights(k)
            slope += gradient_of(columns, by_innovation, filters[k], self._filters(k), z)
        return cost, slope

    def _cost(self, z: Array, filters: Mapping[int, Filter]) -> tuple[float, Array]:
        """The cost, and the matrix that maps whitened columns to its derivatives by them."""
        gram, log_scale = self.rest.copy(), 0.0
        for k, whitener in filters.items():
            out = self._whitened(k, self.columns.of(self.rows.series[k]), whitener)
            gram += out.T @ out
            log_scale += whitener.log_scale
        value, by_column = evidence_and_slope(gram, self.scale)
        prior = 0.5 * (((z - self.centre) / SPREAD) ** 2).sum()
        return float(log_scale - value + prior), by_column

    def _whitened(self, k: int, columns: Array, whitener: Filter) -> Array:
        """The weighted innovations of the columns (n, m) of a series."""
        out = np.empty(columns.shape)
        whitener.whiten(columns, out)
        out *= self._weights(k)
        return out

    def _weights(self, k: int) -> Array:
        return self.weights[self.rows.series[k].rows, None]

    def _filters_at(self, z: Array) -> dict[int, Filter]:
        return {k: self._filters(k)(z) for k in self.series}

    def _filters(self, k: int) -> Callable[[Array], Filter]:
        return lambda z: whitening_of(self.rows, k, Disturbance(*map(float, np.exp(z))), self.extra[k])


def _beginnings(z: Array) -> list[Array]:
    """Start values: the given logarithms, one of them ten times larger, amplitudes at rest and in motion interchanged."""
    swapped, more = z[[0, 2, 1, 3, 4, 5]], np.log(10.0) * np.eye(len(z))
    return [z, swapped, z + more[1], z + more[2], z + more[4], z + more[4] - more[2], swapped + more[1]]


def _largest(rows: StageRows, discrepancy: Discrepancy, left: float) -> Array:
    """Largest standard deviation of each group, (g,): its columns together change the output by ``left`` [noise floors]."""
    squares = np.bincount(discrepancy.group, rows.in_floors(discrepancy.columns) ** 2, minlength=len(discrepancy.groups))
    return np.clip(left / np.sqrt(np.maximum(squares, 1e-300)), 10.0 * ABSENT, LARGEST)


def group_deviations(gram: Array, fixed: int, group: npt.NDArray[np.int64], taus: Array, largest: Array) -> Array:
    """Standard deviations of the groups, with the exact gradient of the evidence; at most ``largest``."""
    count = len(taus)

    def negative(z: Array) -> tuple[float, Array]:
        scale = _scales(fixed, group, np.exp(z))
        H = gram[:-1, :-1] * np.outer(scale, scale) + np.eye(len(scale))
        factor = factored(H, partial(cho_factor, lower=True))
        g = gram[:-1, -1] * scale
        m = cho_solve(factor, g)
        value = 0.5 * (gram[-1, -1] - g @ m) + np.log(np.diag(factor[0])).sum()
        # d/d log τ of a column: its share of the model less the squared coefficient (MacKay 1992).
        inverse = cho_solve(factor, np.eye(len(scale)))
        by_column = 1.0 - np.diag(inverse) - m * m
        slope = np.bincount(group, by_column[fixed:], minlength=count)
        away = (z - np.log(TAU)) / TAU_SPREAD
        return float(value + 0.5 * away @ away), slope + away / TAU_SPREAD

    bounds = [(np.log(ABSENT), high) for high in np.log(largest)]
    begin = np.clip(np.log(np.maximum(taus, 1e-5)), np.log(ABSENT), np.log(largest))
    best = min(
        (minimize(negative, z, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 60})
         for z in (begin, np.minimum(np.log(TAU), np.log(largest)))), key=lambda found: found.fun)  # fmt: skip
    return np.asarray(np.exp(best.x))


def log_prior(variances: Variances, start: Start) -> float:
    """Log density of variances under their priors, up to a constant."""
    found = np.log(_table(variances))
    centre = _centre(start)
    groups = (np.log(np.maximum(variances.groups, ABSENT)) - np.log(TAU)) / TAU_SPREAD
    return float(-0.5 * (((found - np.log(centre)) / SPREAD) ** 2).sum() - 0.5 * groups @ groups)


def _centre(start: Start) -> Array:
    """Centres of the priors of a disturbance's parameters, (d, 6)."""
    memory, ripple = np.full(len(start.noise), MEMORY), np.full(len(start.noise), RIPPLE_MEMORY)
    return np.column_stack([start.noise, 0.1 * start.disturbance, start.disturbance, memory, start.noise, ripple])


def _table(variances: Variances) -> Array:
    """Parameters of each disturbance, (d, 6)."""
    return np.array([[d.noise, d.still, d.moving, d.memory, d.ripple, d.ripple_memory] for d in variances.disturbances])


def robust(likelihood: StageLikelihood, model: ModelFit) -> Variances:
    """The variances with weights that reduce the influence of outliers of ``model``."""
    return replace(likelihood.variances, weights=_weights(likelihood, model))


def _weights(likelihood: StageLikelihood, model: ModelFit) -> Array:
    """Square roots of Huber's weights from the innovations of ``model`` beside the linear part."""
    w = likelihood.innovations(model.theta[None])[:, 0]
    weights = likelihood.variances.weights
    linear = likelihood.linear.alone
    fitted = linear.whole @ np.linalg.solve(linear.factor.T, linear.projected(w[:, None]))[:, 0]
    left = np.abs(w - fitted) / np.maximum(weights, 1e-6)
    return np.asarray(np.sqrt(np.minimum(1.0, HUBER / np.maximum(left, 1e-12))))
