"""The gap workflow: localise → candidates → select → prove. One call on a dataset version and a plant version."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset
from sysid.errors import ExcitationError
from sysid.gap.candidates import Candidate, as_nuisance, candidates_at
from sysid.gap.excitation import advice, excitation_of
from sysid.gap.fit import Data, Fit, fit_candidates
from sysid.gap.floor import problem_floor, run_floor
from sysid.gap.intervals import intervals
from sysid.gap.localise import localise, run_rmse, stage_rmse
from sysid.gap.noise import noise_levels
from sysid.gap.problem import ForceProblem, Problem, Split, TipProblem, pose_split, problems_of, split_of
from sysid.gap.remainder import describe_remainder
from sysid.gap.result import (
    Alternative,
    Excitation,
    Gap,
    GapResult,
    NamedEffect,
    Traces,
    Unnamed,
    Value,
    Verdict,
)
from sysid.gap.result import Candidate as EvidenceRow
from sysid.gap.search import Finding, Kept, Search, Strictness
from sysid.plant import Plant, compile_plant, free_run

if TYPE_CHECKING:
    from sysid.registry import Registry

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

#: A stage that stays above this multiple of its noise floor has structure that nothing explains.
UNEXPLAINED = 1.5


@dataclass(frozen=True)
class _Stage:
    """What the workflow knows about one problem while it works."""

    problem: Problem
    split: Split
    sigma: Array
    excitation: tuple[Excitation, ...]
    finding: Finding | None = None


def find_gap(
    dataset: Dataset,
    plant: Plant,
    registry: Registry | None = None,
    *,
    add: bool = False,
    localise_only: bool = False,
    forms: Literal["all", "simple"] = "all",
    progress: Progress | None = None,
    strict: Strictness | None = None,
    seed: int = 0,
) -> GapResult:
    """Find where ``plant`` and the recordings disagree, name the missing effects, and prove it on held-out recordings.

    Args:
        registry: where plant versions live; without it none is written.
        add: write the repaired plant as a new version.
        localise_only: stop after localising.
        forms: "simple" tries every effect in its simplest form only, e.g. one friction for both directions.
        progress: called with (share done, text).

    Raises:
        ExcitationError: no stage is measured at both ends, or there is nothing to hold out.
    """
    begin = time.perf_counter()
    tell: Progress = progress or (lambda done, text: None)
    model = compile_plant(plant)
    theta = model.theta
    split = split_of(dataset)
    problems = problems_of(model, dataset)
    if not problems:
        raise ExcitationError(dataset.reference, "no stage is measured at both its ends", "commands and the motion they cause")
    if not split.fit or not split.select or not split.held_out:
        raise ExcitationError(dataset.reference, "too few recordings", "some to fit, to select and to hold out")
    noise = noise_levels(dataset)
    stages = [_stage(p, dataset, split, theta, noise, plant, seed) for p in problems]

    tell(0.02, "localising")
    free = run_rmse([(r, free_run(plant, r)) for r in split.seen])
    located = localise(
        problems, theta, {k: s.split.seen for k, s in enumerate(stages)}, {k: s.sigma for k, s in enumerate(stages)}, free
    )
    reference = _register(registry, plant, dataset, {}) if registry is not None else plant.reference or "nominal"
    if localise_only:
        before = run_rmse([(r, free_run(plant, r)) for r in split.held_out])
        nothing = Gap(before, before, run_floor(lambda r: free_run(plant, r), split.held_out, noise, seed))
        seconds = time.perf_counter() - begin
        return GapResult(
            dataset.reference, reference, "", "no_gap", (), (), (), (), nothing, nothing,
            tuple(e for s in stages for e in s.excitation), tuple(r.name for r in split.held_out), seconds, located,
        )  # fmt: skip

    for k, stage in enumerate(stages):
        label = f"{stage.problem.stage} stage of {stage.problem.target}"
        share = 0.05 + 0.8 * k / len(stages)
        stages[k] = replace(
            stage, finding=_search(stage, plant, theta, strict or Strictness(), seed, tell, share, label, forms)
        )

    tell(0.87, "proving on held-out recordings")
    return _conclude(dataset, plant, registry, add, stages, located, noise, theta, reference, seed, begin, tell)


def _stage(
    problem: Problem, dataset: Dataset, split: Split, theta: Array, noise: dict[str, float], plant: Plant, seed: int
) -> _Stage:
    if isinstance(problem, TipProblem):
        poses = pose_split(dataset)
        split = Split(
            (*split.fit, *poses.fit), (*split.select, *poses.select), (*split.held_out, *poses.held_out)
        )  # static poses show kinematics best
    sigma = problem_floor(problem, theta, split.fit, noise, seed)
    return _Stage(problem, split, np.maximum(sigma, 1e-12), ())


def _search(
    stage: _Stage,
    plant: Plant,
    theta: Array,
    strict: Strictness,
    seed: int,
    tell: Progress,
    share: float,
    label: str,
    forms: str,
) -> Finding:
    problem = stage.problem
    force = 1.0
    if isinstance(problem, ForceProblem):
        force = float(np.median(np.abs(np.concatenate([problem.measured(r)[:, 0] for r in stage.split.fit]))))
    everything = candidates_at(plant, theta, problem.stage, problem.targets, force)
    if forms == "simple":
        everything = [c for c in everything if c.form is c.effect.forms[0]]
    sufficient = [c for c in everything if excitation_of(c, stage.split.fit, plant.machine).sufficient]
    nuisances = [as_nuisance(c) for c in sufficient if c.effect.name in problem.nuisances]
    tell(share, label)
    return Search(
        problem, theta, stage.split, stage.sigma, sufficient, nuisances, strict, seed,
        on_fit=lambda text: tell(share, f"{label}: {text}"),
    ).run()  # fmt: skip


def _conclude(
    dataset: Dataset,
    plant: Plant,
    registry: Registry | None,
    add: bool,
    stages: list[_Stage],
    located: tuple[Any, ...],
    noise: dict[str, float],
    theta: Array,
    reference: str,
    seed: int,
    begin: float,
    tell: Progress,
) -> GapResult:
    split = split_of(dataset)
    named: list[NamedEffect] = []
    unnamed: list[Unnamed] = []
    ties: list[tuple[tuple[str, str], ...]] = []
    notes: list[str] = []
    evidence: list[EvidenceRow] = []
    repaired = plant
    for stage in stages:
        finding = stage.finding
        assert finding is not None
        problem = stage.problem
        evidence += [
            EvidenceRow(
                problem.stage, problem.target, t.effects, t.parameters, t.fit_rmse, t.selection_rmse, t.delta_bic, t.verdict
            )
            for t in finding.trials
        ]
        proven = _proven(stage, theta)
        if finding.named and not proven:
            notes.append(f"{problem.stage} stage of {problem.target}: what was found did not help on held-out recordings")
        elif finding.fit.candidates:
            limits = intervals(Data(problem, stage.split.seen, stage.sigma), theta, finding.fit)
            for kept in finding.named:
                instance = kept.candidate.instance(finding.fit.values_of(kept.candidate))
                repaired = repaired.with_effect(instance)
                if kept.ties:
                    tie = tuple((c.effect.name, c.target) for c in (kept.candidate, *kept.ties))
                    ties.append(tie)
                    shown = ", ".join(f"{k} = {v}" for k, v in instance.parameters.items())
                    notes.append(f"{instance.name} on {instance.target} stands in the plant for {len(tie)} that tie: {shown}")
                else:
                    named.append(_named(stage, kept, theta, limits))
            for candidate in finding.adjusted:
                values = finding.fit.values_of(candidate)
                repaired = repaired.with_effect(candidate.instance(values))
                shown = ", ".join(f"{u.key} = {v:.4g}" for u, v in zip(candidate.unknowns, values, strict=True))
                notes.append(
                    f"{candidate.effect.name} on {candidate.target} adjusted, too small or too poorly shown for a name: {shown}"
                )
        level = finding.final_rmse if proven else finding.nominal_rmse
        if level > UNEXPLAINED:
            fit = finding.fit if proven else Fit((), (), np.empty(0), theta, (), 0.0, True)
            unnamed += describe_remainder(problem, fit, stage.split.seen, plant.machine)

    lacking = [e for e in _excitation(stages, plant) if not e.sufficient]
    before, after = ([(r, free_run(p, r)) for r in split.held_out] for p in (plant, repaired))
    floor = run_floor(lambda r: free_run(repaired, r), split.held_out, noise, seed)
    tell(0.94, "noise floor")
    stage_gap = _stage_gap(stages, theta, compile_plant(repaired).theta, noise, seed)
    gap = _gap(run_rmse(before), run_rmse(after), floor)
    verdict = _verdict(named, ties, unnamed, lacking, stages)
    changed = repaired is not plant
    after_reference = ""
    if add and changed and registry is not None:
        evidence_of = {
            "dataset": dataset.reference, "dataset_digest": dataset.digest, "plant": reference, "seed": seed,
            "named": [f"{e.name}({e.target})" for e in named], "notes": notes,
        }  # fmt: skip
        after_reference = _register(registry, repaired, dataset, evidence_of)
    tell(1.0, "done")
    return GapResult(
        dataset=dataset.reference,
        plant_before=reference,
        plant_after=after_reference,
        verdict=verdict,
        effects=tuple(named),
        unnamed=tuple(unnamed),
        ambiguous=tuple(ties),
        next_experiment=tuple(advice(e) for e in lacking) if verdict != "no_gap" else (),
        gap=gap,
        stage_gap=stage_gap,
        excitation=tuple(_excitation(stages, plant)),
        held_out_recordings=tuple(r.name for r in split.held_out),
        seconds=time.perf_counter() - begin,
        localised=located,
        candidates=tuple(evidence),
        traces=tuple(Traces(r.name, r.table, b, a) for (r, b), (_, a) in zip(before, after, strict=True)),
        notes=tuple(notes),
        settings={"seed": seed, "noise": noise},
    )


def _proven(stage: _Stage, theta: Array) -> bool:
    """Whether what was found predicts held-out recordings better than the questioned plant, looked at once."""
    finding = stage.finding
    assert finding is not None
    if not finding.fit.candidates:
        return True
    nominal = stage_rmse(stage.problem, theta, stage.split.held_out) / stage.sigma
    final = stage_rmse(stage.problem, finding.fit.theta, stage.split.held_out) / stage.sigma
    return bool(np.sqrt(np.nanmean(final**2)) < 0.98 * np.sqrt(np.nanmean(nominal**2)))


def _named(stage: _Stage, kept: Kept, theta: Array, limits: Array) -> NamedEffect:
    finding = stage.finding
    assert finding is not None
    candidate, fit = kept.candidate, finding.fit
    values = fit.values_of(candidate)
    at = next(k for k, u in enumerate(fit.unknowns) if u is candidate.unknowns[0])
    parameters: dict[str, Value] = {}
    interval: dict[str, tuple[Any, Any]] = {}
    k = 0
    for parameter in candidate.form.parameters:
        width = len(parameter.components)
        part = [float(v) for v in values[k : k + width]]
        ends = limits[at + k : at + k + width]
        parameters[parameter.name] = part[0] if width == 1 else tuple(part)
        low, high = ends[:, 0].tolist(), ends[:, 1].tolist()
        interval[parameter.name] = (low[0], high[0]) if width == 1 else (tuple(low), tuple(high))
        k += width
    return NamedEffect(
        candidate.effect.name,
        candidate.target,
        parameters,
        interval,
        _share(stage, candidate, theta),
        tuple(Alternative(c.effect.name, c.target, why) for c, why in kept.rejected),
        side=candidate.side,
    )


def _share(stage: _Stage, candidate: Candidate, theta: Array) -> float:
    """Closed share of the held-out stage gap that is lost when the effect is dropped and the rest refitted."""
    finding = stage.finding
    assert finding is not None
    rest = tuple(c for c in finding.fit.candidates if c is not candidate)
    start = np.concatenate([finding.fit.values_of(c) for c in rest]) if rest else np.empty(0)
    dropped = fit_candidates(Data(stage.problem, stage.split.seen, stage.sigma), theta, rest, [start])

    def score(vector: Array) -> float:
        return float(np.sqrt(np.nanmean((stage_rmse(stage.problem, vector, stage.split.held_out) / stage.sigma) ** 2)))

    closable = score(theta) - 1.0
    return float(np.clip((score(dropped.theta) - score(finding.fit.theta)) / closable, 0.0, 1.0)) if closable > 0 else 0.0


def _gap(before: dict[str, float], after: dict[str, float], floor: dict[str, float]) -> Gap:
    shared = [signal for signal in before if signal in after and signal in floor]
    return Gap(*({s: values[s] for s in shared} for values in (before, after, floor)))


def _stage_gap(stages: Sequence[_Stage], theta: Array, repaired: Array, noise: dict[str, float], seed: int) -> Gap:
    """RMSE of every stage driven by its measured input, on held-out recordings."""
    before: dict[str, float] = {}
    after: dict[str, float] = {}
    floor: dict[str, float] = {}
    for stage in stages:
        held_out = stage.split.held_out
        for values, scores in (
            (before, stage_rmse(stage.problem, theta, held_out)),
            (after, stage_rmse(stage.problem, repaired, held_out)),
            (floor, problem_floor(stage.problem, repaired, held_out, noise, seed)),
        ):
            values.update(zip(stage.problem.signals, map(float, scores), strict=True))
    return Gap(before, after, floor)


def _excitation(stages: Sequence[_Stage], plant: Plant) -> list[Excitation]:
    found = {}
    for stage in stages:
        for candidate in candidates_at(plant, plant.vector(), stage.problem.stage, stage.problem.targets):
            found[candidate.key] = excitation_of(candidate, stage.split.seen, plant.machine)
    return list(found.values())


def _verdict(
    named: Sequence[object],
    ties: Sequence[object],
    unnamed: Sequence[object],
    lacking: Sequence[Excitation],
    stages: Sequence[_Stage],
) -> Verdict:
    if named:
        return "named"
    if ties:
        return "ambiguous"
    if unnamed:
        return "unnamed"
    above = {
        t for s in stages if s.finding is not None and s.finding.nominal_rmse > Strictness().gap for t in s.problem.targets
    }
    return "insufficient_excitation" if any(e.target in above for e in lacking) else "no_gap"


def _register(registry: Registry, plant: Plant, dataset: Dataset, evidence: dict[str, Any]) -> str:
    """The plant as a version named after its machine; the same content is the same version."""
    if plant.reference:
        return plant.reference
    lineage = {"dataset": dataset.reference, "machine": plant.machine.name, **plant.origin, **evidence}
    version = registry.register(plant.machine.name, "plant", plant.to_files(), lineage, {})
    return f"{version.name}@{version.version}"
