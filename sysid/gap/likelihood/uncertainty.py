"""Covariance of the parameters of a model: the posterior of its likelihood, widened by the scatter between blocks.

Where the formulas are right, the inverse of the information is the covariance. Where they are wrong, the scores of the blocks
of the recordings vary more than the likelihood predicts; the sandwich covariance over blocks (White, Econometrica 50, 1982,
1–25) then widens the intervals.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def posterior_covariance(columns: Array, parameters: int, residual: Array, block: npt.NDArray[np.int64]) -> Array:
    """Covariance of the last ``parameters`` coefficients of a regression with unit priors and unit noise, (k, k).

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
    seen = count / (count - 1.0) * (moved**2).sum(axis=0)
    wider = np.sqrt(np.maximum(1.0, seen / np.diag(within)))
    return within * np.outer(wider, wider)
