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
from sysid.gap.comparison import equivalent_change, pays, pays_beside, typical_errors
from sysid.gap.data import Data
from sysid.gap.decision import BESIDE, LOST, ORDINARY
from sysid.gap.disagreement import stage_rmse
from sysid.gap.fit import fit_candidates
from sysid.gap.prepare.case import Stage
from sysid.gap.thresholds import EXPLAINED

Array = npt.NDArray[np.float64]


def distance_moved(stage: Stage, recordings: Sequence[Recording]) -> float:
    """Distance that the predicted output moves in a recording, mean over recordings and outputs, in noise floors."""
    moved = [np.nansum(np.abs(np.diff(stage.problem.predict(stage.theta[None], r)[0], axis=0)), axis=0) for r in recordings]
    return float(np.mean(np.array(moved) / stage.sigma))


def is_better(stage: Stage) -> bool:
    """Whether the whole stage gets better on held-out recordings and no signal worse by a tenth.

    Where they do not excite it, it is enough that no signal gets worse above its noise floor.
    """
    before = stage_rmse(stage.problem, stage.theta, stage.split.held_out)
    after = stage_rmse(stage.problem, stage.found.fit.theta, stage.split.held_out)
    there = ~np.isnan(before) & ~np.isnan(after)
    before, after, sigma = before[there], after[there], stage.sigma[there]
    if not there.any() or (after > EXPLAINED * np.maximum(before, sigma)).any():
        return False
    if float(np.sum((after / sigma) ** 2)) < float(np.sum((before / sigma) ** 2)):
        return True
    kept = (after <= np.maximum(before, EXPLAINED * sigma)).all()
    return bool(kept and not is_excited(stage, stage.theta, stage.found.fit.theta))


def is_excited(stage: Stage, without: Array, theta: Array) -> bool:
    """Whether held-out recordings excite the difference between a model ``theta`` and ``without`` an effect.

    The output has to change by more than the region of practical equivalence of :mod:`sysid.gap.decision`.
    """
    error = held_out_error(stage, theta)
    moved = [np.diff(stage.problem.predict(np.array([without, theta]), r), axis=0)[0] for r in stage.split.held_out]
    size = float(np.sqrt(np.nanmean((np.concatenate(moved) / stage.sigma) ** 2)))
    return held_out_error(stage, stage.theta) > EXPLAINED and size > equivalent_change(error)


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


Error = Callable[[Stage, Fitted], float]


# -- names that are not worth their price --------------------------------------------------------------------------------------


def without_cheap_names(stages: Sequence[Stage]) -> list[Stage]:
    """The stages; where formulas are wrong, without names that are not worth their price on recordings left out of the fit.

    A drive whose formulas seem right has to be worth it too where those of other drives of the machine are wrong. The price is
    doubled for effects within the error of the machine's other drives (docs/decisions/decision-rule.md). A drive whose name is
    rejected is wrong by its whole error, which counts for the other drives: repeated until none is.
    """
    known: dict[tuple[str, bytes], float] = {}

    def error(stage: Stage, model: Fitted) -> float:
        key = stage.label, model.theta.tobytes()
        if key not in known:
            known[key] = cross_validated_error(stage, model)
        return known[key]

    kept = list(stages)
    for _ in kept:
        typical = typical_errors([_formula_error(stage, error) for stage in kept])
        alike = [each * _distance(stage) if each > 0.0 else 0.0 for stage, each in zip(kept, typical, strict=True)]
        proven = _proven_together(kept, alike, error)
        checked = [_without_cheap_names_of(stage, each, error, proven) for stage, each in zip(kept, alike, strict=True)]
        if all(one is other for one, other in zip(kept, checked, strict=True)):
            break
        kept = checked
    return kept


def _proven_together(stages: Sequence[Stage], alike: Sequence[float], error: Error) -> frozenset[str]:
    """Labels of effects of the machine that are worth their price at all drives that show them together.

    A pump that limits the flow of four drives is one effect, and pays once. The intervals of its values have to share a value.
    """
    shown: dict[str, list[tuple[Stage, float]]] = {}
    for stage, each in zip(stages, alike, strict=True):
        for kept in stage.found.named:
            if kept.candidate.target == "machine" and stage.problem.integrates:
                shown.setdefault(kept.candidate.label, []).append((stage, each))
    return frozenset(
        label
        for label, drives in shown.items()
        if len(drives) > 1
        and _agree([stage for stage, _ in drives], label)
        and any(_pays_together(drives, label, which, error) for which in (0, -1))  # alone, or beside a further effect
    )


