"""Slopes of the standardised residuals at the scale of the uncertainty itself, and what correlated residuals add.

Slopes are differences over about one standard error, to both sides: a threshold between two samples of a command has none at a
smaller scale, and a play has kinks. The sandwich covariance (White, Econometrica 50 (1982)) sums scores in blocks of several
lengths and believes the widest: a whitened residual that is not white, or one that is not whitened, is known by that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from sysid.gap.drift import BIN
from sysid.gap.intervals.criterion import Criterion

Array = npt.NDArray[np.float64]

#: Lengths of blocks of scores [s]; the longer ones only where that leaves so many blocks.
BLOCKS, LEAST = (1.0, 4.0, 12.0), 10
#: A step of a difference in standard errors, and how often it is renewed.
STEP, ROUNDS = 1.0, 2


@dataclass(frozen=True)
class Curvature:
    """Local shape of the cost.

    Args:
        errors: at the optimum (n,); ``slopes`` (n, k).
        inverse: of the weighted squares of the slopes (k, k): the covariance if residuals were white.
        covariance: that of the sandwich (k, k).
        allowed: how much the cost may rise along each parameter's profile (k,), for 95 %.
    """

    errors: Array
    slopes: Array
    inverse: Array
    covariance: Array
    allowed: Array

    @property
    def deviations(self) -> Array:
        """Standard errors (k,), of white residuals."""
        return np.sqrt(np.diag(self.inverse))

    @property
    def halves(self) -> Array:
        """Half widths (k,) of the 95 % intervals where the cost is a parabola."""
        return np.asarray(np.sqrt(2.0 * self.allowed) * self.deviations)


def curvature_at(criterion: Criterion, values: Array) -> Curvature:
    """Of a criterion at ``values`` (k,)."""
    steps = np.array([0.1 * u.negligible for u in criterion.unknowns])
    errors, slopes = slopes_at(criterion, values, steps)
    for _ in range(ROUNDS):
        inverse = _inverse(criterion, errors, slopes)
        steps = np.clip(STEP * np.sqrt(np.diag(inverse)), 0.3 * steps, 10.0 * steps)
        errors, slopes = slopes_at(criterion, values, steps)
    inverse = _inverse(criterion, errors, slopes)
    scores = slopes * (criterion.weights(errors) * errors)[:, None]
    white = np.diag(inverse)
    best, allowed = inverse, np.full(len(white), 0.5 * stats.norm.ppf(0.975) ** 2)
    for seconds in BLOCKS:
        blocks = _summed(scores, criterion.lengths(), max(1, round(seconds / BIN)))
        free = len(blocks) - len(white)
        if free < LEAST:
            break
        sandwich = inverse @ (blocks.T @ blocks) @ inverse * len(blocks) / free
        wide = 0.5 * stats.t.ppf(0.975, free) ** 2 * np.diag(sandwich) / white
        if wide.sum() > allowed.sum():
            best = sandwich
        allowed = np.maximum(allowed, wide)
    # Slopes say little about what acts in steps; it is allowed what the others are.
    stepwise = np.array([u.stepwise for u in criterion.unknowns])
    if not stepwise.all():
        allowed[stepwise] = allowed[~stepwise].max()
    return Curvature(errors, slopes, inverse, 0.5 * (best + best.T), allowed)


def slopes_at(criterion: Criterion, values: Array, steps: Array) -> tuple[Array, Array]:
    """Residuals (n,) and their slopes (n, k) over ``steps`` to both sides, or to the inside of a bound."""
    above = np.minimum(values + steps, criterion.high)
    below = np.maximum(values - steps, criterion.low)
    k = len(values)
    lanes = np.repeat(values[None], 2 * k + 1, axis=0)
    lanes[np.arange(1, k + 1), np.arange(k)] = above
    lanes[np.arange(k + 1, 2 * k + 1), np.arange(k)] = below
    errors = criterion.errors(lanes)
    return errors[0], ((errors[1 : k + 1] - errors[k + 1 :]) / (above - below)[:, None]).T


def _inverse(criterion: Criterion, errors: Array, slopes: Array) -> Array:
    """Of the squares of the slopes; what has none is known to no better than a thousand of its own steps."""
    squares = (slopes * criterion.weights(errors)[:, None]).T @ slopes
    least = np.array([1.0 / (1e3 * u.negligible) ** 2 for u in criterion.unknowns])
    scale = np.sqrt(np.diag(squares) + least)
    return np.asarray(np.linalg.inv((squares + np.diag(least)) / np.outer(scale, scale)) / np.outer(scale, scale))


def _summed(scores: Array, lengths: list[int], size: int) -> Array:
    """Sums over blocks that do not reach across recordings; all signals of one time in one block."""
    parts, at = [], 0
    for length in lengths:
        parts.append(np.add.reduceat(scores[at : at + length], np.arange(0, length, size), axis=0))
        at += length
    return np.concatenate(parts)
