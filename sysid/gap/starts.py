"""Start values of a fit: nominal, those of the candidates, spread over their ranges, and the optima of smaller fits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.stats import qmc

from sysid.gap.candidates import Candidate
from sysid.gap.fit import Fit

Array = npt.NDArray[np.float64]

#: Number of start values spread over the ranges of the unknowns; all are evaluated in one batch, the best are used.
STARTS = 32


def starting_values(candidates: Sequence[Candidate], parents: Sequence[Fit], seed: int) -> list[Array]:
    """Nominal values, starts of the candidates, a spread over their ranges; optima of ``parents`` with new effects."""
    if not candidates:
        return [np.empty(0)]
    nominal = np.array([u.nominal for c in candidates for u in c.unknowns])
    low = np.concatenate([_ends(c)[0] for c in candidates])
    high = np.concatenate([_ends(c)[1] for c in candidates])
    spread = low + (high - low) * qmc.Sobol(len(nominal), rng=np.random.default_rng(seed)).random(STARTS)
    rows = range(max(len(c.starts) for c in candidates))
    spread = np.vstack([spread, *(np.concatenate([c.starts[min(r, len(c.starts) - 1)] for c in candidates]) for r in rows)])
    starts = [nominal, *spread]
    for parent in parents:
        known = np.concatenate([_known(c, parent) for c in candidates])
        new = np.isnan(known)
        starts += [np.where(new, row, known) for row in (spread if new.any() else [nominal])]
        starts.append(np.where(new, nominal, known))
    return starts


def _ends(candidate: Candidate) -> tuple[Array, Array]:
    """Least and greatest of a candidate's start values and its nominal ones.

    A nominal value far from all start values means "absent": it is moved towards them, so that the spread covers their range.
    """
    table = np.array(candidate.starts)
    low, high = table.min(axis=0), table.max(axis=0)
    margin = np.maximum(high - low, np.abs(table).max(axis=0))
    nominal = np.clip([u.nominal for u in candidate.unknowns], low - margin, high + margin)
    return np.minimum(low, nominal), np.maximum(high, nominal)


def _known(candidate: Candidate, parent: Fit) -> Array:
    """Values of a candidate at a parent's optimum (in another form of the same effect too); NaN where it is new."""
    for other in parent.candidates:
        if other is candidate:
            return parent.values_of(other)
        if other.key == candidate.key:
            slots = {at: v for u, v in zip(other.unknowns, parent.values_of(other), strict=True) for at in u.places}
            return np.array([slots.get(u.places[0], u.nominal) for u in candidate.unknowns])
    return np.full(len(candidate.unknowns), np.nan)
