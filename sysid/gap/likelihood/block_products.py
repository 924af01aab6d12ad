"""Products of the columns of a regression within blocks of rows: covariances and predictive densities follow from them.

A set of effects adds a few columns to those of the linear part, whose products are known. No table of all columns is needed.

Covariance of the parameters of a model: the posterior of its likelihood, widened by the scatter between blocks.

Where the formulas are right, the inverse of the information is the covariance. Where they are wrong, the scores of the blocks
of the recordings vary more than the likelihood predicts; the sandwich covariance over blocks (White, Econometrica 50, 1982,
1–25) then widens the intervals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.compiled import summing

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]


@dataclass(frozen=True)
class BlockProducts:
    """Sums over the rows of each block, of p columns and of the residual at some coefficients.

    Args:
        gram: products of the columns, (blocks, p, p). right: of the columns with the residual, (blocks, p).
        squares: of the residual, (blocks,).
    """

    gram: Array
    right: Array
    squares: Array

    def combined(self, weights: Array) -> BlockProducts:
        """Of the combinations ``columns @ weights``, weights (p, q)."""
        return BlockProducts(weights.T @ self.gram @ weights, self.right @ weights, self.squares)

    def over(self, cluster: Index) -> BlockProducts:
        """Sums over clusters of blocks; ``cluster`` of each block, (blocks,)."""
        _, place = np.unique(cluster, return_inverse=True)
        order = np.argsort(place, kind="stable")
        first = np.flatnonzero(np.diff(place[order], prepend=-1))
        return BlockProducts(*(np.add.reduceat(part[order], first, axis=0) for part in (self.gram, self.right, self.squares)))

    @property
    def information(self) -> Array:
        """Products of the columns over all blocks with a unit prior, (p, p)."""
        return np.asarray(self.gram.sum(axis=0) + np.eye(self.gram.shape[1]))

    def remaining_squares(self, change: Array) -> Array:
        """Squares of the residual of each block after a ``change`` of the coefficients, (p,) or (blocks, p)."""
        change = np.broadcast_to(change, self.right.shape)
        bent = np.einsum("bij,bj->bi", self.gram, change)
        return np.asarray(self.squares - 2.0 * (change * self.right).sum(axis=1) + (change * bent).sum(axis=1))


def block_products(columns: Array, residual: Array, block: Index, blocks: int) -> BlockProducts:
    """Products of ``columns`` (rows, p) and ``residual`` (rows,) by the ``block`` of each row, (rows,)."""
    table = np.ascontiguousarray(np.column_stack([columns, residual]))
    found = products_by_block(table, table, block, blocks)
    return BlockProducts(found[:, :-1, :-1], found[:, :-1, -1], found[:, -1, -1])


def products_by_block(left: Array, right: Array, block: Index, blocks: int) -> Array:
    """Sums over the rows of each block of the products of ``left`` (rows, p) and ``right`` (rows, q), (blocks, p, q)."""
    out = np.zeros((blocks, left.shape[1], right.shape[1]))
    _add_products(np.ascontiguousarray(left), np.ascontiguousarray(right), block, out)
    return out


@summing
def _add_products(left, right, block, out):
    for r in range(len(left)):
        b = block[r]
        for i in range(left.shape[1]):
            x = left[r, i]
            for j in range(right.shape[1]):
                out[b, i, j] += x * right[r, j]


#: Share of the diagonal within which products of nearly parallel columns are indefinite by rounding.
ROUNDING = 1e-12


def factored(information: Array, factor: Callable[[Array], Any] = np.linalg.cholesky) -> Any:
    """Cholesky factor of products in unit prior (…, p, p); where rounding leaves them indefinite, of a diagonal that is wider.

    Responses of a millionfold the noise have products beside which the unit of the prior is below the last digit.
    """
    try:
        return factor(information)
    except np.linalg.LinAlgError:
        wider = information.copy()
        np.einsum("...ii->...i", wider)[...] *= 1.0 + ROUNDING
        return factor(wider)


def predictive_densities(products: BlockProducts, pull: Array, information: Array) -> Array:
    """Log predictive density of each block, all coefficients from the other blocks (normal equations downdated), (blocks,).

    Args:
        products: of whitened columns with a unit prior, and of the residual at some coefficients.
        pull: products of the columns with that residual over all blocks, less these coefficients, (p,).
        information: :attr:`BlockProducts.information` of ``products``, (p, p).
    """
    rest = information - products.gram
    factor = factored(rest)
    change: Array = np.linalg.solve(rest, (pull - products.right)[:, :, None])[:, :, 0].astype(np.float64)
    # The block's covariance is 1 + Xb·(H − G)⁻¹·Xbᵀ; its inverse by Woodbury is 1 − Xb·H⁻¹·Xbᵀ.
    z = products.right - np.einsum("bij,bj->bi", products.gram, change)
    squares = products.remaining_squares(change) - (z * np.linalg.solve(information, z.T).T).sum(axis=1)
    volume = np.linalg.slogdet(information)[1]
    diagonal = np.diagonal(factor, axis1=1, axis2=2)
    return np.asarray(-0.5 * squares - 0.5 * volume + np.log(diagonal).sum(axis=1))


# -- covariance ----------------------------------------------------------------------------------------------------------------


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
