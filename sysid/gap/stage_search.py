"""The search of one stage: its candidates, fits and decision, and what other stages or the masses of an arm forbid to name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.stats import norm

from sysid.effects import clock_offset, inertia_error, input_delay, load_bias
from sysid.gap.alternatives import search_alternatives
from sysid.gap.arm.link_rows import CERTAIN
from sysid.gap.arm.link_stage import fit_links_stage, links_adjusted
from sysid.gap.arm.pose_folds import FoldValues, are_folds, fold_of
from sysid.gap.arm.pose_stage import fit_pose_stage
from sysid.gap.arm.posture import posture_share
from sysid.gap.candidates import Candidate, adjusted_link
from sysid.gap.comparison import difference
from sysid.gap.data import Data, SearchInput
from sysid.gap.excitation import excitation_of
from sysid.gap.fit import Fit, fit_candidates, spread_of
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.prepare.case import Case, Stage, on_itself, stage_candidates
from sysid.gap.prepare.clocks import open_offset
from sysid.gap.problem import Problem
from sysid.gap.reasons import Reason
from sysid.gap.result import ComparedModel, EffectEvidence
from sysid.gap.sensor_scales import SCALE
from sysid.gap.stage_kind import LINKS, POSES
from sysid.gap.stage_model import StageFit, search_stage
from sysid.gap.stage_result import AcceptedEffect, StageResult
from sysid.gap.thresholds import as_little
from sysid.machine import EffectKey
from sysid.plant import compile_plant
from sysid.progress import Progress

Array = npt.NDArray[np.float64]

#: Standard deviation of an error of timing between input and output, in samples of the log: the uncertainty of sample-and-hold.
#: Where the order of command and sample is stated, there is none between a command and its motion.
TIMING = 0.5
#: Fits of a stage with an error, in the mean: 51 to 81 on a servo arm and an excavator.
TYPICAL_FITS = 70

Forms = Literal["all", "simple"]


class FitCount:
    """Progress of a stage by its fits. Their number is not known before; it is similar for all stages."""

    def __init__(self, progress: Progress, label: str) -> None:
        self.progress, self.label, self.count = progress, label, 0

    def __call__(self, text: str) -> None:
        self.count += 1
        done = self.count / TYPICAL_FITS
        share = 0.9 * done if done < 1.0 else 1.0 - 0.1 / done
        self.progress(share, f"{self.label}: {text}")


def find_stage(
    case: Case, stage: Stage, forms: Forms, progress: Progress, refuted: frozenset[EffectKey] = frozenset()
) -> StageResult:
    """The result of a stage; ``refuted``: effects that another stage contradicts, which are not offered."""
    progress(0.0, stage.label)
    machine = case.plant.machine
    problem = stage.problem if case.adapter is None else case.adapter.search_problem(stage.problem)
    seen = Data(problem, stage.split.seen, stage.sigma)
    nominal = spread_of(seen.residuals(stage.theta[None]))
    if problem.kind.agrees(nominal):
        progress(1.0, stage.label)
        return StageResult(problem, (), (), _fit(seen, (), stage.theta), nominal, nominal)
    offered = (c for c in stage_candidates(case, stage) if c.key not in refuted)
    candidates = [c for c in offered if forms == "all" or c.form is c.effect.forms[0]]
    nameable = [c.label for c in candidates if excitation_of(c, stage.split.seen, machine).sufficient]
    search = {LINKS: _found_in_links, POSES: _found_in_poses}.get(problem.kind, _found_in_motion)
    count = FitCount(progress, stage.label)
    result = search(
        case, stage, SearchInput(compile_plant(case.plant), seen, stage.theta, candidates, nameable, count), nominal
    )
    progress(1.0, stage.label)
    return result if problem is stage.problem else on_itself(result, stage, stage.theta)


def _found_in_motion(case: Case, stage: Stage, given: SearchInput, nominal: float) -> StageResult:
    """The result of a stage whose formulas may be wrong: beside a discrepancy."""
    seen, candidates = given.seen, given.candidates
    kind, equivalence = seen.problem.kind, _equivalence(case, candidates)
    stated = case.order is not None and case.order.source == "stated" and kind.commanded
    timing = 0.0 if stated else TIMING / stage.split.seen[0].rate_hz
    shared = [c.label for c in candidates if kind.static and c.key in _scales_of_drives(case)]

    def search(some: Sequence[Candidate]) -> StageFit:
        return search_stage(replace(given, candidates=some), timing).decided(equivalence, shared)

    fitted = search_alternatives(seen, given.theta, candidates, search)
    if kind.is_force:
        fitted = _beside_links(case, stage, _without_masses(case, stage, fitted))
    return _result(seen.problem, seen, _adjusted_to_free_run(seen, fitted), nominal)


def _found_in_links(case: Case, stage: Stage, given: SearchInput, nominal: float) -> StageResult:
    """The result of the links of an arm; errors of their inertial parameters are adjusted without a name."""
    result = _result(stage.problem, given.seen, fit_links_stage(given), nominal)
    off = [adjusted_link(case.plant, stage.theta, name) for name in links_adjusted(given.model, result.fit.theta, stage.theta)]
    unknowns = (*result.fit.unknowns, *(u for c in off for u in c.unknowns))
    values = np.array([*result.fit.values, *(result.fit.theta[u.places[0]] for c in off for u in c.unknowns)])
    fit = replace(result.fit, candidates=(*result.fit.candidates, *off), unknowns=unknowns, values=values)
    return replace(result, fit=fit, adjusted=(*result.adjusted, *off))


def _beside_links(case: Case, stage: Stage, fitted: StageFit) -> StageFit:
    """The fit without names for what adjusted links may cause: torques determine the sum of both.

    That is the inertia of a rotor, and a constant load where the links' own is as uncertain.
    """
    axis, model, chosen = stage.problem.target, compile_plant(case.plant), fitted.decision.model
    if model.rigid is None or axis not in links_adjusted(model, stage.theta, case.theta):
        return fitted
    lacks = {c.label: Reason.LINKS for c in chosen.candidates if c.effect is inertia_error.EFFECT}
    loads = [c for c in chosen.candidates if c.effect is load_bias.EFFECT]
    lacks |= {c.label: Reason.LINKS for c in loads if abs(chosen.values_of(c)[0]) < CERTAIN * stage.open_load}
    return replace(fitted, decision=fitted.decision.without_names(lacks)) if lacks else fitted


def _without_masses(case: Case, stage: Stage, fitted: StageFit) -> StageFit:
    """The fit without names that the weight of links with unknown masses could cause."""
    if compile_plant(case.plant).rigid is not None:
        return fitted
    machine, problem = case.plant.machine, stage.problem
    share = posture_share(problem, machine, stage.split.seen, float(stage.sigma[0]), case.dataset.units)
    if share is None or not share.dominates:
        return fitted
    lacks = {c.label: Reason.WEIGHT for c in fitted.decision.model.candidates}
    return replace(fitted, decision=fitted.decision.without_names(lacks), cause=Reason.WEIGHT)


def _adjusted_to_free_run(seen: Data, fitted: StageFit) -> StageFit:
    """The fit with values of least squares over the free run for effects without a name, where these leave a tenth less.

    Where formulas are wrong, the likelihood explains a part of the error by a discrepancy and by errors of timing, which the
    plant has not; a name keeps its likeliest value, what is only adjusted serves the prediction. Where errors accumulate, all
    values are those of least squares already.
    """
    decision, model = fitted.decision, fitted.decision.model
    known = {c.label for c in (*decision.named, *(tie[0] for tie in decision.tied))}
    rest = [c for c in model.candidates if c.label not in known]
    if decision.exact or decision.accumulates or not rest:
        return fitted
    begin = np.concatenate([model.values_of(c) for c in rest])
    fit = fit_candidates(seen, model.theta, rest, [begin])
    before, after = (spread_of(seen.residuals(theta[None])) for theta in (model.theta, fit.theta))
    if as_little(before, after):
        return fitted
    values = model.values.copy()
    for candidate in rest:
        values[model.rows_of(candidate)] = fit.values_of(candidate)
    adjusted = replace(model, values=values, theta=fit.theta, left=after)
    return replace(fitted, decision=replace(decision, model=adjusted))


def _found_in_poses(case: Case, stage: Stage, given: SearchInput, nominal: float) -> StageResult:
    """The result of static poses; with folds, each fold is predicted by a search without it."""
    problem, whole = given.seen.problem, fit_pose_stage(given)
    result = _result(problem, given.seen, whole, nominal)
    if not are_folds(stage.split.fit, stage.split.held_out):
        return result
    folds = dict.fromkeys(fold_of(r) for r in stage.split.fit)
    kept = {k: replace(given.seen, recordings=[r for r in stage.split.fit if fold_of(r) != k]) for k in folds}
    parts = {k: fit_pose_stage(replace(given, seen=seen)) for k, seen in kept.items()}
    known = [(whole.decision.model.theta, {k: part.decision.model.theta for k, part in parts.items()})]
    if whole.framed is not None:
        known.append((whole.framed.theta, {k: part.framed.theta for k, part in parts.items() if part.framed is not None}))
    for label, less in whole.dropped.items():
        by_fold = {k: part.dropped.get(label, part.decision.model).theta for k, part in parts.items()}
        known.append((less.theta, by_fold))
    return replace(result, problem=replace(problem, predict=FoldValues(known, problem.predict).predict))


def _scales_of_drives(case: Case) -> set[EffectKey]:
    """Scales of the sensors of driven signals: at a later stage they would change the result of the drive's stage."""
    return {(SCALE, axis.driven, None) for axis in case.plant.machine.axes}


