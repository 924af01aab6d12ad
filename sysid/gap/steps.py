"""The gap workflow in steps, for a plant or for a user's simulator; :func:`sysid.gap.find_gap` runs them all.

>>> study = steps.open_study(dataset, simulator)
>>> steps.localise(study)            # error of each stage
>>> steps.candidates(study)          # effects that may be missing, and whether the recordings excite them
>>> study = steps.search(study)      # effects that explain the error
>>> proof = steps.prove(study)       # on held-out recordings; world=True: in the PyBullet world as well
>>> better = steps.add(study, proof)
>>> steps.promote(study, proof, registry, better.reference)  # of a stored repair, if the proof passes
>>> steps.next_experiment(study, proof)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

from sysid.datasets.checks.roles import is_pose_set
from sysid.errors import SettingsError
from sysid.files import plain
from sysid.gap import disagreement
from sysid.gap.adapters.adapter import SimulatorAdapter
from sysid.gap.adapters.simulator import Simulator
from sysid.gap.arm.sag import advice_on_sag, sagging_axis
from sysid.gap.disagreement import agreement, stage_gap, world_gap
from sysid.gap.excitation import advice, advice_on_tie, excitation_of
from sysid.gap.held_out import held_out_error
from sysid.gap.prepare.case import Case, Stage, excitation, held_out_of, open_case, stage_candidates
from sysid.gap.prepare.noise import floor_spread, run_floors
from sysid.gap.promotion import first_promotion, free_run_check, lineage_of, names_check, stages_check, world_check
from sysid.gap.proof import ProofOutcome, evaluate, with_carried
from sysid.gap.result import Check, Excitation, Gap, Promotion, StageGap, Traces, WorldGap
from sysid.gap.search_tasks import SearchTasks
from sysid.gap.stage_search import Forms
from sysid.gap.stages import search_stages
from sysid.gap.statement import Agreement, ResponseDifference, response_differences
from sysid.names import model_name
from sysid.plant import Plant, machine_difference, plant_from_files
from sysid.plant.uncertainty import NONE
from sysid.progress import Progress, silent
from sysid.registry import decide
from sysid.signals import axis_signal

if TYPE_CHECKING:
    from sysid.datasets.recording import Dataset
    from sysid.registry import ModelVersion, Registry

#: File in the version of a repaired plant: the change of ``machine.toml`` by the repair.
MACHINE_DIFF = "machine.diff"


@dataclass(frozen=True)
class Study:
    """A dataset against a simulation: the stages that are measured at both ends, with their results after the search.

    ``settings`` are those of the search.
    """

    case: Case
    stages: tuple[Stage, ...]
    settings: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ProposedEffect:
    """An effect that may be missing at a stage, with its form in ``label``, and whether the fit recordings excite it."""

    stage: str
    label: str
    excitation: Excitation


@dataclass(frozen=True)
class Proof:
    """Result of the search and its evaluation on held-out recordings.

    Args:
        outcome: named effects, ties, unnamed residuals, notes; ``outcome.repaired`` contains the effects.
        gap: RMSE of free runs by signal, before and after, and the noise floor.
        stage_gap: the same with each stage driven by its measured input.
        traces: measured, before and after for each held-out recording.
        agreement: of every signal, where it is the least.
        responses: figures of the recordings that the repaired simulation does not show.
        world: the gap in the PyBullet world, if requested.
    """

    outcome: ProofOutcome
    gap: Gap
    stage_gap: Gap
    traces: tuple[Traces, ...]
    agreement: tuple[Agreement, ...] = ()
    responses: tuple[ResponseDifference, ...] = ()
    world: WorldGap | None = None


def open_study(dataset: Dataset, simulation: Plant | Simulator, seed: int = 0) -> Study:
    """Split a dataset and a simulation into stages.

    Raises:
        ExcitationError: no stage is measured at both ends, or no recording to fit, to select or to hold out.
        InputError: a user's simulator failed, returned no table of signals, or is not deterministic.
    """
    case, stages = open_case(dataset, simulation, seed)
    return Study(case, tuple(stages))


def localise(study: Study) -> tuple[StageGap, ...]:
    """Error of every signal with its stage driven by measured input, and in the free run, with its noise floor."""
    case, stages = study.case, study.stages
    nominal = case.runner(case.plant)
    free = disagreement.run_rmse([(r, nominal(r)) for r in case.split.seen])
    recordings = {k: stage.split.seen for k, stage in enumerate(stages)}
    floors = {k: stage.sigma for k, stage in enumerate(stages)}
    return disagreement.localise([stage.problem for stage in stages], case.theta, recordings, floors, free)


def candidates(study: Study) -> tuple[ProposedEffect, ...]:
    """Effects that may be missing at each stage; those that the recordings do not excite are not named."""
    machine = study.case.plant.machine
    return tuple(
        ProposedEffect(stage.label, c.label, excitation_of(c, stage.split.seen, machine))
        for stage in study.stages
        for c in stage_candidates(study.case, stage)
    )


def search(study: Study, forms: Forms = "all", progress: Progress = silent, *, tasks: SearchTasks | None = None) -> Study:
    """Determine the missing effects stage by stage.

    Args:
        forms: "simple" tests every effect in its simplest form only.
        tasks: searches the stages in other processes, with the same result.
    """
    found = search_stages(study.case, study.stages, forms, progress, tasks)
    return replace(study, stages=found, settings={"forms": forms})


def prove(study: Study, world: bool = False, progress: Progress = silent, *, carry: bool = False) -> Proof:
    """Evaluate the result on held-out recordings; only the first evaluation is a proof.

    Args:
        world: run the held-out commands in the PyBullet world as well.
        carry: fit residual networks to unnamed residuals, where they help (:mod:`sysid.gap.unnamed.residual_model`).

    Raises:
        SettingsError: the study was not searched; residual networks were requested with a user's simulator.
    """
    outcome = decide_on(study)
    if carry:
        outcome = with_residual_networks(study, outcome, progress)
    proof = measure(study, outcome)
    return in_world(study, proof, progress) if world and study.case.adapter is None else proof


def decide_on(study: Study) -> ProofOutcome:
    """The effects that keep their names on held-out recordings, with intervals, and what remains without a name.

    Raises:
        SettingsError: the study was not searched.
    """
    if any(stage.result is None for stage in study.stages):
        raise SettingsError("prove", "stages that were not searched", "a study that sysid.gap.steps.search returned")
    return evaluate(study.case, study.stages)


def with_residual_networks(study: Study, outcome: ProofOutcome, progress: Progress = silent) -> ProofOutcome:
    """The outcome with residual networks for unnamed residuals, where they help.

    Raises:
        SettingsError: a user's simulator cannot hold one.
    """
    from sysid.gap.unnamed import residual_model  # loads torch

    return residual_model.fit_residual_models(study.case, study.stages, outcome, progress=progress)


def in_world(study: Study, proof: Proof, progress: Progress = silent) -> Proof:
    """The proof with the held-out commands run in the PyBullet world as well."""
    case = study.case
    return replace(
        proof,
        world=world_gap(case.plant, proof.outcome.repaired, case.split.held_out, proof.gap.noise_floor, progress),
    )


def measure(study: Study, outcome: ProofOutcome) -> Proof:
    """The gap on held-out recordings before and after the repair of ``outcome``."""
    case = study.case
    held_out, nominal, better = case.split.held_out, case.runner(case.plant), case.runner(outcome.repaired)
    before = [nominal(r) for r in held_out]
    after = [better(r) for r in held_out]
    pairs = [list(zip(held_out, runs, strict=True)) for runs in (before, after)]
    scores = [disagreement.run_rmse(runs) for runs in pairs]
    machine = case.plant.machine
    forces = [axis_signal(axis.name, "command") for axis in machine.axes if axis.actuation == "force"]
    whole, floors = run_floors(better, pairs[1], case.noise, case.seed, forces)
    scores.append(whole)
    shared = [signal for signal in scores[0] if all(signal in score for score in scores)]
    by_stage = with_carried(stage_gap(case, study.stages, outcome.repaired.vector()), outcome)
    free = Gap(*({signal: score[signal] for signal in shared} for score in scores))
    traces = tuple(Traces(r.name, r.table, b, a) for r, b, a in zip(held_out, before, after, strict=True))
    if is_pose_set(case.dataset):  # nothing is commanded: the run of a pose set is its end-effector stage
        free = by_stage
    free = _with_forces(free, by_stage)
    each = ([disagreement.run_rmse([run]) for run in runs] for runs in pairs)
    runs = list(zip((r.name for r in held_out), *each, floors, strict=True))
    moving = [(r, run) for r, run in pairs[1] if r.kind == "motion"]
    differences = response_differences([r for r, _ in moving], [run for _, run in moving], machine, case.dataset.units)
    return Proof(outcome, free, by_stage, traces, agreement(case, free, held_out_of(case), runs), differences)


def add(study: Study, proof: Proof, registry: Registry | None = None) -> Plant | SimulatorAdapter:
    """The repaired simulation: a plant, or the user's simulator with input and output effects, again a simulator.

    Args:
        registry: stores a repaired plant as a new version, with the plant under test in its lineage and the reference set. A
            user's simulator cannot be stored.

    Raises:
        SettingsError: a user's simulator is to be stored.
    """
    case, repaired = study.case, proof.outcome.repaired
    if case.adapter is not None:
        if registry is not None:
            raise SettingsError(
                f"simulator {case.adapter.name}",
                "cannot be stored",
                "no registry",
                "Keep the effects: sysid.plant.effects_toml.",
            )
        return replace(case.adapter, plant=repaired)
    if registry is None or repaired is case.plant:
        return repaired
    return replace(repaired, reference=store(study, proof, registry))


def next_experiment(study: Study, proof: Proof, shown: Sequence[Excitation] | None = None) -> tuple[str, ...]:
    """Recordings that would distinguish ties and excite effects that are not excited.

    Args:
        shown: excitation of every candidate, where it is known already.
    """
    machine = study.case.plant.machine
    sagging = [axis for tie in proof.outcome.ties if (axis := sagging_axis(tie, machine))]
    masses = [advice_on_sag(sagging)] if sagging else []
    ties = (advice_on_tie(tie, machine) for tie in proof.outcome.ties if not sagging_axis(tie, machine))
    known = shown if shown is not None else excitation(study.case, list(study.stages))
    lacking = (advice(e, machine) for e in known if not e.sufficient)
    return tuple(dict.fromkeys((*masses, *ties, *lacking)))  # the same for all effects of an axis that did not move


def store(study: Study, proof: Proof, registry: Registry) -> str:
    """Store the repaired plant as a version with its lineage: ``name@version``.

    It is not promoted yet. If no version of its name is, the plant under test is promoted, so that the name alone never refers
    to a repair that was not evaluated.
    """
    case, repaired = study.case, proof.outcome.repaired
    tested = register(case, case.plant, registry, {})
    if tested.partition("@")[0] == model_name(repaired.machine.name):
        first_promotion(registry, tested)
    evidence = {"plant": tested, **lineage_of(case, proof.outcome, proof.gap, proof.stage_gap, study.settings)}
    accepted = [asdict(item) for item in proof.outcome.carried if item.accepted]
    if accepted:
        evidence["carried"] = plain(accepted)
    return register(case, repaired, registry, evidence, machine_diff(study, proof))


def machine_diff(study: Study, proof: Proof) -> str:
    """The change of ``machine.toml`` by the repair, as a unified diff; empty without one."""
    repaired = proof.outcome.repaired
    if repaired is study.case.plant or study.case.adapter is not None:
        return ""
    described = replace(repaired.machine, convention=study.case.dataset.machine.convention)
    return machine_difference(replace(repaired, machine=described, effects=described.effects, uncertainty=NONE), repaired)


def promote(study: Study, proof: Proof, registry: Registry, version: str) -> Promotion:
    """Promote a stored repair if the proof passes (:mod:`sysid.gap.promotion`)."""
    until_now = registry.promoted(version.partition("@")[0])
    checks = _checks(study, proof, registry, version, until_now)
    return decide(registry, version, until_now, checks, {"by": "sysid gap", "dataset": study.case.dataset.reference})


def _checks(study: Study, proof: Proof, registry: Registry, version: str, until_now: ModelVersion | None) -> tuple[Check, ...]:
    case, outcome, units = study.case, proof.outcome, study.case.dataset.units
    named = {(e.name, e.target, e.side) for e in outcome.named}
    theta = outcome.repaired.vector()
    fallen = {
        stage.label: (held_out_error(stage, case.theta), held_out_error(stage, theta))
        for stage in study.stages
        if any(kept.candidate.key in named for kept in stage.found.named)
    }
    spread = floor_spread(case.runner(outcome.repaired), case.split.held_out, case.noise, case.seed)
    checks = [
        names_check(
            [f"{e.name} on {e.target}" for e in outcome.named],
            outcome.ties,
            [" of ".join(item.key) for item in outcome.repaired.residuals],
        ),
        stages_check(fallen),
        free_run_check(proof.gap, spread, units),
    ]
    if until_now is not None and until_now.reference != version:
        promoted = plant_from_files(registry.load(until_now.reference).files, until_now.reference)
        comparable = promoted.machine.axis_names == case.plant.machine.axis_names
        if comparable and promoted.to_files() != case.plant.to_files():
            run = case.runner(promoted)
            score = disagreement.run_rmse([(r, run(r)) for r in case.split.held_out])
            shared = {signal: value for signal, value in score.items() if signal in proof.gap.after}
            against = Gap(shared, proof.gap.after, proof.gap.noise_floor)
            checks.append(free_run_check(against, spread, units, "promoted until now", until_now.reference))
    return (*checks, world_check(proof.world, spread, units))


def register(case: Case, plant: Plant, registry: Registry, evidence: dict[str, Any], difference: str = "") -> str:
    """Register the plant as a version named after its machine; the same content is the same version."""
    if plant.reference:
        return plant.reference
    lineage = {"dataset": case.dataset.reference, "machine": plant.machine.name, **plant.origin, **evidence}
    beside = {MACHINE_DIFF: difference.encode("utf-8")} if difference else {}
    version = registry.register(model_name(plant.machine.name), "plant", {**plant.to_files(), **beside}, lineage, {})
    return f"{version.name}@{version.version}"


def _with_forces(gap: Gap, by_stage: Gap) -> Gap:
    """The gap with the forces of force axes, which have no free run: those of the stage at measured motion."""
    forces = [signal for signal in by_stage.before if signal.endswith(".command")]
    parts = ((getattr(gap, name), getattr(by_stage, name)) for name in ("before", "after", "noise_floor"))
    return Gap(*({**free, **{s: stage[s] for s in forces}} for free, stage in parts))
