"""Names that are not worth their price on recordings left out of the fit (docs/decisions/decision-rule.md)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from sysid.gap.cross_validation import Fitted, cross_validated_error
from sysid.gap.decision import BESIDE, LOST, ORDINARY
from sysid.gap.held_out import distance_moved, held_out_error, is_excited
from sysid.gap.prepare.case import Stage
from sysid.gap.price import pays, pays_beside, typical_errors

Error = Callable[[Stage, Fitted], float]


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
