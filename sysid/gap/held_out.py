"""Errors of a stage on recordings left out of the fit, in noise floors, and names that are not worth their price there.

Errors of a free run accumulate: a recording of a minute contains few independent ones, and a single held-out recording hardly
tells by how much an effect reduces them. Cross-validation predicts each part of the others as well (Hastie, Tibshirani,
Friedman, 2nd ed., section 7.10). The rule is in docs/decisions/decision-rule.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.candidates import Candidate
from sysid.gap.comparison import equivalent_change, pays
from sysid.gap.data import Data
from sysid.gap.disagreement import stage_rmse
from sysid.gap.fit import fit_candidates
from sysid.gap.prepare.case import Stage
from sysid.gap.reasons import Reason
from sysid.gap.thresholds import TENTH, at_floor

Array = npt.NDArray[np.float64]


def is_better(stage: Stage) -> bool:
    """Whether the whole stage gets better on held-out recordings and no signal worse by a tenth.

    Where they do not excite it, it is enough that no signal gets worse above its noise floor.
    """
    before = stage_rmse(stage.problem, stage.theta, stage.split.held_out)
    after = stage_rmse(stage.problem, stage.found.fit.theta, stage.split.held_out)
    there = ~np.isnan(before) & ~np.isnan(after)
    before, after, sigma = before[there], after[there], stage.sigma[there]
    if not there.any() or (after > TENTH * np.maximum(before, sigma)).any():
        return False
    if float(np.sum((after / sigma) ** 2)) < float(np.sum((before / sigma) ** 2)):
        return True
    kept = (after <= np.maximum(before, TENTH * sigma)).all()
    return bool(kept and not is_excited(stage, stage.theta, stage.found.fit.theta))


def is_excited(stage: Stage, without: Array, theta: Array) -> bool:
    """Whether held-out recordings excite the difference between a model ``theta`` and ``without`` an effect.

    The output has to change by more than the region of practical equivalence of :mod:`sysid.gap.decision`.
    """
    error = held_out_error(stage, theta)
    moved = [np.diff(stage.problem.predict(np.array([without, theta]), r), axis=0)[0] for r in stage.split.held_out]
    size = float(np.sqrt(np.nanmean((np.concatenate(moved) / stage.sigma) ** 2)))
    return not at_floor(held_out_error(stage, stage.theta)) and size > equivalent_change(error)


def held_out_error(stage: Stage, theta: Array) -> float:
    """Held-out RMSE of the stage in noise floors."""
    return relative_error(stage, theta, stage.split.held_out)


def relative_error(stage: Stage, theta: Array, recordings: Sequence[Recording]) -> float:
    """RMSE of the stage in recordings, in noise floors."""
    return float(np.sqrt(np.nanmean((stage_rmse(stage.problem, theta, recordings) / stage.sigma) ** 2)))


# -- cross-validation ----------------------------------------------------------------------------------------------------------

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
    return {r.name: problem.residual(theta, r) / stage.sigma for theta, r in predicted}


def _without_fold(stage: Stage, model: Fitted, fold: int, folds: int) -> Array:
    """The parameter vector with values fitted without a fold, begun at those of ``model`` and by the same criterion."""
    if not model.candidates:
        return model.theta
    kept = [r for k, r in enumerate(stage.split.seen) if k % folds != fold]
    data = Data(stage.problem, kept, stage.sigma)
    return fit_candidates(data, stage.theta, model.candidates, [model.values]).theta


# -- names that are not worth their price --------------------------------------------------------------------------------------


def without_cheap_names(stage: Stage) -> Stage:
    """The stage; where formulas are wrong, without names that are not worth their price on recordings left out of the fit."""
    result, fitted = stage.found, stage.found.stage_fit
    if not result.named or fitted is None or fitted.decision.exact:
        return stage
    known: dict[bytes, float] = {}

    def error(model: Fitted) -> float:
        key = model.theta.tobytes()
        if key not in known:
            known[key] = cross_validated_error(stage, model)
        return known[key]

    lost = dict[str, Reason]()
    for kept in result.named:
        if not any(_pays(stage, *pair, error) for pair in comparisons_without(stage, kept.candidate.label)):
            lost[kept.candidate.label] = Reason.LOST
    if not lost:
        return stage
    rest = [kept.candidate.label for kept in result.named if kept.candidate.label not in lost]
    if result.accumulates and rest:
        others = (comparisons_without(stage, label)[0][0] for label in lost)
        before, *alone = (error(each) for each in (stage.nominal, *others))
        if not all(pays(before, after, len(rest)) for after in alone):
            lost |= dict.fromkeys(rest, Reason.LOST)
    return replace(stage, result=result.without_names(lost))


def _pays(stage: Stage, without: Fitted, model: Fitted, error: Callable[[Fitted], float]) -> bool:
    """Whether a name is worth its price, by sets without and with its effect; ``error``: by cross-validation."""
    if stage.found.accumulates:
        return pays(error(without), error(model))
    excited = is_excited(stage, without.theta, model.theta)
    return not excited or pays(held_out_error(stage, without.theta), held_out_error(stage, model.theta))


def comparisons_without(stage: Stage, label: str) -> list[tuple[Fitted, Fitted]]:
    """Pairs of sets without and with the effect ``label``; one of them has to prove its name.

    Where errors accumulate, sets of effects were compared by what they leave alone, and the names are tested alone. Effects
    that are adjusted beside them compensate for the formulas in the fitted recordings, which makes others worse, and take the
    place of the effect that is left out. They are also tested beside the one further effect that leaves least: values that the
    owner's plant has not exactly may hide it on the few held-out recordings.
    """
    result = stage.found
    if not result.accumulates:
        return [(stage.nominal, result.fit)]
    pairs: list[tuple[Fitted, Fitted]] = []
    for found in (result.names_alone, result):
        if found is not None and found.stage_fit is not None and label in found.stage_fit.dropped:
            pairs.append((found.stage_fit.dropped[label], found.fit))
            break
    beside = result.stage_fit.beside if result.stage_fit is not None else None
    if beside is not None and label in beside[1]:
        pairs.append((beside[1][label], beside[0]))
    return pairs
