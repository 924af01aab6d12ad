"""Profile likelihood: each parameter is moved away and the others are refitted, until the cost has risen by a threshold.

The threshold is ``½·t²`` for white residuals, and larger where the sandwich covariance shows that they are not (Pace, Salvan &
Sartori, Statistica Sinica 21 (2011)). The interval follows the shape of the cost: one-sided at a bound, asymmetric at a
threshold, and as wide as the step of a stepwise parameter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.gap.intervals.criterion import Criterion, Curvature

Array = npt.NDArray[np.float64]
Places = npt.NDArray[np.int64]

#: Distances that are tested first, in half-widths of a parabola; later rounds extend or refine them.
DISTANCES = (0.25, 0.5, 0.75, 1.0, 1.25, 1.6)
ROUNDS = 8
EXTENSION = 3.0
#: First distance of a stepwise parameter, at least, in its negligible change.
FIRST = 0.25
#: An end is found where the distances around it differ by less than this factor.
CLOSE = 1.6
#: Gauss–Newton steps of the other parameters.
REFITS = 2


@dataclass
class _Side:
    """Search for one end of an interval.

    Args:
        place: of the parameter; ``sign``: direction; ``bound``: distance of its bound.
        inner, outer: largest distance inside and smallest outside, each with the rise of the cost there.
    """

    place: int
    sign: float
    bound: float
    inner: tuple[float, float] = (0.0, 0.0)
    outer: tuple[float, float] | None = None

    def tried(self, half: float) -> Array:
        """Distances to test next, (6,)."""
        if self.outer is not None:
            begin = max(self.inner[0], 1e-2 * self.outer[0])
            return np.geomspace(begin, self.outer[0], len(DISTANCES) + 2)[1:-1]
        return np.array(DISTANCES) * (half if self.inner[0] == 0.0 else EXTENSION * self.inner[0])

    def learn(self, away: Array, risen: Array, allowed: float) -> None:
        """Take in the rise of the cost at distances (6,); the last one within ``allowed`` is inside."""
        inside = np.flatnonzero(risen <= allowed)
        last = int(inside[-1]) if len(inside) else -1
        if last >= 0 and away[last] > self.inner[0]:
            self.inner = float(away[last]), max(float(risen[last]), 0.0)
        if last + 1 < len(away):
            self.outer = float(away[last + 1]), float(risen[last + 1])

    def done(self, least: float) -> bool:
        if self.outer is None:
            return self.inner[0] >= self.bound
        return self.outer[0] <= max(CLOSE * self.inner[0], least)

    def end(self, allowed: float, stepwise: bool) -> float:
        """Distance of the end."""
        if self.outer is None:
            return self.bound
        if stepwise:
            return self.outer[0]
        # The square root of the rise is linear where the cost is a parabola.
        a, b, c = np.sqrt(self.inner[1]), np.sqrt(self.outer[1]), np.sqrt(allowed)
        return self.inner[0] + (self.outer[0] - self.inner[0]) * float(min((c - a) / max(b - a, 1e-12), 1.0))


def profiled(criterion: Criterion, curvature: Curvature, values: Array) -> Array:
    """Ends of the intervals, (k, 2), within the bounds."""
    first = [max(h, FIRST * u.negligible * u.stepwise) for h, u in zip(curvature.halves, criterion.unknowns, strict=True)]
    least = float(criterion.costs(curvature.errors))
    bounds = np.column_stack([values - criterion.low, criterion.high - values])
    sides = [_Side(k, sign, float(bounds[k, s])) for k in range(len(values)) for s, sign in ((0, -1.0), (1, 1.0))]
    for _ in range(ROUNDS):
        open_ = [s for s in sides if not s.done(1e-3 * criterion.unknowns[s.place].negligible)]
        if not open_:
            break
        tried = [np.minimum(s.tried(float(first[s.place])), s.bound) for s in open_]
        costs = _refitted(criterion, curvature, values, open_, np.array(tried))
        for side, away, cost in zip(open_, tried, costs, strict=True):
            side.learn(away, cost - least, float(curvature.allowed[side.place]))
    ends = values[:, None] + np.zeros(2)
    for s in sides:
        distance = s.end(float(curvature.allowed[s.place]), criterion.unknowns[s.place].stepwise)
        ends[s.place, int(s.sign > 0)] += s.sign * distance
    return np.clip(ends, criterion.low[:, None], criterion.high[:, None])


def _refitted(criterion: Criterion, curvature: Curvature, values: Array, sides: list[_Side], away: Array) -> Array:
    """Minimum costs with one parameter held at distances ``away`` (sides, m) and the others free, (sides, m)."""
    owners = np.repeat([s.place for s in sides], away.shape[1])
    signs = np.repeat([s.sign for s in sides], away.shape[1])
    smooth = np.array([not u.stepwise for u in criterion.unknowns])  # the others have no informative slopes
    along = (curvature.inverse / np.diag(curvature.inverse)).T * np.outer(smooth, smooth)
    along = along[owners]
    lanes = values + (signs * away.ravel())[:, None] * along
    held = values[owners] + signs * away.ravel()
    lanes = np.clip(lanes, criterion.low, criterion.high)
    lanes[np.arange(len(lanes)), owners] = held
    errors = criterion.errors(lanes)
    costs = criterion.costs(errors)
    if lanes.shape[1] > 1:
        squares = (curvature.slopes * criterion.weights(curvature.errors)[:, None]).T @ curvature.slopes
        for _ in range(REFITS):
            gradients = (criterion.weights(errors) * errors) @ curvature.slopes
            tried = np.clip(lanes + _steps(squares, gradients, owners) * smooth, criterion.low, criterion.high)
            new = criterion.errors(tried)
            less = criterion.costs(new)
            better = less < costs
            lanes[better], errors[better], costs[better] = tried[better], new[better], less[better]
    return costs.reshape(away.shape)


def _steps(squares: Array, gradients: Array, owners: Places) -> Array:
    """Gauss–Newton steps of all parameters but the held one of each lane, (lanes, k)."""
    steps = np.zeros(gradients.shape)
    for k in np.unique(owners):
        rest = np.flatnonzero(np.arange(len(squares)) != k)
        rows = np.flatnonzero(owners == k)
        solved = np.linalg.lstsq(squares[np.ix_(rest, rest)], gradients[np.ix_(rows, rest)].T, rcond=1e-12)[0]
        steps[np.ix_(rows, rest)] = -solved.T
    return steps
