"""Standard errors of a least-squares fit from its values without each part of the recordings.

Where the formulas of a stage are wrong, the best values depend on the motion, and each part of the recordings has its own. The
jackknife leaves out each part in turn,

    θ₍g₎ − θ = −(DᵀD − D_gᵀD_g)⁻¹ D_gᵀ e_g,      V = (G − 1)/G · Σ_g (θ₍g₎ − θ)(θ₍g₎ − θ)ᵀ,

with the residuals ``e`` and their slopes ``−D``, and Student's t with G − 1 degrees of freedom. Unlike the sandwich of summed
scores it is not too small where there are few parts or one of them determines a parameter.

Sources: Efron and Stein, Ann. Stat. 9 (1981), 586–596; Bell and McCaffrey, Survey Methodology 28 (2002), 169–181; MacKinnon,
Nielsen and Webb, J. Econometrics 232 (2023), 272–299.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy import stats

from sysid.gap.candidates import Unknown
from sysid.gap.data import Data
from sysid.gap.fit import place

Array = npt.NDArray[np.float64]
Clusters = npt.NDArray[np.int64]

#: Correlation length of the errors of a free run [s].
CORRELATED = 25.0
#: Least number of clusters beyond that of the unknowns.
MIN_FREE = 2
#: Steps of the slopes, in the negligible change. Within a short step no motion, or one alone, begins at another sample.
SMOOTH, STEPWISE = 0.1, 1.0
#: Prior standard deviation of an unknown, in its negligible change.
PRIOR = 1e3


def jackknifed(data: Data, theta: Array, unknowns: Sequence[Unknown], values: Array) -> Array:
    """Half-widths (k,) of 95 % intervals of least-squares ``values`` (k,), from parts of the correlation length.

    Args:
        theta: vector of the plant under test.
    """
    prior = np.array([1.0 / (PRIOR * u.negligible) ** 2 for u in unknowns])
    return half_widths(*_linearised(data, theta, unknowns, values), prior)


def half_widths(errors: Array, slopes: Array, clusters: Clusters, prior: Array) -> Array:
    """Half-widths (k,) by the jackknife.

    Args:
        errors: residuals at the optimum (n,); slopes: of the prediction (n, k).
        clusters: of each row (n,). prior: inverse variances (k,).
    """
    k = slopes.shape[1]
    names = np.unique(clusters)
    free = len(names) - 1
    if len(names) < k + MIN_FREE:
        return np.zeros(k)
    whole = slopes.T @ slopes + np.diag(prior)
    scale = 1.0 / np.sqrt(np.diag(whole))
    moved = np.empty((len(names), k))
    for g, name in enumerate(names):
        D, e = slopes[clusters == name] * scale, errors[clusters == name]
        moved[g] = -scale * np.linalg.solve(whole * np.outer(scale, scale) - D.T @ D, D.T @ e)
    variance = free / len(names) * (moved**2).sum(axis=0)
    return np.asarray(stats.t.ppf(0.975, free) * np.sqrt(variance))


def _linearised(data: Data, theta: Array, unknowns: Sequence[Unknown], values: Array) -> tuple[Array, Array, Clusters]:
    """Residuals in noise floors (n,), slopes of the prediction (n, k), and the part of each row (n,)."""
    low, high = np.array([u.bounds for u in unknowns]).T
    steps = np.array([(STEPWISE if u.stepwise else SMOOTH) * u.negligible for u in unknowns])
    above, below = np.minimum(values + steps, high), np.maximum(values - steps, low)
    k = len(values)
    lanes = np.repeat(values[None], 2 * k + 1, axis=0)
    lanes[np.arange(1, k + 1), np.arange(k)] = above
    lanes[np.arange(k + 1, 2 * k + 1), np.arange(k)] = below
    errors, slopes, parts, count = [], [], [], 0
    for recording, table in zip(data.recordings, data.residuals(place(theta, unknowns, lanes)), strict=True):
        rows, signals = table.shape[1:]
        length = max(1, round(CORRELATED * data.problem.rate(recording)))
        part = count + np.repeat(np.arange(rows) // length, signals)
        count += -(-rows // length)
        flat = table.reshape(len(lanes), -1)
        there = ~np.isnan(flat).any(axis=0)
        errors.append(flat[0, there])
        slopes.append(((flat[k + 1 :] - flat[1 : k + 1]) / (above - below)[:, None])[:, there].T)
        parts.append(part[there])
    return np.concatenate(errors), np.concatenate(slopes), np.concatenate(parts)
