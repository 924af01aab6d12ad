"""Is a larger model really better? Criteria that hold when residuals are correlated in time.

Naive criteria count every sample as independent and name effects that are not there in most runs on drifting residuals
(measured: ΔBIC > 10 in 67–94 % of null runs). Here the drift is part of each model's likelihood (:mod:`sysid.gap.drift`), and
the gain in predictive density on recordings that the fit has not seen is bootstrapped in blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.validate.bootstrap import bootstrap_means

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Comparison:
    """A larger model against a smaller one.

    Args:
        delta_bic: BIC(smaller) − BIC(larger) on the fitted recordings; above 10 is strong evidence for the larger.
        gain: log predictive density gained on unseen recordings (natural log).
        p_value: share of block-bootstrap samples in which the larger one does not predict unseen recordings better.
        ratio: RMSE on unseen recordings, smaller / larger.
    """

    delta_bic: float
    gain: float
    p_value: float
    ratio: float


def gain_p_value(gain: Array, seed: int, draws: int = 1000) -> float:
    """Share of stationary-bootstrap means of ``gain`` that are not positive (Politis & Romano, JASA 89 (1994))."""
    if len(gain) < 20 or not np.any(gain != 0.0):
        return 1.0
    means = bootstrap_means(gain, seed, draws)
    return float((np.sum(means <= 0.0) + 1) / (draws + 1))


def confidence_set(losses: Sequence[Array], seed: int = 0, size: float = 0.05) -> list[int]:
    """Indices of the models that survive a model confidence set (Hansen, Lunde, Nason, Econometrica 79 (2011)).

    Args:
        losses: loss series of each model on the same bins, each (m,).
    """
    from arch.bootstrap import MCS

    table = np.column_stack(losses)
    distinct = [k for k in range(1, len(losses)) if np.any(table[:, k] != table[:, 0])]
    same = [k for k in range(1, len(losses)) if k not in distinct]
    if not distinct:
        return list(range(len(losses)))
    kept = [0, *distinct]
    block = int(np.clip(len(table) / 20, 5, 50))
    mcs = MCS(table[:, kept], size=size, reps=500, block_size=block, seed=np.random.default_rng(seed))
    mcs.compute()
    included = {kept[k] for k in range(len(kept)) if k in mcs.included}
    return sorted(included | (set(same) if 0 in included else set()))
