"""Gaussian regression on effects beside small errors of everything else: a set of effects costs microseconds.

Of static poses (linearised at a parameter vector) and of the links of an arm.

    y = X·d + Φ·β + noise,   β_j ~ N(0, τ²_kind(j)),   noise ~ N(0, s²·floor²),   d_k ~ N(0, width_k²)

``d``: changes of the unknowns of all candidates from nominal. Φ and the noise are marginalised once, in the products of all
columns; a set of effects needs only its part of them. Its evidence is Laplace's approximation with the prior of
:class:`sysid.gap.likelihood.stage.Prior`; the sizes τ and s maximise the evidence beside a set (type II likelihood).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from sysid.gap.likelihood.block_products import factored
from sysid.gap.likelihood.stage import Prior

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Centre and spread (natural logarithm) of the prior of the sizes τ [m or rad] of static poses: a tenth of a millimetre or a
#: milliradian, unknown over two decades. Least size, and largest for such a centre.
TAU, TAU_SPREAD, ABSENT, LARGEST = 1e-4, 2.3, 1e-7, 0.1
#: Spread of the prior of the noise about the floor (natural logarithm).
NOISE_SPREAD = 1.0
#: A posterior deviation above this share of the prior's: the data do not determine that direction.
UNDETERMINED = 0.5


@dataclass(frozen=True)
class Sizes:
    """``tau`` of each kind of error, (kinds,) [m or rad]; ``noise``: of a row, in noise floors."""

    tau: Array
    noise: float


@dataclass(frozen=True)
class Posterior:
    """Of a set of unknowns: ``change`` from nominal (k,), ``covariance`` (k, k), ``evidence``; ``fit``: log likelihood there.

    ``inside``: whether its bounds are within two deviations of every value.
    """

    change: Array
    covariance: Array
    evidence: float
    fit: float
    inside: bool


@dataclass(frozen=True)
class GaussianRegression:
    """The regression under given sizes.

    Args:
        target: (rows,) in noise floors, weighted; zero where not measured.
        columns: X of all unknowns, (rows, K); ``errors``: Φ, (rows, p), of ``kind`` (p,).
        prior: of all unknowns; ``nominal``: their values in the plant under test, (K,).
        rows: number of measured rows.
        expected: centre of the prior of the sizes, with ``spread`` of its natural logarithm.
    """

    target: Array
    columns: Array
    errors: Array
    kind: npt.NDArray[np.int64]
    prior: Prior
    nominal: Array
    rows: int
    sizes: Sizes
    expected: Array | float = TAU
    spread: Array | float = TAU_SPREAD

    @cached_property
    def products(self) -> Array:
        """Of X, y and Φ with each other."""
        table = np.column_stack([self.columns, self.target, self.errors])
        return np.asarray(table.T @ table)

    @cached_property
    def marginal(self) -> tuple[Array, float]:
        """Products of X and y under the covariance of errors and noise, (K + 1, K + 1), and half its log determinant."""
        return _marginal(self.products, self.kind, self.rows, self.sizes)

    def posterior(self, unknowns: Index) -> Posterior:
        """Of the unknowns with these indices, the others at nominal."""
        whole, log_scale = self.marginal
        width, k = self.prior.width[unknowns], len(unknowns)
        gram, slope = whole[np.ix_(unknowns, unknowns)], whole[unknowns, -1]
        if not k:
            value = -0.5 * float(whole[-1, -1]) - log_scale
            return Posterior(np.empty(0), np.zeros((0, 0)), value, value, True)
        covariance = np.linalg.inv(gram * np.outer(width, width) + np.eye(k)) * np.outer(width, width)
        change = covariance @ slope
        part = Prior(*(getattr(self.prior, name)[unknowns] for name in ("centre", "width", "low", "high", "finest")))
        values = self.nominal[unknowns] + change
        reach = 2.0 * np.sqrt(np.diag(covariance))
        inside = bool(((values >= part.low - reach) & (values <= part.high + reach)).all())
        widths, cost = part.at_scale(np.clip(values, part.low, part.high))
        own = gram * np.outer(widths, widths) + np.eye(k)
        pull = widths * slope
        explained = float(pull @ np.linalg.solve(own, pull))
        evidence = -0.5 * (float(whole[-1, -1]) - explained) - 0.5 * float(np.linalg.slogdet(own)[1]) - log_scale - cost
        fit = -0.5 * float(whole[-1, -1] - 2.0 * slope @ change + change @ gram @ change) - log_scale
        return Posterior(change, covariance, evidence, fit, inside)

    def under(self, sizes: Sizes) -> GaussianRegression:
        """The regression under other sizes; the products, which do not depend on them, are kept."""
        other = replace(self, sizes=sizes)
        other.__dict__["products"] = self.products
        return other

    def with_sizes(self, beside: Index) -> Sizes:
        """Sizes of maximum evidence beside a set of unknowns, from the products alone."""
        kinds = len(self.sizes.tau)
        wide = self.prior.width[beside]
        K = self.columns.shape[1]
        kept = np.concatenate([beside, [K], np.arange(K + 1, len(self.products))]).astype(np.intp)
        products = self.products[np.ix_(kept, kept)]

        def negative(z: Array) -> float:
            sizes = Sizes(np.exp(z[:kinds]), float(np.exp(z[-1])))
            whole, log_scale = _marginal(products, self.kind, self.rows, sizes)
            gram = whole[:-1, :-1] * np.outer(wide, wide) + np.eye(len(beside))
            factor = factored(gram)
            e = np.linalg.solve(factor, wide * whole[:-1, -1])
            value = 0.5 * float(whole[-1, -1] - e @ e) + float(np.log(np.diag(factor)).sum()) + log_scale
            away = (z[:kinds] - np.log(self.expected)) / self.spread
            return float(value + 0.5 * float(away @ away) + 0.5 * (z[-1] / NOISE_SPREAD) ** 2)

        begin = np.append(np.log(np.clip(self.sizes.tau, self.expected, None)), np.log(self.sizes.noise))
        largest = np.maximum(LARGEST, 20.0 * np.broadcast_to(self.expected, kinds))
        bounds = [(np.log(ABSENT), float(np.log(most))) for most in largest] + [(np.log(0.05), np.log(1e3))]
        found = minimize(negative, begin, method="L-BFGS-B", bounds=bounds, options={"maxiter": 40})
        return Sizes(np.exp(found.x[:kinds]), float(np.exp(found.x[-1])))


def _marginal(products: Array, kind: npt.NDArray[np.int64], rows: int, sizes: Sizes) -> tuple[Array, float]:
    """Products under the covariance s²·1 + Φ·T·Φᵀ by Woodbury's identity, and half the log determinant of it."""
    p, s2 = len(kind), sizes.noise**2
    head = products[: len(products) - p, : len(products) - p]
    log_scale = rows * np.log(sizes.noise)
    if not p:
        return head / s2, float(log_scale)
    tau = sizes.tau[kind]
    inner = products[-p:, -p:] * np.outer(tau, tau) / s2 + np.eye(p)
    factor = factored(inner)
    side = np.linalg.solve(factor, tau[:, None] * products[-p:, :-p])
    return (head - side.T @ side / s2) / s2, float(log_scale + np.log(np.diag(factor)).sum())
