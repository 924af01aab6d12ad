"""Least squares over whole rollouts: every perturbation is a lane, the loss forgives outliers, several starts.

Residuals are binned and whitened by the drift model of their own fit, so that a wandering of the machine that nothing explains
neither pulls parameters nor counts as evidence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from sysid.gap.candidates import Candidate, Unknown
from sysid.gap.data import Data
from sysid.gap.drift import DriftStrength
from sysid.gap.problem import Problem

Array = npt.NDArray[np.float64]

#: Residuals are winsorised softly beyond this many robust standard deviations.
FORGIVE = 4.0
#: Half widths of the grids on which stepwise parameters are searched, in what is negligible of each.
GRID = (20.0, 7.5, 2.5, 1.0, 0.375, 0.125)
#: The same where they have been fitted and other recordings are met as well.
SETTLING = (7.5, 2.5, 1.0)
#: Values on such a grid: of one parameter, of each of two on the widest grid and on others, of each of more.
ALONE, WIDE, NARROW, MANY = 9, 9, 5, 3
#: Starts from which a fit descends.
DESCENTS = 2
#: Relative tolerances of a descent on its way, and where it ends.
ROUGH, EXACT = 1e-3, 1e-7


@dataclass(frozen=True)
class Fit:
    """Values of the unknowns of a set of candidates that fit best.

    Args:
        theta: the whole parameter vector with them in place.
        values: (k,) in the order of ``unknowns``.
        drifts: one for each signal of the problem.
        log_likelihood: of the whitened residuals of the recordings that were fitted.
    """

    candidates: tuple[Candidate, ...]
    unknowns: tuple[Unknown, ...]
    values: Array
    theta: Array
    drifts: tuple[DriftStrength, ...]
    log_likelihood: float
    converged: bool

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(c.label for c in self.candidates)

    def values_of(self, candidate: Candidate) -> Array:
        """The part of ``values`` that belongs to one of the fitted candidates."""
        return self.values[self.rows_of(candidate)]

    def rows_of(self, candidate: Candidate) -> slice:
        """Which of ``unknowns`` belong to one of the fitted candidates."""
        at = 0
        for known in self.candidates:
            if known is candidate:
                return slice(at, at + len(known.unknowns))
            at += len(known.unknowns)
        raise KeyError(candidate.label)

    def departure(self, candidate: Candidate) -> float:
        """How far its parameters moved from nominal, in what is negligible of each; of the one that moved furthest."""
        moved = zip(candidate.unknowns, self.values_of(candidate), strict=True)
        away = [(abs(float(value) - u.nominal), u.negligible) for u, value in moved]
        return max((far / least if least > 0.0 else math.inf for far, least in away if far > 0.0), default=0.0)

    def at_bound(self, candidate: Candidate) -> bool:
        """Whether any parameter of it ends at a bound that does not mean "absent"."""
        for value, unknown in zip(self.values_of(candidate), candidate.unknowns, strict=True):
            for bound in unknown.bounds:
                near = 1e-3 * min(unknown.bounds[1] - unknown.bounds[0], max(abs(bound), unknown.negligible))
                if abs(value - bound) <= near and abs(bound - unknown.absent) > near:
                    return True
        return False


def place(theta: Array, unknowns: Sequence[Unknown], lanes: Array) -> Array:
    """Copies of ``theta`` with the unknowns set: lanes (L, k) → (L, N)."""
    thetas = np.repeat(theta[None], len(lanes), axis=0)
    for k, unknown in enumerate(unknowns):
        for at in unknown.places:
            thetas[:, at] = lanes[:, k]
    return thetas


def fit_candidates(data: Data, theta: Array, candidates: Sequence[Candidate], starts: Sequence[Array]) -> Fit:
    """Fit all unknowns of ``candidates`` together, from each of ``starts``; the likeliest end wins.

    Args:
        theta: vector of the questioned plant.
        starts: rows of starting values, each (k,).
    """
    unknowns = tuple(u for c in candidates for u in c.unknowns)
    if not unknowns:
        drifts, log_likelihood = data.drifts(theta)
        return Fit((), (), np.empty(0), theta, drifts, log_likelihood, True)
    low, high = _bounds(unknowns)
    best: Fit | None = None
    for start in _promising(data, theta, unknowns, [np.clip(s, low, high) for s in starts]):
        fitted = _descend(data, theta, tuple(candidates), unknowns, start, low, high)
        if best is None or fitted.log_likelihood > best.log_likelihood:
            best = fitted
    assert best is not None
    return best


def at_common_thresholds(fit: Fit, parts: Sequence[Data]) -> Array:
    """``fit.theta`` with its stepwise parameters where they suit all of ``parts`` best, (N,).

    Recordings tell no more of a threshold than an interval, between the largest command at which the axis stood and the least
    at which it moved. Where a fit ends within it is chance, and one stroke elsewhere that falls between would be missed whole.
    """
    if not any(u.stepwise for u in fit.unknowns):
        return fit.theta
    low, high = _bounds(fit.unknowns)
    x = fit.values
    for reach in SETTLING:
        x = _search_grid(parts, fit.theta, fit.unknowns, x, low, high, reach)
    theta: Array = place(fit.theta, fit.unknowns, x[None])[0]
    return theta


def least_left(fit: Fit, data: Data) -> Fit:
    """The fit moved on to where it leaves least of ``data``, whatever wanders.

    Prediction errors tell best what the values are; that they are off by little adds up over a run to much that is left.
    """
    if not any(drift.present for drift in fit.drifts):
        return fit
    low, high = _bounds(fit.unknowns)
    scale = np.array([u.negligible for u in fit.unknowns])
    plain = (DriftStrength(),) * len(data.sigma)
    x, done = _least_squares(data, fit.theta, fit.unknowns, fit.values, low, high, scale, plain, data.problem, EXACT)
    return replace(fit, values=x, theta=place(fit.theta, fit.unknowns, x[None])[0], converged=done)


def _bounds(unknowns: Sequence[Unknown]) -> tuple[Array, Array]:
    """Least and greatest values, (k,) each."""
    return np.array([u.bounds[0] for u in unknowns]), np.array([u.bounds[1] for u in unknowns])


def _promising(data: Data, theta: Array, unknowns: Sequence[Unknown], starts: list[Array]) -> list[Array]:
    """The best :data:`DESCENTS` starts, evaluated in one batch (distinct ones only).

    Where something is absent in all of them, slopes may say nothing about it: then the best in which all is present as well.
    """
    unique: Array = np.unique(np.round(np.array(starts), 12), axis=0)
    if len(unique) <= DESCENTS:
        return list(unique)
    problem = data.problem.short or data.problem
    plain = (DriftStrength(),) * len(data.sigma)
    costs = np.mean(np.abs(data.whitened(place(theta, unknowns, unique), plain, problem)), axis=1)
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
) -> Fit:
    scale = np.array([u.negligible for u in unknowns])
    plain = (DriftStrength(),) * len(data.sigma)
    x = start
    done = False
    if data.problem.short is not None:  # a drift cannot trap a fit in short runs
        x, _ = _least_squares(data, theta, unknowns, x, low, high, scale, plain, data.problem.short, ROUGH)
    x, done = _least_squares(data, theta, unknowns, x, low, high, scale, plain, data.problem, ROUGH)
    if any(u.stepwise for u in unknowns):
        for reach in GRID:
            found = _search_grid((data,), theta, unknowns, x, low, high, reach)
            if np.array_equal(found, x):  # the others stand where they suit that best already
                continue
            x, done = _least_squares(data, theta, unknowns, found, low, high, scale, plain, data.problem, ROUGH)
    drifts, log_likelihood = data.drifts(place(theta, unknowns, x[None])[0])
    if not data.problem.integrates or not any(drift.present for drift in drifts):
        x, done = _least_squares(data, theta, unknowns, x, low, high, scale, plain, data.problem, EXACT)
        drifts, log_likelihood = data.drifts(place(theta, unknowns, x[None])[0])
    for _ in range(2):
        # Where nothing integrates, plain least squares is not misled by wandering, and is what published figures are.
        if not data.problem.integrates or not any(drift.present for drift in drifts):
            break
        moved, ended = _least_squares(data, theta, unknowns, x, low, high, scale, drifts, data.problem, EXACT)
        renewed, better = data.drifts(place(theta, unknowns, moved[None])[0])
        if better <= log_likelihood:
            break
        gained = better - log_likelihood
        x, done, drifts, log_likelihood = moved, ended, renewed, better
        if gained < 0.1:
            break
    return Fit(candidates, unknowns, x, place(theta, unknowns, x[None])[0], drifts, log_likelihood, done)


def _least_squares(
    data: Data,
    theta: Array,
    unknowns: Sequence[Unknown],
    start: Array,
    low: Array,
    high: Array,
    scale: Array,
    drifts: Sequence[DriftStrength],
    problem: Problem,
    tolerance: float,
) -> tuple[Array, bool]:
    smooth = np.array([not u.stepwise for u in unknowns])
    x = np.clip(start, low + 1e-9 * (high - low), high - 1e-9 * (high - low))
    if not smooth.any():
        return x, True
    known: dict[bytes, Array] = {}  # residuals of the last point: slopes are asked for where errors were

    def whole(part: Array) -> Array:
        full = x.copy()
        full[smooth] = part
        return full

    def errors(part: Array) -> Array:
        if part.tobytes() not in known:
            known.clear()
            known[part.tobytes()] = data.whitened(place(theta, unknowns, whole(part)[None]), drifts, problem)[0]
        return known[part.tobytes()].copy()  # the solver scales what it is given

    def slopes(part: Array) -> Array:
        return jacobian(data, theta, unknowns, whole(part), drifts, high, problem, errors(part), smooth)[1]

    solution = least_squares(
        errors, x[smooth], slopes, (low[smooth], high[smooth]), x_scale=scale[smooth], loss="soft_l1",
        f_scale=forgiveness(errors(x[smooth])), ftol=tolerance, xtol=tolerance, max_nfev=40,
    )  # fmt: skip
    return whole(solution.x), solution.status > 0


def _search_grid(
    parts: Sequence[Data], theta: Array, unknowns: Sequence[Unknown], x: Array, low: Array, high: Array, reach: float
) -> Array:
    """Parameters whose slopes say nothing, searched together around ``x`` on a grid; the others stay."""
    searched = [k for k, u in enumerate(unknowns) if u.stepwise]
    pair = WIDE if reach >= GRID[0] else NARROW
    steps = np.linspace(-reach, reach, {1: ALONE, 2: pair}.get(len(searched), MANY))
    lanes = np.repeat(x[None], len(steps) ** len(searched), axis=0)
    sizes = np.array([unknowns[k].negligible for k in searched])
    lanes[:, searched] += sizes * np.stack(np.meshgrid(*[steps] * len(searched)), axis=-1).reshape(-1, len(searched))
    lanes = np.clip(lanes, low, high)
    thetas = place(theta, unknowns, lanes)
    costs = [np.sum(np.abs(data.whitened(thetas, (DriftStrength(),) * len(data.sigma))), axis=1) for data in parts]
    best: Array = lanes[int(np.argmin(np.sum(costs, axis=0)))]
    return best


def jacobian(
    data: Data,
    theta: Array,
    unknowns: Sequence[Unknown],
    x: Array,
    drifts: Sequence[DriftStrength],
    high: Array | None = None,
    problem: Problem | None = None,
    known: Array | None = None,
    of: npt.NDArray[np.bool_] | None = None,
) -> tuple[Array, Array]:
    """Whitened residuals (n,) and their derivatives (n, k) at ``x``, all perturbations in one batch.

    Args:
        known: the residuals, where they were computed before.
        of: whether the derivative by each unknown is asked for; all of them otherwise.
    """
    step = np.array([(0.5 if u.stepwise else 0.05) * u.negligible for u in unknowns])
    smooth = np.array([not u.stepwise for u in unknowns])
    # What may vary widely before it is worth a name still bends within a small part of its value.
    step[smooth] = np.minimum(step, np.maximum(0.05 * np.abs(x), 0.01 * step))[smooth]
    if high is not None:
        step = np.where(x + step > high, -step, step)
    asked = np.arange(len(x)) if of is None else np.flatnonzero(of)
    lanes = (x + np.diag(step))[asked]
    if known is None:
        known = data.whitened(place(theta, unknowns, x[None]), drifts, problem)[0]
    moved = data.whitened(place(theta, unknowns, lanes), drifts, problem)
    return known, ((moved - known) / step[asked, None]).T


def forgiveness(r: Array) -> float:
    """Scale beyond which a residual counts as an outlier: a few robust standard deviations, at least of the noise."""
    used = r[r != 0.0]
    return FORGIVE * max(1.4826 * float(np.median(np.abs(used))) if len(used) else 1.0, 1.0)


def spread_of(parts: Sequence[Array]) -> float:
    """Root mean square of everything that is there, over recordings and signals."""
    joined = np.concatenate([part.ravel() for part in parts])
    joined = joined[~np.isnan(joined)]
    return float(np.sqrt(np.mean(joined**2))) if len(joined) else 0.0
