"""Errors of recordings that are predicted by values fitted to others (Hastie, Tibshirani, Friedman, 2nd ed., section 7.10).

Errors of a free run accumulate: a recording of a minute contains few independent ones, and a single held-out recording hardly
tells by how much an effect reduces them.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.case import Stage
from sysid.gap.data import Data
from sysid.gap.fit import fit_candidates

Array = npt.NDArray[np.float64]

#: Parts of the fitted recordings, each predicted by the others.
FOLDS = 5


class Fitted(Protocol):
    """A set of effects with its values (k,), and the whole parameter vector (N,)."""

    @property
    def candidates(self) -> tuple[Candidate, ...]: ...
    @property
    def values(self) -> Array: ...
    @property
    def theta(self) -> Array: ...


def cross_validated_error(stage: Stage, model: Fitted) -> float:
    """RMS error of all recordings in noise floors, mean of the squares over signals.

    Held-out recordings are predicted by ``model``, each fold of the others by values that are fitted without it.
    """
    seen = stage.split.seen
    folds = min(FOLDS, len(seen))
    predicted = [(model.theta, r) for r in stage.split.held_out]
    for k in range(folds) if folds > 1 else ():
        theta = _without_fold(stage, model, k, folds)
        predicted += [(theta, r) for r in seen[k::folds]]
    problem = stage.problem
    left = np.concatenate([problem.measured(r) - problem.predict(theta[None], r)[0] for theta, r in predicted])
    return float(np.sqrt(np.nanmean(np.nanmean((left / stage.sigma) ** 2, axis=0))))


def _without_fold(stage: Stage, model: Fitted, fold: int, folds: int) -> Array:
    """The parameter vector with values fitted without a fold, begun at those of ``model`` and by the same criterion."""
    if not model.candidates:
        return model.theta
    kept = [r for k, r in enumerate(stage.split.seen) if k % folds != fold]
    data = Data(stage.problem, kept, stage.sigma, drifting=not stage.found.accumulates)
    return fit_candidates(data, stage.theta, model.candidates, [model.values]).theta
