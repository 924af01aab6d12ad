"""Least squares over whole free runs: every perturbation is a lane, several starts; residuals are means over bins."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.stats import qmc

from sysid.gap.candidates import Candidate, Unknown
from sysid.gap.data import Data
from sysid.gap.problem import Problem

Array = npt.NDArray[np.float64]

#: Half-widths of the grids on which stepwise parameters are searched, in the negligible change of each.
GRID = (20.0, 7.5, 2.5, 1.0, 0.375, 0.125)
#: Grid points of one parameter, of each of two on the widest grid and on the others, of each of more than two.
ONE_POINTS, WIDE_POINTS, NARROW_POINTS, MANY_POINTS = 9, 9, 5, 3
#: Number of start values spread over the ranges of the unknowns, and of start values from which a fit descends.
STARTS, DESCENTS = 32, 2
#: Relative tolerances of an intermediate and of the final descent.
ROUGH, EXACT = 1e-3, 1e-7


@dataclass(frozen=True)
class Fit:
    """Best values of the unknowns of a set of candidates.

    Args:
        theta: the whole parameter vector with these values.
        values: (k,) in the order of ``unknowns``.
        log_likelihood: of the residuals of the fitted recordings (:meth:`Data.log_likelihood`).
    """

    candidates: tuple[Candidate, ...]
    unknowns: tuple[Unknown, ...]
    values: Array
    theta: Array
    log_likelihood: float = 0.0

    def values_of(self, candidate: Candidate) -> Array:
        """The part of ``values`` that belongs to one of the fitted candidates."""
        return self.values[self.rows_of(candidate)]

    def rows_of(self, candidate: Candidate) -> slice:
        """Which of ``unknowns`` belong to one of the fitted candidates."""
        at = 0
        for known in self.candidates:
            if known.label == candidate.label:
                return slice(at, at + len(known.unknowns))
            at += len(known.unknowns)
        raise KeyError(candidate.label)


def place(theta: Array, unknowns: Sequence[Unknown], lanes: Array) -> Array:
    """Copies of ``theta`` with the unknowns set: lanes (L, k) → (L, N)."""
    thetas = np.repeat(theta[None], len(lanes), axis=0)
    for k, unknown in enumerate(unknowns):
        for at in unknown.places:
            thetas[:, at] = lanes[:, k]
    return thetas


def fit_candidates(
    data: Data, theta: Array, candidates: Sequence[Candidate], starts: Sequence[Array], tolerance: float = EXACT
) -> Fit:
    """Fit all unknowns of ``candidates`` together, from each of ``starts``; the likeliest result is returned.

    Args:
        theta: vector of the plant under test.
        starts: rows of starting values, each (k,).
        tolerance: relative, of the squared error in the last descent.
    """
    unknowns = tuple(u for c in candidates for u in c.unknowns)
    if not unknowns:
        return Fit((), (), np.empty(0), theta, data.log_likelihood(theta))
    low, high = _bounds(unknowns)
    best: Fit | None = None
    for start in _promising(data, theta, unknowns, [np.clip(s, low, high) for s in starts]):
        fitted = _descend(data, theta, tuple(candidates), unknowns, start, low, high, tolerance)
        if best is None or fitted.log_likelihood > best.log_likelihood:
            best = fitted
    assert best is not None
    return best


def _bounds(unknowns: Sequence[Unknown]) -> tuple[Array, Array]:
    """Least and greatest values, (k,) each."""
    return np.array([u.bounds[0] for u in unknowns]), np.array([u.bounds[1] for u in unknowns])


def _promising(data: Data, theta: Array, unknowns: Sequence[Unknown], starts: list[Array]) -> list[Array]:
    """The best :data:`DESCENTS` starts, evaluated in one batch (distinct ones only).

    Where an effect is absent in all of them its slope may be zero; then the best start with all effects present is added.
    """
    unique: Array = np.unique(np.round(np.array(starts), 12), axis=0)
    if len(unique) <= DESCENTS:
        return list(unique)
    problem = data.problem.short or data.problem
    costs = np.mean(np.abs(data.errors(place(theta, unknowns, unique), problem)), axis=1)
    order = [int(k) for k in np.argsort(costs)]
    present = (unique != np.array([u.nominal for u in unknowns])).all(axis=1)
    chosen = order[:DESCENTS]
    if not present[chosen].any():
        chosen += [k for k in order if present[k]][:1]
    return [unique[k] for k in chosen]


def _descend(
    data: Data,
    theta: Array,
    candidates: tuple[Candidate, ...],
    unknowns: tuple[Unknown, ...],
    start: Array,
    low: Array,
    high: Array,
    tolerance: float,
) -> Fit:
    x = start
    if data.problem.short is not None:  # short runs lead to no local optimum
        x = _least_squares(data, theta, unknowns, x, low, high, data.problem.short, ROUGH)
    x = _least_squares(data, theta, unknowns, x, low, high, data.problem, ROUGH)
    if any(u.stepwise for u in unknowns):
        for reach in GRID:
            found = _search_grid(data, theta, unknowns, x, low, high, reach)
            if np.array_equal(found, x):  # the other parameters are at their optimum already
                continue
            x = _least_squares(data, theta, unknowns, found, low, high, data.problem, ROUGH)
    if tolerance < ROUGH:
        x = _least_squares(data, theta, unknowns, x, low, high, data.problem, tolerance)
    at = place(theta, unknowns, x[None])[0]
    return Fit(candidates, unknowns, x, at, data.log_likelihood(at))


def _least_squares(
    data: Data,
    theta: Array,
    unknowns: Sequence[Unknown],
    start: Array,
    low: Array,
    high: Array,
    problem: Problem,
    tolerance: float,
) -> Array:
    smooth = np.array([not u.stepwise for u in unknowns])
    x = np.clip(start, low + 1e-9 * (high - low), high - 1e-9 * (high - low))
    if not smooth.any():
        return x
    known: dict[bytes, Array] = {}  # residuals of the last point, where the solver requests the slopes next

    def whole(part: Array) -> Array:
        full = x.copy()
        full[smooth] = part
        return full

    def errors(part: Array) -> Array:
        if part.tobytes() not in known:
            known.clear()
            known[part.tobytes()] = data.errors(place(theta, unknowns, whole(part)[None]), problem)[0]
        return known[part.tobytes()].copy()  # the solver scales its argument in place

    def slopes(part: Array) -> Array:
        return jacobian(lambda thetas: data.errors(thetas, problem), theta, unknowns, whole(part), high, errors(part), smooth)

    scale = np.array([u.negligible for u in unknowns])[smooth]
    solution = least_squares(
        errors, x[smooth], slopes, (low[smooth], high[smooth]), x_scale=scale, ftol=tolerance, xtol=tolerance, max_nfev=40
    )
    return whole(solution.x)


def _search_grid(
    data: Data, theta: Array, unknowns: Sequence[Unknown], x: Array, low: Array, high: Array, reach: float
) -> Array:
    """Stepwise parameters, whose slopes are not informative, searched together on a grid around ``x``; the others stay."""
    searched = [k for k, u in enumerate(unknowns) if u.stepwise]
    pair = WIDE_POINTS if reach >= GRID[0] else NARROW_POINTS
    steps = np.linspace(-reach, reach, {1: ONE_POINTS, 2: pair}.get(len(searched), MANY_POINTS))
    lanes = np.repeat(x[None], len(steps) ** len(searched), axis=0)
    sizes = np.array([unknowns[k].negligible for k in searched])
    lanes[:, searched] += sizes * np.stack(np.meshgrid(*[steps] * len(searched)), axis=-1).reshape(-1, len(searched))
    lanes = np.clip(lanes, low, high)
    thetas = place(theta, unknowns, lanes)
    best: Array = lanes[int(np.argmin(np.sum(data.errors(thetas) ** 2, axis=1)))]
    return best


def jacobian(
    errors: Callable[[Array], Array],
    theta: Array,
    unknowns: Sequence[Unknown],
    x: Array,
    high: Array | None = None,
    known: Array | None = None,
    of: npt.NDArray[np.bool_] | None = None,
) -> Array:
    """Derivatives (n, k) of ``errors``, (lanes, N) → (lanes, n), at ``x``, all perturbations in one batch.

    Args:
        known: the errors at ``x`` (n,), if already computed.
        of: mask of the unknowns whose derivatives are requested; all by default.
    """
    step = np.array([(0.5 if u.stepwise else 0.05) * u.negligible for u in unknowns])
    smooth = np.array([not u.stepwise for u in unknowns])
    # The response to a parameter with a large negligible change may still be nonlinear within a fraction of its value.
    step[smooth] = np.minimum(step, np.maximum(0.05 * np.abs(x), 0.01 * step))[smooth]
    if high is not None:
        step = np.where(x + step > high, -step, step)
    asked = np.arange(len(x)) if of is None else np.flatnonzero(of)
    if known is None:
        known = errors(place(theta, unknowns, x[None]))[0]
    moved = errors(place(theta, unknowns, (x + np.diag(step))[asked]))
    return np.asarray(((moved - known) / step[asked, None]).T)


def spread_of(parts: Sequence[Array]) -> float:
    """Root mean square over recordings and signals, missing values left out."""
    joined = np.concatenate([part.ravel() for part in parts])
    joined = joined[~np.isnan(joined)]
    return float(np.sqrt(np.mean(joined**2))) if len(joined) else 0.0


def starting_values(candidates: Sequence[Candidate], parents: Sequence[Fit], seed: int) -> list[Array]:
    """Nominal values, starts of the candidates, a spread over their ranges; optima of ``parents`` with new effects."""
    if not candidates:
        return [np.empty(0)]
    nominal = np.array([u.nominal for c in candidates for u in c.unknowns])
    low = np.concatenate([_ends(c)[0] for c in candidates])
    high = np.concatenate([_ends(c)[1] for c in candidates])
    spread = low + (high - low) * qmc.Sobol(len(nominal), rng=np.random.default_rng(seed)).random(STARTS)
    rows = range(max(len(c.starts) for c in candidates))
    spread = np.vstack([spread, *(np.concatenate([c.starts[min(r, len(c.starts) - 1)] for c in candidates]) for r in rows)])
    starts = [nominal, *spread]
    for parent in parents:
        known = np.concatenate([_known(c, parent) for c in candidates])
        new = np.isnan(known)
        starts += [np.where(new, row, known) for row in (spread if new.any() else [nominal])]
        starts.append(np.where(new, nominal, known))
    return starts


def _ends(candidate: Candidate) -> tuple[Array, Array]:
    """Least and greatest of a candidate's start values and its nominal ones.

    A nominal value far from all start values means "absent": it is moved towards them, so that the spread covers their range.
    """
    table = np.array(candidate.starts)
    low, high = table.min(axis=0), table.max(axis=0)
    margin = np.maximum(high - low, np.abs(table).max(axis=0))
    nominal = np.clip([u.nominal for u in candidate.unknowns], low - margin, high + margin)
    return np.minimum(low, nominal), np.maximum(high, nominal)


def _known(candidate: Candidate, parent: Fit) -> Array:
    """Values of a candidate at a parent's optimum (in another form of the same effect too); NaN where it is new."""
    for other in parent.candidates:
        if other is candidate:
            return parent.values_of(other)
        if other.key == candidate.key:
            slots = {at: v for u, v in zip(other.unknowns, parent.values_of(other), strict=True) for at in u.places}
            return np.array([slots.get(u.places[0], u.nominal) for u in candidate.unknowns])
    return np.full(len(candidate.unknowns), np.nan)
