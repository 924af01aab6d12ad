"""The exact optimum by batches of values around the best so far, compared by the cost itself.

Descents by slopes end early where the cost has steps and kinks, as with thresholds and backlash. Every round evaluates the
Gauss–Newton step in several lengths and each stepwise parameter on a grid in one batch, and keeps the lowest cost.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import numpy.typing as npt

from sysid.gap.data import Data
from sysid.gap.fit import GRID, Fit, place
from sysid.gap.intervals.criterion import Criterion, criterion_at
from sysid.gap.intervals.curvature import Curvature, curvature_at

Array = npt.NDArray[np.float64]

#: Shares of a Gauss–Newton step that are evaluated.
SHARES = (0.1, 0.3, 0.6, 1.0, 1.6)
#: Rounds at most, and the gain [nats] below which the optimum is settled.
ROUNDS, SETTLED = 8, 0.02


def settled(data: Data, theta: Array, fit: Fit) -> Fit:
    """The fit at maximum likelihood; where the stage does not integrate, at the least (softly winsorised) squares.

    Args:
        theta: vector of the plant under test.
    """
    values = fit.values
    for _ in range(2):
        criterion = criterion_at(data, theta, fit.unknowns, values)
        moved = descended(criterion, values)
        if np.array_equal(moved, values):
            break
        values = moved
    at = place(theta, fit.unknowns, values[None])[0]
    drifts, log_likelihood = data.drifts(at)
    if data.models_drift and log_likelihood <= fit.log_likelihood:
        return fit
    return replace(fit, values=values, theta=at, drifts=drifts, log_likelihood=log_likelihood)


def descended(criterion: Criterion, values: Array) -> Array:
    """Local minimum of the cost near ``values`` (k,)."""
    best = values
    cost = float(criterion.costs(criterion.errors(best[None]))[0])
    stepwise = [k for k, u in enumerate(criterion.unknowns) if u.stepwise]
    for reach in GRID if stepwise else ():
        best, cost = _least(criterion, best, cost, _grid(criterion, best, stepwise, reach))
        curvature = curvature_at(criterion, best)
        best, cost = _least(criterion, best, cost, _steps(criterion, curvature, best))
    for _ in range(ROUNDS):
        before = cost
        curvature = curvature_at(criterion, best)
        best, cost = _least(criterion, best, cost, _steps(criterion, curvature, best))
        if before - cost < SETTLED:
            break
    return best


def _least(criterion: Criterion, best: Array, cost: float, lanes: Array) -> tuple[Array, float]:
    """The lane of lowest cost, or the best so far."""
    lanes = np.clip(lanes, criterion.low, criterion.high)
    costs = criterion.costs(criterion.errors(lanes))
    k = int(np.argmin(costs))
    return (lanes[k], float(costs[k])) if costs[k] < cost else (best, cost)


def _steps(criterion: Criterion, curvature: Curvature, values: Array) -> Array:
    """Shares of the Gauss–Newton step, and a standard error of each parameter to both sides with the others refitted."""
    weighted = criterion.weights(curvature.errors) * curvature.errors
    step = -curvature.inverse @ (curvature.slopes.T @ weighted)
    along = (curvature.inverse / curvature.deviations).T
    return np.vstack([values + share * step for share in SHARES] + [values + s * along for s in (-1.0, -0.3, 0.3, 1.0)])


def _grid(criterion: Criterion, values: Array, places: list[int], reach: float) -> Array:
    points = np.linspace(-reach, reach, 9 if len(places) < 3 else 3)
    lanes = np.repeat(values[None], len(points) ** len(places), axis=0)
    sizes = np.array([criterion.unknowns[k].negligible for k in places])
    lanes[:, places] += sizes * np.array(list(product(points, repeat=len(places))))
    return lanes
