"""The gap workflow: localise → candidates → select → prove. One call on a dataset version and a plant version."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError
from sysid.gap.candidates import as_nuisance
from sysid.gap.case import Case, Stage, excitation, on_itself, open_case, stage_candidates
from sysid.gap.excitation import advice, advice_on_tie, excitation_of
from sysid.gap.experiment import Planning, Proposal, propose, questions_of
from sysid.gap.floor import run_floor
from sysid.gap.localise import localise, run_rmse
from sysid.gap.maps import maps_of
from sysid.gap.prove import Outcome, judge, stage_gap
from sysid.gap.result import Candidate, Excitation, Gap, GapResult, Localised, Map, Traces, Verdict
from sysid.gap.search import Finding, Search, Strictness
from sysid.gap.shares import shares_of
from sysid.gap.simulator import Simulator, name_of
from sysid.plant import Plant, compile_plant

if TYPE_CHECKING:
    from sysid.datasets.recording import Dataset
    from sysid.progress import Progress
    from sysid.registry import Registry

Array = npt.NDArray[np.float64]
Forms = Literal["all", "simple"]


def find_gap(
    dataset: Dataset,
    plant: Plant | Simulator,
    registry: Registry | None = None,
    *,
    add: bool = False,
    localise_only: bool = False,
    forms: Forms = "all",
    progress: Progress | None = None,
    strict: Strictness | None = None,
    planning: Planning | None = None,
    seed: int = 0,
) -> GapResult:
    """Find where ``plant`` and the recordings disagree, name the missing effects, and prove it on held-out recordings.

    Args:
        plant: a plant, or a simulator of one's own: what is named then acts in front of it or behind it.
        registry: where plant versions live; without it none is written.
        add: write the repaired plant as a new version.
        localise_only: stop after localising; the verdict is then ``unnamed`` wherever a stage is above its noise floor.
        forms: "simple" tries every effect in its simplest form only, e.g. one friction for both directions.
        planning: plan the recordings that would answer what these leave open (not around a simulator of one's own); by default
            they are only described.
        progress: called with (share done, text).

    Raises:
        ExcitationError: no stage is measured at both ends, or there is nothing to hold out.
        InputError: a simulator of one's own failed, or returned no table of signals.
        SettingsError: what is found around such a simulator is to be added to the registry.
    """
    begin = time.perf_counter()
    tell: Progress = progress or (lambda done, text: None)
    strict = strict or Strictness()
    if add and not isinstance(plant, Plant):
        raise SettingsError(
            f"simulator {name_of(plant)}", "cannot be stored", "a plant", "Take what is repaired from sysid.gap.steps.add."
        )
    case, stages = open_case(dataset, plant, seed)
    tell(0.02, "localising")
    located = _localise(case, stages)
    stored = registry is not None and case.around is None
    reference = _register(case, case.plant, registry, {}) if registry is not None and stored else case.reference
    outcome, proposal = Outcome(case.plant), Proposal()
    after_reference = ""
    if not localise_only:
        for k, stage in enumerate(stages):
            stages[k] = replace(stage, finding=_search(case, stage, strict, forms, tell, 0.05 + 0.8 * k / len(stages)))
        tell(0.87, "proving on held-out recordings")
        outcome = judge(case, stages)
        if add and outcome.repaired is not case.plant and registry is not None:
            after_reference = _register(case, outcome.repaired, registry, _evidence(case, reference, outcome))
        if planning is not None and case.around is None:
            tell(0.9, "planning the next experiment")
            questions = questions_of(case, stages, outcome, strict)
            proposal = propose(case, outcome.repaired, questions, planning, lambda text: tell(0.9, f"planning: {text}"))
    tell(0.93, "noise floor")
    shown = excitation(case, stages)
    verdict = _verdict(outcome, located, shown, strict, localise_only)
    gap, traces = _free_gap(case, outcome.repaired)
    better = compile_plant(outcome.repaired).theta
    by_stage = stage_gap(case, stages, better)
    tell(1.0, "done")
    return GapResult(
        dataset=dataset.reference,
        plant_before=reference,
        plant_after=after_reference,
        verdict=verdict,
        effects=tuple(outcome.named),
        unnamed=tuple(outcome.unnamed),
        ambiguous=tuple(outcome.ties),
        next_experiment=() if verdict == "no_gap" else _next_experiment(outcome, shown),
        gap=_with_forces(gap, by_stage),
        stage_gap=by_stage,
        excitation=shown,
        held_out_recordings=tuple(r.name for r in case.split.held_out),
        seconds=time.perf_counter() - begin,
        localised=located,
        shares=shares_of(compile_plant(case.plant), case.split.seen) if case.around is None else (),
        maps=_maps(case, stages, better if outcome.repaired is not case.plant else None),
        candidates=tuple(row for stage in stages if stage.finding for row in _rows(stage, stage.finding)),
        traces=traces,
        notes=(
            *outcome.notes,
            *proposal.notes,
            *(case.around.notes([s.problem for s in stages]) if case.around is not None else ()),
        ),
        experiments=proposal.experiments,
        settings={"seed": seed, "forms": forms, "noise": dict(case.noise), "localise_only": localise_only},
    )


def _localise(case: Case, stages: Sequence[Stage]) -> tuple[Localised, ...]:
    nominal = case.runner(case.plant)
    free = run_rmse([(r, nominal(r)) for r in case.split.seen])
    recordings = {k: stage.split.seen for k, stage in enumerate(stages)}
    floors = {k: stage.sigma for k, stage in enumerate(stages)}
    return localise([stage.problem for stage in stages], case.theta, recordings, floors, free)


def _maps(case: Case, stages: Sequence[Stage], repaired: Array | None) -> tuple[Map, ...]:
    """Over the recordings that may be seen, stage by stage."""
    machine, units = case.plant.machine, case.dataset.units
    of_stages = (maps_of(s.problem, case.theta, s.split.seen, s.sigma, machine, units, repaired) for s in stages)
    return tuple(item for maps in of_stages for item in maps)


def _search(case: Case, stage: Stage, strict: Strictness, forms: Forms, tell: Progress, share: float) -> Finding:
    tell(share, stage.label)
    candidates = [
        c
        for c in stage_candidates(case, stage)
        if (forms == "all" or c.form is c.effect.forms[0]) and excitation_of(c, stage.split.fit, case.plant.machine).sufficient
    ]
    nuisances = [as_nuisance(c) for c in candidates if c.effect.name in stage.problem.nuisances]
    problem = stage.problem if case.around is None else case.around.to_search(stage.problem)
    search = Search(
        problem, case.theta, stage.split, stage.sigma, candidates, nuisances, strict, case.seed,
        on_fit=lambda text: tell(share, f"{stage.label}: {text}"),
    )  # fmt: skip
    finding = search.run()
    return finding if problem is stage.problem else on_itself(finding, stage, case.theta)


def _free_gap(case: Case, repaired: Plant) -> tuple[Gap, tuple[Traces, ...]]:
    """The whole chain, free-running on held-out recordings, before and after."""
    held_out = case.split.held_out
    nominal, better = case.runner(case.plant), case.runner(repaired)
    before = [nominal(r) for r in held_out]
    after = [better(r) for r in held_out]
    scores = [run_rmse(list(zip(held_out, runs, strict=True))) for runs in (before, after)]
    scores.append(run_floor(better, held_out, case.noise, case.seed))
    shared = [signal for signal in scores[0] if all(signal in score for score in scores)]
    gap = Gap(*({signal: score[signal] for signal in shared} for score in scores))
    return gap, tuple(Traces(r.name, r.table, b, a) for r, b, a in zip(held_out, before, after, strict=True))


def _with_forces(gap: Gap, by_stage: Gap) -> Gap:
    """The force of a force axis has no free run: what the model needs at measured motion stands in the gap as well."""
    forces = [signal for signal in by_stage.before if signal.endswith(".command")]
    parts = ((getattr(gap, part), getattr(by_stage, part)) for part in ("before", "after", "noise_floor"))
    return Gap(*({**free, **{s: stage[s] for s in forces}} for free, stage in parts))


def _rows(stage: Stage, finding: Finding) -> list[Candidate]:
    where = stage.problem.stage, stage.problem.target
    return [
        Candidate(*where, t.effects, t.parameters, t.fit_rmse, t.selection_rmse, t.delta_bic, t.verdict) for t in finding.trials
    ]


def _next_experiment(outcome: Outcome, shown: Sequence[Excitation]) -> tuple[str, ...]:
    return (*(advice_on_tie(tie) for tie in outcome.ties), *(advice(e) for e in shown if not e.sufficient))


def _verdict(
    outcome: Outcome, located: Sequence[Localised], shown: Sequence[Excitation], strict: Strictness, localise_only: bool
) -> Verdict:
    if outcome.named:
        return "named"
    if outcome.ties:
        return "ambiguous"
    above = {item.target for item in located if item.stage_rmse > strict.gap * item.noise_floor}
    if outcome.unnamed or (localise_only and above):
        return "unnamed"
    return "insufficient_excitation" if any(e.target in above and not e.sufficient for e in shown) else "no_gap"


def _evidence(case: Case, reference: str, outcome: Outcome) -> dict[str, Any]:
    """What a repaired plant version remembers of how it came about."""
    return {
        "dataset_digest": case.dataset.digest,
        "plant": reference,
        "seed": case.seed,
        "named": [f"{e.name}({e.target})" for e in outcome.named],
        "notes": list(outcome.notes),
    }


def _register(case: Case, plant: Plant, registry: Registry, evidence: dict[str, Any]) -> str:
    """The plant as a version named after its machine; the same content is the same version."""
    if plant.reference:
        return plant.reference
    lineage = {"dataset": case.dataset.reference, "machine": plant.machine.name, **plant.origin, **evidence}
    version = registry.register(plant.machine.name, "plant", plant.to_files(), lineage, {})
    return f"{version.name}@{version.version}"
