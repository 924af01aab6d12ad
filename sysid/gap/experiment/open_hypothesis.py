"""What stops the workflow: effects that tie, and effects that an unexplained stage may have and its recordings cannot show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.case import Case, Stage, stage_candidates
from sysid.gap.data import Data
from sysid.gap.decision import EXPLAINED
from sysid.gap.drift import Drift
from sysid.gap.excitation import excitation_of
from sysid.gap.experiment.experiment import EffectAt
from sysid.gap.experiment.information import Hypothesis, hypothesis, noise_of_bin
from sysid.gap.fit import Fit, fit_candidates
from sysid.gap.proof import Outcome
from sysid.gap.starts import starting_values
from sysid.plant import compile_plant

Array = npt.NDArray[np.float64]

#: More rivals than this are not told apart all at once: those that fit best are.
MOST_RIVALS = 4


@dataclass(frozen=True)
class Question:
    """Models at one stage of which the recordings do not say which is true.

    Args:
        models: at least two. For an effect that could not show: the model with the effect, then the one without.
        drifts: how each signal of the stage wanders if one of the models is true. Where an effect is missing it seems to wander
            more; with the effect it would not.
    """

    kind: Literal["tie", "excitation"]
    stage: Stage
    models: tuple[Hypothesis, ...]
    drifts: tuple[Drift, ...]

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        return tuple(model.candidate for model in self.models if model.candidate is not None)

    @property
    def effects(self) -> tuple[EffectAt, ...]:
        return tuple(EffectAt(c.effect.name, c.target) for c in self.candidates)

    @property
    def label(self) -> str:
        return " or ".join(f"{effect.name} on {effect.target}" for effect in self.effects)

    @property
    def pairs(self) -> tuple[tuple[Hypothesis, Hypothesis], ...]:
        """(true model, rival) to be told apart: nothing tells a simple effect from one that contains it, but its simplicity."""
        if self.kind == "excitation":
            return ((self.models[0], self.models[1]),)
        return tuple((a, b) for a in self.models for b in self.models if a is not b and not _within(a, b))


def questions_of(case: Case, stages: Sequence[Stage], outcome: Outcome) -> list[Question]:
    """The ties of the outcome, then what unexplained stages lack excitation for."""
    base = compile_plant(outcome.repaired).theta
    asked = []
    for stage in stages:
        if stage.finding is None:
            continue
        seen = Data(stage.problem, stage.split.seen, stage.sigma)
        for kept in stage.finding.named:
            tie = tuple((c.effect.name, c.target) for c in (kept.candidate, *kept.ties))
            if kept.ties and tie in outcome.ties:
                asked.append(tie_between(case, stage, base, kept.candidate, kept.ties[: MOST_RIVALS - 1], seen))
    for stage in stages:
        if stage.finding is not None and stage.finding.final_rmse > EXPLAINED:
            asked += _unseen(case, stage, base)
    return asked


def tie_between(case: Case, stage: Stage, base: Array, kept: Candidate, rivals: Sequence[Candidate], seen: Data) -> Question:
    """Which of ``kept``, an effect of the stage's final fit, and ``rivals`` it is; each rival is fitted in its place.

    Args:
        base: parameters of the repaired plant, (N,).
        seen: the recordings that the fit has seen.
    """
    fit = stage.found.fit
    models = [_model(base, kept, fit, seen, fit.drifts)]
    for rival in rivals:
        rest = tuple(c for c in fit.candidates if c is not kept and c.key != rival.key)
        candidates = (*rest, rival)
        refitted = fit_candidates(seen, case.theta, candidates, starting_values(candidates, (fit,), case.seed))
        # What the rival does without is absent, not what the plant was repaired with.
        models.append(_model(_as_in(base, case.theta, fit), rival, refitted, seen, fit.drifts))
    return Question("tie", stage, tuple(models), fit.drifts)


def _unseen(case: Case, stage: Stage, base: Array) -> list[Question]:
    fit = stage.found.fit
    used = {c.key for c in fit.candidates}
    seen = Data(stage.problem, stage.split.seen, stage.sigma)
    noise = noise_of_bin(stage.problem.rate(stage.split.seen[0]))
    calm = tuple(Drift(noise=noise, memory=drift.memory) for drift in fit.drifts)
    asked = []
    for candidate in stage_candidates(case, stage):
        if candidate.form is not candidate.effect.forms[0] or candidate.key in used:
            continue
        if excitation_of(candidate, stage.split.seen, case.plant.machine).sufficient:
            continue
        values = np.concatenate([fit.values, worth_seeing(candidate)])
        there = hypothesis(base, candidate, (*fit.unknowns, *candidate.unknowns), values, seen, calm)
        absent = hypothesis(base, None, fit.unknowns, fit.values, seen, calm)
        asked.append(Question("excitation", stage, (there, absent), calm))
    return asked


def worth_seeing(candidate: Candidate) -> Array:
    """A small size of the effect that is worth a name: its start next to nominal, at least five times the negligible, (k,)."""
    nominal = np.array([u.nominal for u in candidate.unknowns])
    sizes = np.array([u.negligible for u in candidate.unknowns])
    rows = [np.array(row) for row in candidate.starts]
    clear = [row for row in rows if np.max(np.abs(row - nominal) / sizes) >= 5.0]
    if clear:
        return min(clear, key=lambda row: float(np.max(np.abs(row - nominal) / sizes)))
    low, high = (np.array([u.bounds[k] for u in candidate.unknowns]) for k in (0, 1))
    up = nominal + 5.0 * sizes
    return np.clip(np.where(up <= high, up, nominal - 5.0 * sizes), low, high)


def _within(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether ``one`` is a special case of ``other``."""
    a, b = one.candidate, other.candidate
    assert a is not None
    assert b is not None
    return b.contains(a) or (a.key == b.key and len(one.unknowns) < len(other.unknowns))


def _model(base: Array, candidate: Candidate, fit: Fit, seen: Data, drifts: Sequence[Drift]) -> Hypothesis:
    return hypothesis(base, candidate, fit.unknowns, fit.values, seen, drifts)


def _as_in(base: Array, theta: Array, fit: Fit) -> Array:
    """``base`` with everything that ``fit`` changed as it is in ``theta``."""
    out = base.copy()
    for unknown in fit.unknowns:
        out[list(unknown.places)] = theta[list(unknown.places)]
    return out
