"""Covariance of the parameters of a model: the posterior of its likelihood, widened by the scatter between blocks.

Where the formulas are right, the inverse of the information is the covariance. Where they are wrong, the scores of the blocks
of the recordings vary more than the likelihood predicts; the sandwich covariance over blocks (White, Econometrica 50, 1982,
1–25) then widens the intervals.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid.gap.likelihood.block_products import BlockProducts

Array = npt.NDArray[np.float64]


def posterior_covariance(products: BlockProducts, parameters: int, pull: Array) -> Array:
    """Covariance of the last ``parameters`` coefficients of a regression with unit priors and unit noise, (k, k).

    Args:
        products: of the whitened columns and of the residual at some coefficients, by clusters of dependent rows.
        pull: products of the columns with that residual over all clusters, less these coefficients, (p,).
    """
    k = parameters
    bread = np.asarray(np.linalg.inv(products.information), dtype=np.float64)
    within = bread[-k:, -k:]
    scatter, count = cluster_covariance(products, bread @ pull, bread[:, -k:])
    if count < 2:
        return within
    wider = np.sqrt(np.maximum(1.0, np.diag(scatter) / np.diag(within)))
    return np.asarray(within * np.outer(wider, wider))


def cluster_covariance(products: BlockProducts, change: Array, bread: Array) -> tuple[Array, int]:
    """Sandwich covariance of coefficients, (k, k), and the number of clusters; zero with fewer than two.

    Args:
        change: of all coefficients, from those of the residual of ``products`` to the optimum, (p,).
        bread: columns of the inverse information that belong to the coefficients, (p, k).
    """
    pulls = products.right - products.gram @ change
    count = len(pulls)
    if count < 2:
        return np.zeros((bread.shape[1],) * 2), count
    moved = pulls @ bread  # change of the coefficients by each cluster
    return np.asarray(count / (count - 1.0) * (moved.T @ moved)), count
