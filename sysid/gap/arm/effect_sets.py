"""Sets of effects, by number of the candidate, in a Gaussian regression on all of them beside small errors of the arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.likelihood.block_products import block_products, predictive_densities
from sysid.gap.likelihood.gaussian_regression import GaussianRegression, Sizes

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Set = frozenset[int]

#: Least gain in evidence of a step of the search [nats].
GAIN = 1e-6


def places(candidates: Sequence[Candidate]) -> list[Index]:
    """Indices of the unknowns of each candidate among those of all."""
    ends = np.cumsum([0, *(len(c.unknowns) for c in candidates)])
    return [np.arange(a, b, dtype=np.intp) for a, b in pairwise(ends)]


def unknowns_of(places: Sequence[Index], members: Set) -> Index:
    """Indices of the unknowns of a set, candidate by candidate in ascending order; ``places`` of each candidate."""
    return np.concatenate([np.empty(0, dtype=np.intp), *(places[k] for k in sorted(members))])


def gain_of_errors(regression: GaussianRegression, unknowns: Index) -> float:
    """Gain in evidence of a set by the small errors, with the noise that is most likely without them [nats]."""
    alone = replace(
        regression,
        errors=np.empty((len(regression.target), 0)),
        kind=np.empty(0, dtype=np.int64),
        sizes=Sizes(np.empty(0), regression.sizes.noise),
        expected=np.empty(0),
        spread=np.empty(0),
    )
    alone = alone.under(alone.with_sizes(unknowns))
    return regression.posterior(unknowns).evidence - alone.posterior(unknowns).evidence


def densities_of_blocks(regression: GaussianRegression, unknowns: Index, block: npt.NDArray[np.int64], blocks: int) -> Array:
    """Log predictive density of each block of rows, unknowns and small errors from the other blocks, (blocks,)."""
    noise, tau = regression.sizes.noise, regression.sizes.tau[regression.kind]
    effects = regression.columns[:, unknowns] * regression.prior.width[unknowns]
    products = block_products(np.hstack([regression.errors * tau, effects]) / noise, regression.target / noise, block, blocks)
    return predictive_densities(products, products.right.sum(axis=0), products.information)
