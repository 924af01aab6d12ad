"""Servos that move one arm: the search of each is repeated beside what was found on the others.

An axis runs by itself beside the motion of the others as the plant has it between the samples. Where that is wrong, small
effects are adjusted in its place. The axes are therefore searched in turn, beside the plant with all that was found.

The mass of a link looks like a gain or an armature on one axis by itself. It is one value for all axes before the link: what
one of them names is put into the others, which are searched again. It stays if the arm needs no more effects with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from sysid.effects import link_mass_error
from sysid.gap.candidates import Candidate
from sysid.gap.data import Data
from sysid.gap.fit import place, spread_of
from sysid.gap.prepare.case import Case, Stage
from sysid.gap.problem import drive_problem
from sysid.gap.stage_result import StageResult
from sysid.gap.thresholds import EXPLAINED, Z
from sysid.machine import EffectKey
from sysid.plant import compile_plant

Array = npt.NDArray[np.float64]

#: Search of stages, and that of one without some effects.
SearchStages = Callable[[Sequence[Stage]], list[StageResult]]
Search = Callable[[Stage, frozenset[EffectKey]], Stage]


def beside_each_other(case: Case, stages: Sequence[Stage], search: SearchStages) -> list[Stage]:
    """The searched servos of an arm: in turn, that of the largest error first, each beside the plant with all found before.

    Those that named effects alone do not explain are searched again beside all that was found: their own effects move the
    others, too.
    """
    found, left, whole = list(stages), set(range(len(stages))), case.theta.copy()
    affected = set[int]()
    while left:
        for k in left:
            found[k] = _beside(case, found[k], whole)
        worst = max(sorted(left), key=lambda k: _error(found[k]))
        found[worst] = replace(found[worst], result=search([found[worst]])[0])
        theta = found[worst].found.fit.theta
        left.discard(worst)
        if not np.array_equal(theta, case.theta):
            whole = np.where(theta != case.theta, theta, whole)
            affected = set(range(len(stages))) - left
    moved = [_beside(case, stage, whole) for stage in found]
    unclear = [k for k in sorted(affected) if not _is_clear(moved[k].found)]
    for k, result in zip(unclear, search([moved[k] for k in unclear]) if unclear else [], strict=True):
        moved[k] = replace(moved[k], result=result)
    return [replace(s, result=replace(s.found, problem=s.problem)) for s in moved]


def _beside(case: Case, stage: Stage, theta: Array) -> Stage:
    """A stage whose axis runs beside the motion of the others by ``theta``."""
    better = replace(compile_plant(case.plant), theta=theta)
    return replace(stage, problem=drive_problem(better, case.plant.machine.axis(stage.problem.target)))


def _error(stage: Stage) -> float:
    """Error of the plant under test [noise floors]."""
    return spread_of(Data(stage.problem, stage.split.seen, stage.sigma).residuals(stage.theta[None]))


def _is_clear(result: StageResult) -> bool:
    """Whether named effects alone explain an axis."""
    exact = result.stage_fit is None or result.stage_fit.decision.exact
    return exact and not result.adjusted and not any(kept.ties for kept in result.named) and result.final_rmse <= EXPLAINED


def with_link_masses(stages: Sequence[Stage], search: Search) -> tuple[Stage, ...]:
    """The stages; from the tip to the base, axes that do not name a mass that another one names are searched again with it."""
    found = list(stages)
    chain = max((stage.problem.carried for stage in stages), key=len, default=())
    for link in reversed(chain):
        _settle(found, (link_mass_error.EFFECT.name, link, None), search)
    return tuple(found)


def _settle(stages: list[Stage], key: EffectKey, search: Search) -> None:
    """Decide on one mass, and replace the stages that it changes."""
    carrying = [k for k, stage in enumerate(stages) if key[1] in stage.problem.carried]
    naming = {k: mass for k in carrying if (mass := _named(stages[k].found, key)) is not None}
    if not naming:
        return
    owner = min(naming, key=lambda k: _deviation(stages[k].found, naming[k]))
    agreeing = {k for k, mass in naming.items() if _agree(stages[owner].found, naming[owner], stages[k].found, mass)}
    value = stages[owner].found.fit.values_of(naming[owner])
    others = [k for k in carrying if k not in agreeing]
    tried = {}
    for k in others:
        theta = place(stages[k].theta, naming[owner].unknowns, value[None])[0]
        tried[k] = search(replace(stages[k], theta=theta), frozenset((key,)))
    if any(_needs(tried[k].found) > _needs(stages[k].found) for k in others):
        without = {k: search(stages[k], frozenset((key,))) for k in naming}
        heavier = 1 + sum(_needs(stages[k].found) - 1 for k in agreeing) + sum(_needs(tried[k].found) for k in others)
        if sum(_needs(without.get(k, stages[k]).found) for k in carrying) < heavier:
            tried = without
    for k, stage in tried.items():
        stages[k] = stage


def _named(result: StageResult, key: EffectKey) -> Candidate | None:
    return next((kept.candidate for kept in result.named if kept.candidate.key == key and not kept.ties), None)


def _deviation(result: StageResult, mass: Candidate) -> float:
    """Standard deviation of the ratio of a mass."""
    assert result.stage_fit is not None
    return float(result.stage_fit.decision.model.deviations_of(mass)[0])


def _agree(one: StageResult, mass: Candidate, other: StageResult, same: Candidate) -> bool:
    """Whether two axes determine the same mass."""
    apart = abs(float(one.fit.values_of(mass)[0] - other.fit.values_of(same)[0]))
    spread = math.hypot(_deviation(one, mass), _deviation(other, same))
    return apart <= max(2.0 * Z * spread, mass.unknowns[0].negligible)


def _needs(result: StageResult) -> int:
    """Effects of an axis, and what they leave."""
    return len(result.fit.candidates) + (result.final_rmse > EXPLAINED)
