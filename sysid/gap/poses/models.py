"""A set of effects in the regression of static poses as a model of the decision."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid.gap.fit import place
from sysid.gap.likelihood.block_products import block_products, predictive_densities
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.poses.rows import PoseRows
from sysid.gap.poses.search import Set, SetSearch

Array = npt.NDArray[np.float64]


def as_model(rows: PoseRows, search: SetSearch, members: Set, weights: Array) -> ModelFit:
    """The set with its values, covariance, evidence and the predictive density of each block of poses."""
    regression, at = search.regression, search.unknowns(members)
    found = search.posterior(members)
    candidates = tuple(search.candidates[k] for k in sorted(members))
    unknowns = tuple(u for c in candidates for u in c.unknowns)
    values = np.clip(regression.nominal[at] + found.change, regression.prior.low[at], regression.prior.high[at])
    theta = place(rows.theta, unknowns, values[None])[0] if unknowns else rows.theta
    noise, tau = regression.sizes.noise, regression.sizes.tau[regression.kind]
    effects = regression.columns[:, at]
    table = np.hstack([regression.errors * tau, effects * regression.prior.width[at]]) / noise
    products = block_products(table, regression.target / noise, rows.block, rows.blocks)
    predictive = predictive_densities(products, products.right.sum(axis=0), products.information)
    by_row = np.maximum(rows.by_row(weights), 1e-9)
    left = (regression.target - effects @ found.change) / by_row
    count = max(regression.rows, 1)
    return ModelFit(
        candidates,
        unknowns,
        values,
        theta,
        found.covariance,
        np.zeros(len(at)),  # the covariance contains what the errors of the arm could do in its place
        found.evidence,
        predictive,
        float(np.sqrt(left @ left / count)) / noise,
        np.sqrt(((effects / by_row[:, None]) ** 2).sum(axis=0) / count),
        float(np.sqrt(left @ left / count)),
    )