def _equivalence(case: Case, candidates: Sequence[Candidate]) -> dict[EffectKey, float]:
    """Least half-widths of regions of equivalence, of clock offsets and dead times."""
    found: dict[EffectKey, float] = {}
    for candidate in candidates:
        if candidate.effect is input_delay.EFFECT and case.order is not None:
            found[candidate.key] = case.order.open_s
        elif candidate.effect is clock_offset.EFFECT:
            found[candidate.key] = open_offset(case.dataset, candidate.target)
    return found


def _result(problem: Problem, seen: Data, fitted: StageFit, nominal: float) -> StageResult:
    decision = fitted.decision
    fit = _fit(seen, decision.model.candidates, decision.model.theta, decision.model)
    final = spread_of(seen.residuals(fit.theta[None]))
    kept = [AcceptedEffect(c, _evidence(c, fitted), _rejected(c, fitted)) for c in decision.named]
    kept += [AcceptedEffect(tie[0], _evidence(tie[0], fitted), (), tie[1:]) for tie in decision.tied]
    taken = {k.candidate.label for k in kept}
    adjusted = tuple(c for c in decision.model.candidates if c.label not in taken)
    alone = _result(problem, seen, fitted.names_alone, nominal) if fitted.names_alone is not None else None
    return StageResult(problem, tuple(kept), adjusted, fit, nominal, final, _compared(problem, fitted), fitted, alone)