def _pays_together(drives: Sequence[tuple[Stage, float]], label: str, which: int, error: Error) -> bool:
    """Whether an effect is worth its price at several drives, each with its ``alike``; ``which`` of the comparisons of each."""
    before, after, beside = 0.0, 0.0, 0.0
    for stage, alike in drives:
        pairs = comparisons_without(stage, label)
        if not pairs:
            return False
        without, model = pairs[which]
        left = error(stage, model)
        before, after = before + error(stage, without) ** 2, after + left**2
        beside += max(left, alike) ** 2
    count = len(drives)
    return pays_beside(*(float(np.sqrt(each / count)) for each in (before, after, beside)))


def _agree(stages: Sequence[Stage], label: str) -> bool:
    """Whether the 95 % intervals of an effect's values at several drives share a value."""
    ends = []
    for stage in stages:
        limits = stage.found.deciding
        assert limits is not None
        candidate = next(kept.candidate for kept in stage.found.named if kept.candidate.label == label)
        ends.append(limits[stage.found.fit.rows_of(candidate)])
    table = np.array(ends)  # (drives, values, 2)
    return bool((table[:, :, 0].max(axis=0) <= table[:, :, 1].min(axis=0)).all())


def _without_cheap_names_of(stage: Stage, alike: float, error: Error, proven: frozenset[str]) -> Stage:
    """The stage without its cheap names.

    Args:
        alike: error of the machine's other drives over the distance of this one, in noise floors; 0 where it is not known.
        proven: labels of names that are worth their price at several drives together.
    """
    result, fitted = stage.found, stage.found.stage_fit
    if not result.named or fitted is None or (fitted.decision.exact and not (stage.problem.integrates and alike > 0.0)):
        return stage
    lost = dict[str, str]()
    for kept in result.named:
        if kept.candidate.label in proven:
            continue
        lacks = [_too_cheap(stage, *pair, alike, error) for pair in comparisons_without(stage, kept.candidate.label)]
        if all(lacks):
            lost[kept.candidate.label] = lacks[0]
    if not lost:
        return stage
    rest = [kept.candidate.label for kept in result.named if kept.candidate.label not in lost]
    if stage.problem.integrates and rest:
        others = (comparisons_without(stage, label)[0][0] for label in lost)
        before, *alone = (error(stage, each) for each in (stage.nominal, *others))
        if not all(pays(before, after, len(rest)) for after in alone):
            lost |= dict.fromkeys(rest, BESIDE)
    return replace(stage, result=result.without_names(lost))


def _too_cheap(stage: Stage, without: Fitted, model: Fitted, alike: float, error: Error) -> str:
    """Condition that a name fails by a comparison of sets without and with its effect; empty if it fails none.

    Args:
        alike: error of the machine's other drives over the distance of this one, in noise floors.
    """
    if stage.problem.integrates:
        before, after = error(stage, without), error(stage, model)
        if not pays(before, after):
            return LOST
        return "" if pays_beside(before, after, alike) else ORDINARY
    excited = is_excited(stage, without.theta, model.theta)
    return LOST if excited and not pays(held_out_error(stage, without.theta), held_out_error(stage, model.theta)) else ""


def comparisons_without(stage: Stage, label: str) -> list[tuple[Fitted, Fitted]]:
    """Pairs of sets without and with the effect ``label``; one of them has to prove its name.

    Where errors accumulate, sets of effects were compared by what they leave alone, and the names are tested alone. Effects
    that are adjusted beside them compensate for the formulas in the fitted recordings, which makes others worse, and take the
    place of the effect that is left out. They are also tested beside the one further effect that leaves least: values that the
    owner's plant has not exactly may hide it on the few held-out recordings.
    """
    result = stage.found
    if not stage.problem.integrates:
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


def _formula_error(stage: Stage, error: Error) -> float:
    """Error that a drive leaves beside its names, as a share of the distance it moves; zero where its formulas are right.

    Drives of one machine are built alike: the error of their formulas is exchangeable between them (Gelman et al., Bayesian
    Data Analysis, ch. 5), so that the others tell how far that of a drive may move its output.
    """
    if not stage.found.accumulates:
        return 0.0
    model = stage.found.fit if stage.found.named else stage.nominal
    return error(stage, model) / max(_distance(stage), 1e-300)


def _distance(stage: Stage) -> float:
    """Distance that the output moves in a recording, mean over all of them, in noise floors."""
    return distance_moved(stage, [*stage.split.seen, *stage.split.held_out])
