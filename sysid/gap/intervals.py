"""95 % intervals of fitted parameters that hold when residuals are correlated in time.

Sandwich covariance with scores summed in blocks (Newey & West, Econometrica 55 (1987), in its block form): the scatter of the
blocks' scores, not the residual variance of single samples, says how well a parameter is known.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy import stats

from sysid.gap.drift import BIN
from sysid.gap.fit import Data, Fit, forgiveness, jacobian

Array = npt.NDArray[np.float64]

#: Length of a block of scores [s].
BLOCK = 4.0


def covariance_of(data: Data, theta: Array, fit: Fit) -> tuple[Array, int]:
    """Covariance of the unknowns of ``fit`` (k, k), and the number of blocks that it was taken from."""
    if not fit.unknowns:
        return np.empty((0, 0)), 0
    blocks, bread = [], np.zeros((len(fit.unknowns), len(fit.unknowns)))
    for recording in data.recordings:
        r, slopes = jacobian(replace(data, recordings=[recording]), theta, fit.unknowns, fit.values, fit.drifts)
        weight = 1.0 / np.sqrt(1.0 + (r / forgiveness(r)) ** 2)
        bread += (slopes * weight[:, None]).T @ slopes
        scores = slopes * (weight * r)[:, None]
        starts = np.arange(0, len(scores), max(1, round(BLOCK / BIN)))
        blocks.append(np.add.reduceat(scores, starts, axis=0))
    score = np.concatenate(blocks)
    count = len(score)
    inverse = np.linalg.pinv(bread, rcond=1e-12)
    covariance: Array = inverse @ (score.T @ score) @ inverse * count / max(count - len(fit.unknowns), 1)
    return 0.5 * (covariance + covariance.T), count


def intervals(fit: Fit, covariance: Array, count: int) -> Array:
    """(k, 2) lower and upper ends for the unknowns of ``fit``, clipped to their bounds."""
    reach = stats.t.ppf(0.975, max(count - len(fit.unknowns), 1)) * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    low = np.array([u.bounds[0] for u in fit.unknowns])
    high = np.array([u.bounds[1] for u in fit.unknowns])
    return np.column_stack([np.maximum(fit.values - reach, low), np.minimum(fit.values + reach, high)])
