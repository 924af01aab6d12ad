"""Open hypotheses: effects that are not identifiable, and effects of an unexplained stage that its recordings do not excite."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.data import Data
from sysid.gap.drift import DriftStrength
from sysid.gap.excitation import excitation_of
from sysid.gap.experiment.experiment import EffectAt
from sysid.gap.experiment.information import PlausibleModel, noise_of_bin, plausible_model
from sysid.gap.fit import Fit, fit_candidates, starting_values
from sysid.gap.prepare.case import Case, Stage, stage_candidates
from sysid.gap.problem import FORCES
from sysid.gap.proof import ProofOutcome
from sysid.gap.thresholds import EXPLAINED
from sysid.plant import compile_plant

Array = npt.NDArray[np.float64]

#: Largest number of models in one open hypothesis; those that fit best are used.
MAX_ALTERNATIVES = 4


@dataclass(frozen=True)
class OpenHypothesis:
    """Models of one stage among which the recordings do not decide.

    Args:
        models: at least two. For an effect that is not excited: the model with the effect, then the model without it.
        drifts: drift of each signal of the stage if one of the models is true. It is overestimated where an effect is missing.
    """

    kind: Literal["tie", "excitation"]
    stage: Stage
    models: tuple[PlausibleModel, ...]
    drifts: tuple[DriftStrength, ...]

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
    def pairs(self) -> tuple[tuple[PlausibleModel, PlausibleModel], ...]:
        """(true model, alternative) to be discriminated; no data reject an alternative that contains the true model."""
        if self.kind == "excitation":
            return ((self.models[0], self.models[1]),)
        return tuple((a, b) for a in self.models for b in self.models if a is not b and not _within(a, b))


def open_hypotheses(case: Case, stages: Sequence[Stage], outcome: ProofOutcome) -> list[OpenHypothesis]:
    """The non-identifiable sets of the outcome, then the effects that unexplained stages may have and do not excite."""
    model = compile_plant(outcome.repaired)
    base = model.theta
    if model.rigid is not None:  # motions are planned for one axis; the forces of an arm depend on all of them
        stages = [stage for stage in stages if stage.problem.stage not in FORCES]
    found = []
    for stage in stages:
        if stage.result is None:
            continue
        seen = Data(stage.problem, stage.split.seen, stage.sigma)
        for kept in stage.result.named:
            tie = tuple((c.effect.name, c.target) for c in (kept.candidate, *kept.ties))
            if kept.ties and tie in outcome.ties:
                found.append(non_identifiable_set(case, stage, base, kept.candidate, kept.ties[: MAX_ALTERNATIVES - 1], seen))
    for stage in stages:
        if stage.result is not None and stage.result.nominal_rmse > EXPLAINED:
            found += _unexcited(case, stage, base)
    return found


def non_identifiable_set(
    case: Case, stage: Stage, base: Array, kept: Candidate, alternatives: Sequence[Candidate], seen: Data
) -> OpenHypothesis:
    """``kept``, an effect of the final fit of the stage, against ``alternatives``, each fitted in its place.

    Args:
        base: parameters of the repaired plant, (N,).
        seen: the recordings that the fit has seen.
    """
    fit = stage.found.fit
    models = [_model(base, kept, fit, seen, fit.drifts)]
    for alternative in alternatives:
        rest = tuple(c for c in fit.candidates if c is not kept and c.key != alternative.key)
        candidates = (*rest, alternative)
        refitted = fit_candidates(seen, case.theta, candidates, starting_values(candidates, (fit,), case.seed))
        # Effects that the alternative does not need are absent, not those of the repaired plant.
        models.append(_model(_as_in(base, case.theta, fit), alternative, refitted, seen, fit.drifts))
    return OpenHypothesis("tie", stage, tuple(models), fit.drifts)


def _unexcited(case: Case, stage: Stage, base: Array) -> list[OpenHypothesis]:
    """Effects that the recordings do not excite enough, those among them that are adjusted in the plant: there, or absent."""
    seen = Data(stage.problem, stage.split.seen, stage.sigma)
    fit = stage.found.fit
    excited = tuple(c for c in fit.candidates if excitation_of(c, stage.split.seen, case.plant.machine).sufficient)
    if len(excited) < len(fit.candidates):
        base = _as_in(base, case.theta, fit)
        start = np.concatenate([np.empty(0), *(fit.values_of(c) for c in excited)])
        fit = fit_candidates(seen, stage.theta, excited, [start])
    elif stage.found.final_rmse <= EXPLAINED:
        return []
    used = {c.key for c in fit.candidates}
    noise = noise_of_bin(stage.problem.rate(stage.split.seen[0]))
    calm = tuple(DriftStrength(noise=noise, memory=drift.memory) for drift in fit.drifts)
    found = []
    for candidate in stage_candidates(case, stage):
        if candidate.form is not candidate.effect.forms[0] or candidate.key in used:
            continue
        if excitation_of(candidate, stage.split.seen, case.plant.machine).sufficient:
            continue
        values = np.concatenate([fit.values, relevant_size(candidate)])
        there = plausible_model(base, candidate, (*fit.unknowns, *candidate.unknowns), values, seen, calm)
        absent = plausible_model(base, None, fit.unknowns, fit.values, seen, calm)
        found.append(OpenHypothesis("excitation", stage, (there, absent), calm))
    return found


def relevant_size(candidate: Candidate) -> Array:
    """A small relevant size of the effect: its start value nearest to nominal, at least five times negligible, (k,)."""
    nominal = np.array([u.nominal for u in candidate.unknowns])
    sizes = np.array([u.negligible for u in candidate.unknowns])
    rows = [np.array(row) for row in candidate.starts]
    clear = [row for row in rows if np.max(np.abs(row - nominal) / sizes) >= 5.0]
    if clear:
        return min(clear, key=lambda row: float(np.max(np.abs(row - nominal) / sizes)))
    low, high = (np.array([u.bounds[k] for u in candidate.unknowns]) for k in (0, 1))
    up = nominal + 5.0 * sizes
    return np.clip(np.where(up <= high, up, nominal - 5.0 * sizes), low, high)


def _within(one: PlausibleModel, other: PlausibleModel) -> bool:
    """Whether ``one`` is a special case of ``other``."""
    a, b = one.candidate, other.candidate
    assert a is not None
    assert b is not None
    return b.contains(a) or b.extends(a)


def _model(base: Array, candidate: Candidate, fit: Fit, seen: Data, drifts: Sequence[DriftStrength]) -> PlausibleModel:
    return plausible_model(base, candidate, fit.unknowns, fit.values, seen, drifts)


def _as_in(base: Array, theta: Array, fit: Fit) -> Array:
    """``base`` with all parameters of ``fit`` set to their values in ``theta``."""
    out = base.copy()
    for unknown in fit.unknowns:
        out[list(unknown.places)] = theta[list(unknown.places)]
    return out