def _fit(seen: Data, candidates: Sequence[Candidate], theta: Array, model: ModelFit | None = None) -> Fit:
    values = model.values if model is not None else np.empty(0)
    unknowns = model.unknowns if model is not None else ()
    return Fit(tuple(candidates), tuple(unknowns), values, theta, seen.log_likelihood(theta))


def _evidence(candidate: Candidate, fitted: StageFit) -> EffectEvidence:
    model, less = fitted.decision.model, fitted.dropped[candidate.label]
    total, error = difference(model, less)
    ratio = less.rms / max(model.rms, 1e-12)
    p_value = max(
        float(norm.sf(total / max(error, 1e-9))), 0.5 ** len(model.predictive)
    )  # at least the probability that all blocks agree by chance
    return EffectEvidence(2.0 * (model.evidence - less.evidence), total, p_value, ratio)


def _rejected(candidate: Candidate, fitted: StageFit) -> tuple[tuple[Candidate, str], ...]:
    """Other effects in its place, and the predictive density that they lose."""
    model = fitted.decision.model
    rest = {c.key for c in model.candidates} - {candidate.key}
    found: dict[EffectKey, tuple[Candidate, str]] = {}
    for f in fitted.models:
        others = [c for c in f.candidates if c.key not in rest]
        if len(others) == 1 and others[0].key != candidate.key and rest <= {c.key for c in f.candidates}:
            total, error = difference(model, f)
            found.setdefault(others[0].key, (others[0], f"predicts {total:.0f} ± {error:.0f} nats worse"))
    return tuple(found.values())


def _compared(problem: Problem, fitted: StageFit) -> tuple[ComparedModel, ...]:
    """The forty likeliest models against the chosen one."""
    decision, rows = fitted.decision, []
    for f in fitted.models[:40]:
        keys = (f"{c.label}.{u.key}" for c in f.candidates for u in c.unknowns)
        total, error = difference(decision.model, f)
        verdict = "survives" if any(f is s for s in decision.survivors) else f"{total:.0f} ± {error:.0f} nats worse"
        values = dict(zip(keys, map(float, f.values), strict=True))
        delta_bic = 2.0 * (f.evidence - decision.model.evidence)
        labels = tuple(sorted(f.labels))
        rows.append(ComparedModel(problem.stage, problem.target, labels, values, f.rms, f.rms, delta_bic, verdict))
    return tuple(rows)
