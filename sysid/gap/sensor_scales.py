"""Scale errors of the sensors of drives: the stages behind a drive identify them, and the drive confirms or contradicts them.

A sensor reads the same at every stage. A wrong scale changes the geometry behind the sensor and the speed of the drive in front
of it, where it looks like a gain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from sysid.effects import sensor_scale
from sysid.gap.candidates import Candidate
from sysid.gap.decision import NearMiss
from sysid.gap.fit import place
from sysid.gap.prepare.case import Stage
from sysid.gap.reasons import Reason
from sysid.gap.stage_result import StageResult
from sysid.gap.thresholds import as_little
from sysid.machine import EffectKey

#: Effect of the sensor of a drive that the static stages behind the drive identify.
SCALE = sensor_scale.EFFECT.name

#: A scale with the result that names it.
Found = tuple[StageResult, Candidate]
#: Search of a stage without some effects.
Search = Callable[[Stage, frozenset[EffectKey]], Stage]


def with_sensor_scales(stages: Sequence[Stage], search: Search) -> tuple[Stage, ...]:
    """The stages; drives are searched again with the scales that the stages behind them name.

    A scale that ties with another effect is in the repaired plant too, and must not be counted twice. A scale that its drive
    contradicts is not offered to the stages behind it, which are searched again without it.
    """
    scales = _named_behind(stages)
    again = [search(_with_scales(stage, scales), frozenset()) if _reads(stage, scales) else stage for stage in stages]
    refuted = _refuted(stages, again, scales)
    if not refuted:
        return tuple(again)
    behind = [_without(stage, search, refuted) for stage in stages]
    rest = _named_behind(behind)
    return tuple(search(_with_scales(stage, rest), frozenset()) if _reads(stage, rest) else stage for stage in behind)


def _named_behind(stages: Sequence[Stage]) -> list[Found]:
    behind = (stage.found for stage in stages if stage.problem.kind.static)
    return [(found, kept.candidate) for found in behind for kept in found.named if kept.candidate.effect.name == SCALE]


def _reads(stage: Stage, scales: Sequence[Found]) -> bool:
    """Whether a stage is that of a drive with one of the sensors."""
    return stage.problem.kind.commanded and any(scale.target in stage.problem.signals for _, scale in scales)


def _with_scales(drive: Stage, scales: Sequence[Found]) -> Stage:
    """A drive, not searched yet, with the scales of its sensor."""
    theta = drive.theta
    for found, scale in scales:
        if scale.target in drive.problem.signals:
            theta = place(theta, scale.unknowns, found.fit.values_of(scale)[None])[0]
    return replace(drive, theta=theta)


def _refuted(stages: Sequence[Stage], again: Sequence[Stage], scales: Sequence[Found]) -> frozenset[EffectKey]:
    """Scales that a drive contradicts; ``again``: the stages, drives with the scales."""
    contradicting = [drive for before, drive in zip(stages, again, strict=True) if _contradicts(before, drive)]
    return frozenset(scale.key for _, scale in scales for drive in contradicting if scale.target in drive.problem.signals)


def _contradicts(drive: Stage, scaled: Stage) -> bool:
    """Whether a drive needs more effects with the scale of its sensor than without, and is explained no better.

    Where the speed is right without it, the scale is possible only beside an effect that changes the true speed by its inverse:
    a coincidence, unless the owner's gain was identified with that sensor.
    """
    more = len(scaled.found.fit.candidates) > len(drive.found.fit.candidates)
    return more and as_little(drive.found.final_rmse, scaled.found.final_rmse)


def _without(stage: Stage, search: Search, refuted: frozenset[EffectKey]) -> Stage:
    """A stage that names a refuted scale, searched without it; the scale is a near miss."""
    before = stage.found
    lost = [kept.candidate for kept in before.named if kept.candidate.key in refuted]
    if not stage.problem.kind.static or not lost or before.stage_fit is None:
        return stage
    found, model = search(stage, refuted), before.stage_fit.decision.model
    result = found.found
    if result.stage_fit is None:
        return found
    misses = (NearMiss(c, model.values_of(c), model.deviations_of(c), Reason.REFUTED) for c in lost)
    decision = result.stage_fit.decision
    decision = replace(decision, near_misses=(*decision.near_misses, *misses))
    return replace(found, result=replace(result, stage_fit=replace(result.stage_fit, decision=decision)))
