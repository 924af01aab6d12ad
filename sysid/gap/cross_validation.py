"""Errors of recordings that are predicted by values fitted to others (Hastie, Tibshirani, Friedman, 2nd ed., section 7.10).

Errors of a free run accumulate: a recording of a minute contains few independent ones, and a single held-out recording hardly
tells by how much an effect reduces them.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.data import Data
from sysid.gap.fit import fit_candidates
from sysid.gap.prepare.case import Stage

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
    """RMS error of all recordings in noise floors, mean of the squares over signals."""
    left = np.concatenate(list(_errors(stage, model).values()))
    return float(np.sqrt(np.nanmean(np.nanmean(left**2, axis=0))))


def gain_of_recordings(stage: Stage, without: Fitted, model: Fitted) -> float:
    """Gain of ``model`` in the prediction of whole recordings [nats].

    The squared errors of n recordings are lower by d_1 … d_n. Against a mean of zero, a normal density with unknown mean and
    variance gains ``n/2·ln(1 + t²/(n − 1))``, ``t`` of Student's test of the d (Mood, Graybill, Boes, Introduction to the
    Theory of Statistics, 3rd ed., ch. IX, section 4.1). Unlike blocks of a few seconds, recordings also show effects as slow as
    a leak at rest.
    """
    before, after = (_errors(stage, each) for each in (without, model))
    lower = np.array([np.nansum(before[name] ** 2) - np.nansum(after[name] ** 2) for name in before])
    n, spread = len(lower), float(np.std(lower, ddof=1)) if len(lower) > 1 else 0.0
    if spread == 0.0 or lower.mean() <= 0.0:
        return 0.0
    t = float(lower.mean()) / (spread / np.sqrt(n))
    return float(0.5 * n * np.log1p(t * t / (n - 1)))


def _errors(stage: Stage, model: Fitted) -> dict[str, Array]:
    """Errors of each recording in noise floors, (n, d).

    Held-out recordings are predicted by ``model``, each fold of the others by values that are fitted without it.
    """
    seen = stage.split.seen
    folds = min(FOLDS, len(seen))
    predicted = [(model.theta, r) for r in stage.split.held_out]
    for k in range(folds) if folds > 1 else ():
        theta = _without_fold(stage, model, k, folds)
        predicted += [(theta, r) for r in seen[k::folds]]
    problem = stage.problem
    return {r.name: (problem.measured(r) - problem.predict(theta[None], r)[0]) / stage.sigma for theta, r in predicted}


def _without_fold(stage: Stage, model: Fitted, fold: int, folds: int) -> Array:
    """The parameter vector with values fitted without a fold, begun at those of ``model`` and by the same criterion."""
    if not model.candidates:
        return model.theta
    kept = [r for k, r in enumerate(stage.split.seen) if k % folds != fold]
    data = Data(stage.problem, kept, stage.sigma, drifting=not stage.found.accumulates)
    return fit_candidates(data, stage.theta, model.candidates, [model.values]).theta
