"""Combinations of parameters that poses do not determine.

The Jacobian is scaled by noise and prior. A right singular vector whose singular value is below one is a combination about
which the poses contain less information than the prior: only sums that are orthogonal to it are determined.

Source: singular values of the scaled identification Jacobian as measure of identifiability: Hollerbach and Wampler, Int. J.
Robot. Res. 15 (1996), 573–591.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid.networks.geometry_parameters import GeometryParameter

Array = npt.NDArray[np.float64]
Combination = tuple[tuple[str, float], ...]

#: A combination is non-identifiable where the information of the poses is less than that of the prior.
MAX_INFORMATION = 1.0
#: Components of a combination below this share of the largest are not listed.
MIN_COMPONENT = 0.1


def non_identifiable(parameters: Sequence[GeometryParameter], information: Array) -> tuple[Combination, ...]:
    """Basis of the non-identifiable combinations, in reduced echelon form so that each has few parameters.

    Args:
        parameters: estimated ones; ``information``: of the poses about them, in units of their priors.

    Returns:
        Of each combination the parameters and their weights in SI.
    """
    strengths, directions = np.linalg.eigh(information)
    basis = directions[:, strengths < MAX_INFORMATION].T.copy()
    found = []
    for row in _reduced_echelon(basis):
        found.append(
            tuple(
                (parameter.key, float(part * parameter.prior))
                for parameter, part in zip(parameters, row, strict=True)
                if abs(part) >= MIN_COMPONENT * np.abs(row).max()
            )
        )
    return tuple(found)


def _reduced_echelon(basis: Array) -> Array:
    """Reduced row echelon form with pivots by size: each row has a parameter that no other row has."""
    rows = basis.copy()
    taken: list[int] = []
    for at in range(len(rows)):
        size = np.abs(rows[at:]).copy()
        size[:, taken] = 0.0
        pivot_row, pivot = np.unravel_index(int(np.argmax(size)), size.shape)
        rows[[at, at + int(pivot_row)]] = rows[[at + int(pivot_row), at]]
        rows[at] /= rows[at, pivot]
        for other in range(len(rows)):
            if other != at:
                rows[other] -= rows[other, pivot] * rows[at]
        taken.append(int(pivot))
    return rows
