"""Profile likelihood: each parameter is moved away, the others follow to where the cost is least, until it costs too much.

How much the cost may rise is ``½·t²`` for white residuals, and more where the sandwich finds that they are not (Pace, Salvan &
Sartori, Statistica Sinica 21 (2011)). So the interval follows the shape of the cost: it is one-sided at a bound, lopsided at a
threshold, and as wide as the step of a parameter that acts in steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.gap.intervals.criterion import Criterion
from sysid.gap.intervals.curvature import Curvature

Array = npt.NDArray[np.float64]
Places = npt.NDArray[np.int64]

#: Distances that are tried first, in half widths of a parabola; later rounds reach further or look between.
REACHES = (0.25, 0.5, 0.75, 1.0, 1.25, 1.6)
ROUNDS = 8
FURTHER = 3.0
#: A parameter that acts in steps is moved by at least this share of what is negligible at first.
FIRST = 0.25
#: An end is found where the distances around it differ by less than this factor.
NEAR = 1.6
#: Rounds in which the others follow.
FOLLOW = 2


@dataclass
class _Side:
    """One end that is looked for: the parameter, its direction, and what is known inside and outside of it."""

    place: int
    sign: float
    room: float
    inner: tuple[float, float] = (0.0, 0.0)
    outer: tuple[float, float] | None = None

    def tried(self, half: float) -> Array:
        """Distances to try next, (6,)."""
        if self.outer is not None:
            begin = max(self.inner[0], 1e-2 * self.outer[0])
            return np.geomspace(begin, self.outer[0], len(REACHES) + 2)[1:-1]
        return np.array(REACHES) * (half if self.inner[0] == 0.0 else FURTHER * self.inner[0])

    def learn(self, away: Array, risen: Array, allowed: float) -> None:
        """What the cost has risen by at distances (6,): inside lies what is followed by nothing cheaper than allowed."""
        inside = np.flatnonzero(risen <= allowed)
        last = int(inside[-1]) if len(inside) else -1
        if last >= 0 and away[last] > self.inner[0]:
            self.inner = float(away[last]), max(float(risen[last]), 0.0)
        if last + 1 < len(away):
            self.outer = float(away[last + 1]), float(risen[last + 1])

    def done(self, least: float) -> bool:
        if self.outer is None:
            return self.inner[0] >= self.room
        return self.outer[0] <= max(NEAR * self.inner[0], least)

    def end(self, allowed: float, stepwise: bool) -> float:
        """Distance of the end."""
        if self.outer is None:
            return self.room
        if stepwise:
            return self.outer[0]
        # The root of the rise is a line where the cost is a parabola.
        a, b, c = np.sqrt(self.inner[1]), np.sqrt(self.outer[1]), np.sqrt(allowed)
        return self.inner[0] + (self.outer[0] - self.inner[0]) * float(min((c - a) / max(b - a, 1e-12), 1.0))


def profiled(criterion: Criterion, curvature: Curvature, values: Array) -> Array:
    """Ends of the intervals, (k, 2), inside of the bounds."""
    first = [max(h, FIRST * u.negligible * u.stepwise) for h, u in zip(curvature.halves, criterion.unknowns, strict=True)]
    least = float(criterion.costs(curvature.errors))
    rooms = np.column_stack([values - criterion.low, criterion.high - values])
    sides = [_Side(k, sign, float(rooms[k, s])) for k in range(len(values)) for s, sign in ((0, -1.0), (1, 1.0))]
    for _ in range(ROUNDS):
        still = [s for s in sides if not s.done(1e-3 * criterion.unknowns[s.place].negligible)]
        if not still:
            break
        tried = [np.minimum(s.tried(float(first[s.place])), s.room) for s in still]
        costs = _followed(criterion, curvature, values, still, np.array(tried))
        for side, away, cost in zip(still, tried, costs, strict=True):
            side.learn(away, cost - least, float(curvature.allowed[side.place]))
    ends = values[:, None] + np.zeros(2)
    for s in sides:
        distance = s.end(float(curvature.allowed[s.place]), criterion.unknowns[s.place].stepwise)
        ends[s.place, int(s.sign > 0)] += s.sign * distance
    return np.clip(ends, criterion.low[:, None], criterion.high[:, None])


def _followed(criterion: Criterion, curvature: Curvature, values: Array, sides: list[_Side], away: Array) -> Array:
    """Least costs with one parameter held at distances ``away`` (sides, m) and the others free, (sides, m)."""
    owners = np.repeat([s.place for s in sides], away.shape[1])
    signs = np.repeat([s.sign for s in sides], away.shape[1])
    smooth = np.array([not u.stepwise for u in criterion.unknowns])  # slopes say nothing about the others
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
        for _ in range(FOLLOW):
            gradients = (criterion.weights(errors) * errors) @ curvature.slopes
            tried = np.clip(lanes + _steps(squares, gradients, owners) * smooth, criterion.low, criterion.high)
            new = criterion.errors(tried)
            less = criterion.costs(new)
            better = less < costs
            lanes[better], errors[better], costs[better] = tried[better], new[better], less[better]
    return costs.reshape(away.shape)


def _steps(squares: Array, gradients: Array, owners: Places) -> Array:
    """Gauss–Newton steps of all parameters but each lane's own, (lanes, k)."""
    steps = np.zeros(gradients.shape)
    for k in np.unique(owners):
        rest = np.flatnonzero(np.arange(len(squares)) != k)
        rows = np.flatnonzero(owners == k)
        solved = np.linalg.lstsq(squares[np.ix_(rest, rest)], gradients[np.ix_(rows, rest)].T, rcond=1e-12)[0]
        steps[np.ix_(rows, rest)] = -solved.T
    return steps
