"""Which candidates may be worth a fit: what each could gain at most if the stage answered to it linearly.

A fit takes a hundred rollouts, a look ahead one for each starting value. The residual of the present model is projected on
what a candidate changes (whole starting values, and small steps of its parameters), after both were freed of what the fitted
parameters can imitate; what that explains is close to what the fit would gain (the score test of Rao, 1948, with long steps
beside the short ones, since many effects are flat where they are absent).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.data import Data
from sysid.gap.drift import CLIP
from sysid.gap.fit import Fit, jacobian

Array = npt.NDArray[np.float64]

#: Short steps, in what is negligible of each parameter.
STEP = 2.0


def likely_gains(data: Data, theta: Array, model: Fit, candidates: Sequence[Candidate]) -> Array:
    """Log likelihood [nats] that each of ``candidates`` may add to ``model``, (c,)."""
    lanes, owners, whole = _lanes(model.theta, candidates)
    series = data.whitened(np.vstack([model.theta[None], lanes]), model.drifts)
    residual, changes = np.clip(series[0], -CLIP, CLIP), series[1:] - series[0]
    if model.unknowns:
        basis, _ = np.linalg.qr(jacobian(data, theta, model.unknowns, model.values, model.drifts)[1])
        residual = residual - basis @ (basis.T @ residual)
        changes = changes - (changes @ basis) @ basis.T
    before = float(residual @ residual)
    gains = np.zeros(len(candidates))
    for k in range(len(candidates)):
        mine = owners == k
        for directions in (*changes[mine & whole, None, :], changes[mine & ~whole]):
            weights, *_ = np.linalg.lstsq(directions.T, residual, rcond=None)
            left = residual - weights @ directions
            gains[k] = max(gains[k], 0.5 * (before - float(left @ left)))
    return gains


def _lanes(theta: Array, candidates: Sequence[Candidate]) -> tuple[Array, npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
    """Parameter vectors (one row each), whose candidate each is, and whether it is a whole starting value or a short step."""
    lanes, owners, whole = [], [], []
    for k, candidate in enumerate(candidates):
        for start in candidate.starts:
            changed = theta.copy()
            for unknown, value in zip(candidate.unknowns, start, strict=True):
                changed[list(unknown.places)] = value
            lanes.append(changed)
            owners.append(k)
            whole.append(True)
        for unknown in candidate.unknowns:
            changed = theta.copy()
            at = list(unknown.places)
            step = STEP * unknown.negligible
            changed[at] += step if changed[at[0]] + step <= unknown.bounds[1] else -step
            lanes.append(changed)
            owners.append(k)
            whole.append(False)
    return np.array(lanes), np.array(owners), np.array(whole)
