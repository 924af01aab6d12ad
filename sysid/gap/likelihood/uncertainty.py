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
    bread = np.asarray(np.linalg.inv(columns.T @ columns + np.eye(columns.shape[1])), dtype=np.float64)
    left = residual - columns @ (bread @ (columns.T @ residual))
    within = bread[-k:, -k:]
    scatter, count = scatter_of_clusters(columns, left, bread[:, -k:], block)
    if count < 2:
        return within
    wider = np.sqrt(np.maximum(1.0, np.diag(scatter) / np.diag(within)))
    return np.asarray(within * np.outer(wider, wider))


def scatter_of_clusters(columns: Array, left: Array, bread: Array, cluster: npt.NDArray[np.int64]) -> tuple[Array, int]:
    """Sandwich covariance of coefficients, (k, k), and the number of clusters; zero with fewer than two.

    Args:
        columns: (rows, p). left: residual at the optimum, (rows,).
        bread: columns of the inverse information that belong to the coefficients, (p, k).
        cluster: of each row, (rows,).
    """
    order = np.argsort(cluster, kind="stable")
    first = np.flatnonzero(np.diff(cluster[order], prepend=-1))
    pulls = np.add.reduceat((columns * left[:, None])[order], first, axis=0)
    count = len(pulls)
    if count < 2:
        return np.zeros((bread.shape[1],) * 2), count
    moved = pulls @ bread  # change of the coefficients by each cluster
    return np.asarray(count / (count - 1.0) * (moved.T @ moved)), count
