"""Slopes of the standardised residuals at the scale of the uncertainty, and the effect of correlated residuals.

Slopes are central differences over about one standard error: a threshold between two samples of a command has no slope at a
smaller scale, and backlash has kinks. The sandwich covariance (White, Econometrica 50 (1982)) sums scores in blocks of several
lengths, of which the widest result counts: it accounts for residuals that are not white.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from sysid.gap.drift import BIN
from sysid.gap.intervals.criterion import Criterion

Array = npt.NDArray[np.float64]

#: Lengths of blocks of scores [s], and least number of blocks beyond that of the unknowns.
BLOCKS, MIN_BLOCKS = (1.0, 4.0, 12.0), 10
#: Step of the differences in standard errors, and number of rounds that determine it.
STEP, ROUNDS = 1.0, 2


@dataclass(frozen=True)
class Curvature:
    """Local shape of the cost.

    Args:
        errors: at the optimum (n,); ``slopes`` (n, k).
        inverse: of the weighted squares of the slopes (k, k): the covariance if residuals were white.
        allowed: rise of the cost along each parameter's profile (k,), for 95 %.
    """

    errors: Array
    slopes: Array
    inverse: Array
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
    """Curvature of a criterion at ``values`` (k,)."""
    steps = np.array([0.1 * u.negligible for u in criterion.unknowns])
    errors, slopes = slopes_at(criterion, values, steps)
    for _ in range(ROUNDS):
        inverse = _inverse(criterion, errors, slopes)
        steps = np.clip(STEP * np.sqrt(np.diag(inverse)), 0.3 * steps, 10.0 * steps)
        errors, slopes = slopes_at(criterion, values, steps)
    inverse = _inverse(criterion, errors, slopes)
    scores = slopes * (criterion.weights(errors) * errors)[:, None]
    white = np.diag(inverse)
    allowed = np.full(len(white), 0.5 * stats.norm.ppf(0.975) ** 2)
    for seconds in BLOCKS:
        blocks = _summed(scores, criterion.lengths(), max(1, round(seconds / BIN)))
        free = len(blocks) - len(white)
        if free < MIN_BLOCKS:
            break
        sandwich = inverse @ (blocks.T @ blocks) @ inverse * len(blocks) / free
        allowed = np.maximum(allowed, 0.5 * stats.t.ppf(0.975, free) ** 2 * np.diag(sandwich) / white)
    # Slopes of stepwise parameters are not informative: the largest rise of the others applies.
    stepwise = np.array([u.stepwise for u in criterion.unknowns])
    if not stepwise.all():
        allowed[stepwise] = allowed[~stepwise].max()
    return Curvature(errors, slopes, inverse, allowed)


def slopes_at(criterion: Criterion, values: Array, steps: Array) -> tuple[Array, Array]:
    """Residuals (n,) and their slopes (n, k): central differences over ``steps``, one-sided at a bound."""
    above = np.minimum(values + steps, criterion.high)
    below = np.maximum(values - steps, criterion.low)
    k = len(values)
    lanes = np.repeat(values[None], 2 * k + 1, axis=0)
    lanes[np.arange(1, k + 1), np.arange(k)] = above
    lanes[np.arange(k + 1, 2 * k + 1), np.arange(k)] = below
    errors = criterion.errors(lanes)
    return errors[0], ((errors[1 : k + 1] - errors[k + 1 :]) / (above - below)[:, None]).T


def _inverse(criterion: Criterion, errors: Array, slopes: Array) -> Array:
    """Inverse of the squares of the slopes; the prior of an unknown is a thousand of its negligible changes wide."""
    squares = (slopes * criterion.weights(errors)[:, None]).T @ slopes
    least = np.array([1.0 / (1e3 * u.negligible) ** 2 for u in criterion.unknowns])
    scale = np.sqrt(np.diag(squares) + least)
    return np.asarray(np.linalg.inv((squares + np.diag(least)) / np.outer(scale, scale)) / np.outer(scale, scale))


def _summed(scores: Array, lengths: list[int], size: int) -> Array:
    """Sums over blocks within recordings; all signals of one time are in one block."""
    parts, at = [], 0
    for length in lengths:
        parts.append(np.add.reduceat(scores[at : at + length], np.arange(0, length, size), axis=0))
        at += length
    return np.concatenate(parts)
