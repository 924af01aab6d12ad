"""Covariance of the parameters of a model: the posterior of its likelihood, widened by the scatter between blocks.

Where the formulas are right, the inverse of the information is the covariance. Where they are wrong, the scores of the blocks
of the recordings vary more than the likelihood predicts; the sandwich covariance over blocks (White, Econometrica 50, 1982,
1–25) then widens the intervals. With few blocks a normal interval of it is too narrow: the deviations are multiplied by the
ratio of the quantiles of Student's t and the normal distribution (Cameron and Miller, Journal of Human Resources 50, 2015,
317–372, section VI).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import stdtrit

Array = npt.NDArray[np.float64]

#: Upper probability of a two-sided 95 % interval, and its quantile of the normal distribution.
UPPER, Z = 0.975, 1.959964


def posterior_covariance(columns: Array, parameters: int, residual: Array, block: npt.NDArray[np.int64]) -> Array:
    """Covariance of the last ``parameters`` coefficients of a regression with unit priors and unit noise, (k, k).

    Scaled so that ±1.96 standard deviations are a 95 % interval.

    Args:
        columns: whitened, (rows, p + k). residual: whitened, at coefficients of zero, (rows,).
        block: of each row, (rows,); rows without a measurement are zero.
    """
    k = parameters
    bread = np.linalg.inv(columns.T @ columns + np.eye(columns.shape[1]))
    left = residual - columns @ (bread @ (columns.T @ residual))
    order = np.argsort(block, kind="stable")
    first = np.flatnonzero(np.diff(block[order], prepend=-1))
    pulls = np.add.reduceat((columns * left[:, None])[order], first, axis=0)
    count = len(pulls)
    within = np.asarray(bread[-k:, -k:])
    if count < 2:
        return within
    moved = pulls @ bread[:, -k:]  # change of the parameters by each block
    seen = count / (count - 1.0) * (moved**2).sum(axis=0) * (float(stdtrit(count - 1, UPPER)) / Z) ** 2
    wider = np.sqrt(np.maximum(1.0, seen / np.diag(within)))
    return within * np.outer(wider, wider)
