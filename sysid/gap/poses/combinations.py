"""Combinations of unknowns that the poses do not determine, in words.

In units of the priors, the poses determine a direction where the posterior deviation is well below the prior's. Directions that
are not determined are sparse after a rotation to few members (varimax: Kaiser, Psychometrika 23 (1958), 187–200), so that each
reads as a sentence.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from sysid.gap.likelihood.gaussian_regression import UNDETERMINED
from sysid.gap.poses.search import SetSearch

Array = npt.NDArray[np.float64]

#: Members below this weight are left out of the sentence; largest number of members that make a sentence.
LEAST_WEIGHT, MOST_MEMBERS = 0.3, 4
#: Iterations of the rotation.
TURNS = 50


def undetermined(search: SetSearch) -> Iterator[str]:
    """A sentence for each combination of the unknowns of all candidates that the poses do not determine."""
    names = [f"{c.effect.name}({c.target}).{u.key}" for c in search.candidates for u in c.unknowns]
    if not names:
        return
    whole, _ = search.regression.marginal
    plausible = np.array([_plausible(c.starts, k) for c in search.candidates for k in range(len(c.unknowns))])
    gram = whole[:-1, :-1] * np.outer(plausible, plausible)
    values, vectors = np.linalg.eigh(gram)
    open_ = vectors[:, 1.0 / np.sqrt(1.0 + np.maximum(values, 0.0)) > UNDETERMINED]
    for direction in _sparse(open_).T:
        order = np.argsort(-np.abs(direction))
        members = [int(k) for k in order if abs(direction[k]) >= LEAST_WEIGHT]
        if 2 <= len(members) <= MOST_MEMBERS:
            yield f"these poses do not separate {' and '.join(names[k] for k in sorted(members))}: only their sum is determined"


def _plausible(starts: tuple[tuple[float, ...], ...], k: int) -> float:
    """Plausible size of an unknown: half the spread of its start values, else 0.01 (m or rad)."""
    return float(np.ptp([row[k] for row in starts])) / 2.0 or 0.01


def _sparse(loadings: Array) -> Array:
    """Varimax rotation of orthonormal directions (k, m)."""
    turned = loadings
    for _ in range(TURNS if loadings.shape[1] > 1 else 0):
        u, _, vt = np.linalg.svd(loadings.T @ (turned**3 - turned * (turned**2).mean(axis=0)))
        turned = loadings @ (u @ vt)
    return turned
