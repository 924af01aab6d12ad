"""Names that are not worth their price on held-out recordings (docs/decisions/decision-rule.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from sysid.gap.case import Stage
from sysid.gap.decision import BESIDE, LOST, ORDINARY
from sysid.gap.held_out import distance_moved, held_out_error, is_excited, relative_error
from sysid.gap.price import pays, pays_beside, typical_errors

Array = npt.NDArray[np.float64]


def without_cheap_names(stages: Sequence[Stage]) -> list[Stage]:
    """The stages; where formulas are wrong, without names that held-out recordings excite and that are not worth their price.

    The price is doubled for effects within the error of the machine's other drives (docs/decisions/decision-rule.md). A drive
    whose name is rejected is wrong by its whole error, which counts for the other drives: repeated until none is.
    """
    kept = list(stages)
    for _ in kept:
        typical = typical_errors([_formula_error(stage) for stage in kept])
        checked = [_without_cheap_names_of(stage, error) for stage, error in zip(kept, typical, strict=True)]
        if all(one is other for one, other in zip(kept, checked, strict=True)):
            break
        kept = checked
    return kept


def _without_cheap_names_of(stage: Stage, typical: float) -> Stage:
    """The stage without its cheap names; ``typical``: error of the machine's other drives, as a share of the distance moved."""
    result, fitted = stage.found, stage.found.stage_fit
    if not result.named or fitted is None or fitted.decision.exact:
        return stage
    lost = dict[str, str]()
    for kept in result.named:
        lacks = [_too_cheap(stage, less, theta, typical) for less, theta in comparisons_without(stage, kept.candidate.label)]
        if all(lacks):
            lost[kept.candidate.label] = lacks[0]
    if not lost:
        return stage
    rest = [kept.candidate.label for kept in result.named if kept.candidate.label not in lost]
    if fitted.decision.accumulates and rest:
        others = (comparisons_without(stage, label)[0][0] for label in lost)
        before, *alone = (held_out_error(stage, theta) for theta in (stage.theta, *others))
        if not all(pays(before, after, len(rest)) for after in alone):
            lost |= dict.fromkeys(rest, BESIDE)
    named = tuple(kept for kept in result.named if kept.candidate.label not in lost)
    adjusted = (*result.adjusted, *(kept.candidate for kept in result.named if kept.candidate.label in lost))
    unsure = replace(fitted, decision=fitted.decision.without_names(lost))
    return replace(stage, result=replace(result, named=named, adjusted=adjusted, stage_fit=unsure))


def _too_cheap(stage: Stage, without: Array, theta: Array, typical: float) -> str:
    """Condition that a name fails by a comparison of parameter vectors without and with its effect; empty if it fails none."""
    accumulates = stage.found.accumulates
    excited = is_excited(stage, without, theta)
    if not excited and not accumulates:
        return ""
    recordings = stage.split.held_out if excited else stage.split.seen
    before, after = (relative_error(stage, each, recordings) for each in (without, theta))
    if excited and not pays(before, after):
        return LOST
    return "" if pays_beside(before, after, typical * distance_moved(stage, recordings) if accumulates else 0.0) else ORDINARY


def comparisons_without(stage: Stage, label: str) -> list[tuple[Array, Array]]:
    """Pairs of parameter vectors without and with the effect ``label``; one of them has to prove its name.

    Where errors accumulate, sets of effects were compared by what they leave alone, and the names are tested alone. Effects
    that are adjusted beside them compensate for the formulas in the fitted recordings, which makes others worse, and take the
    place of the effect that is left out. They are also tested beside the one further effect that leaves least: values that the
    owner's plant has not exactly may hide it on the few held-out recordings.
    """
    result = stage.found
    if not result.accumulates:
        return [(stage.theta, result.fit.theta)]
    pairs = []
    for found in (result.names_alone, result):
        if found is not None and found.stage_fit is not None and label in found.stage_fit.dropped:
            pairs.append((found.stage_fit.dropped[label].theta, found.fit.theta))
            break
    beside = result.stage_fit.beside if result.stage_fit is not None else None
    if beside is not None and label in beside[1]:
        pairs.append((beside[1][label].theta, beside[0].theta))
    return pairs


def _formula_error(stage: Stage) -> float:
    """Error that a drive leaves beside its names, as a share of the distance it moves; zero where its formulas are right.

    Drives of one machine are built alike: the error of their formulas is exchangeable between them (Gelman et al., Bayesian
    Data Analysis, ch. 5), so that the others tell how far that of a drive may move its output.
    """
    if not stage.found.accumulates:
        return 0.0
    theta = stage.found.fit.theta if stage.found.named else stage.theta
    return held_out_error(stage, theta) / max(distance_moved(stage, stage.split.held_out), 1e-300)
