"""The gap workflow in one call: localise → candidates → select → prove."""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError
from sysid.gap import steps
from sysid.gap.adapters.simulator import Simulator, name_of
from sysid.gap.case import Case, Stage, excitation, force_comparisons, held_out_of, untested_forces
from sysid.gap.experiment import ExperimentProposal, Planning, open_hypotheses, propose
from sysid.gap.headline import left_out_sentence
from sysid.gap.maps import maps_of
from sysid.gap.proof import ProofOutcome
from sysid.gap.result import Excitation, GapResult, Map, StageGap, Verdict
from sysid.gap.shares import shares_of
from sysid.gap.stage_search import Forms
from sysid.gap.tasks.search import SearchTasks
from sysid.gap.thresholds import EXPLAINED
from sysid.gap.written import axis_delays, with_units, written_effects
from sysid.plant import Plant, compile_plant
from sysid.plant.cache import is_compiled
from sysid.progress import Progress, part, silent

if TYPE_CHECKING:
    from sysid.datasets.recording import Dataset
    from sysid.registry import Registry

Array = npt.NDArray[np.float64]


def find_gap(
    dataset: Dataset,
    plant: Plant | Simulator,
    registry: Registry | None = None,
    *,
    add: bool = False,
    world: bool | None = None,
    localise_only: bool = False,
    carry: bool = False,
    forms: Forms = "all",
    progress: Progress | None = None,
    planning: Planning | None = None,
    seed: int = 0,
    tasks: SearchTasks | None = None,
) -> GapResult:
    """Find where ``plant`` and the recordings disagree, name the missing effects, and prove them on held-out recordings.

    Args:
        plant: a plant, or a user's simulator, for which input and output effects are named.
        registry: stores plant versions; without it none is written.
        add: write the repaired plant as a new version, and promote it if the proof passes.
        world: prove it in the PyBullet world as well; by default if it is added.
        localise_only: stop after localising; the verdict is then ``unnamed`` if a stage is above its noise floor.
        carry: fit bounded residual networks to unnamed residuals, accepted where they lower held-out errors. They are trained
            on the recordings, are not physics, and are not listed among the effects (:mod:`sysid.gap.unnamed.residual_model`).
        forms: "simple" tests every effect in its simplest form only, e.g. one friction for both directions.
        planning: plan recordings that would resolve open hypotheses (not for a user's simulator); by default they are only
            described.
        progress: called with (share done, text).
        tasks: searches the stages of a plant in other processes, which open the dataset and the plant from the workspace of
            ``registry``; by default in threads of this one. The result is the same.

    Raises:
        ExcitationError: no stage is measured at both ends, or no recording to fit, to select or to hold out.
        InputError: a user's simulator failed, or returned no table of signals.
        SettingsError: a repaired user's simulator is to be added to the registry, or to contain a residual network; ``tasks``
            without a registry.
        TaskError: the workers of ``tasks`` were lost.
    """
    if tasks is not None and registry is None:
        raise SettingsError(
            "find_gap", "tasks without a registry", "the registry of the workspace, from which tasks load the plant"
        )
    begin = time.perf_counter()
    report: Progress = progress or silent
    if add and not isinstance(plant, Plant):
        raise SettingsError(
            f"simulator {name_of(plant)}", "cannot be stored", "a plant", "Get the repaired simulator from sysid.gap.steps.add."
        )
    if carry and not isinstance(plant, Plant):
        raise SettingsError(f"simulator {name_of(plant)}", "cannot hold a residual network", "a plant")
    if carry and localise_only:
        raise SettingsError(
            "find_gap", "carry and localise_only", "one of them", "A residual network needs the residual of a search."
        )
    first = "localising" if is_compiled() else "compiling the simulation (once after an installation), localising"
    report(0.0, first)
    study = steps.open_study(dataset, plant, seed)
    located = steps.localise(study)
    case, proposal, after_reference, promotion = study.case, ExperimentProposal(), "", None
    own = registry is not None and case.adapter is None
    reference = steps.register(case, case.plant, registry, {}) if registry is not None and own else case.reference
    if localise_only:
        proof = steps.measure(study, ProofOutcome(case.plant))
    else:
        elsewhere = replace(tasks, plant=reference) if tasks is not None else None
        study = steps.search(study, forms, part(report, 0.02, 0.75), tasks=elsewhere)
        report(0.75, "proving on held-out recordings")
        proof = steps.prove(study, add if world is None else world, part(report, 0.75, 0.85), carry=carry)
    outcome, stages = proof.outcome, list(study.stages)
    if add and registry is not None and outcome.repaired is not case.plant:
        after_reference = steps.store(study, proof, registry)
        promotion = steps.promote(study, proof, registry, after_reference)
    if planning is not None and case.adapter is None and not localise_only and case.split.seen:  # poses alone: no motion
        report(0.85, "planning the next experiment")
        hypotheses = open_hypotheses(case, stages, outcome)
        planned = itertools.count()

        def on_hypothesis(text: str) -> None:
            report(0.85 + 0.15 * min(1.0, next(planned) / max(1, len(hypotheses))), f"planning: {text}")

        proposal = propose(case, outcome.repaired, hypotheses, planning, on_hypothesis)
    shown = excitation(case, stages)
    verdict = _verdict(outcome, located, shown, localise_only)
    better = outcome.repaired.vector()
    report(1.0, "done")
    return GapResult(
        dataset=dataset.reference,
        plant_before=reference,
        plant_after=after_reference,
        verdict=verdict,
        effects=tuple(with_units(outcome.named, dataset)),
        unnamed=tuple(outcome.unnamed),
        ambiguous=tuple(outcome.ties),
        next_experiment=() if verdict == "no_gap" else steps.next_experiment(study, proof, shown),
        gap=proof.gap,
        stage_gap=proof.stage_gap,
        excitation=shown,
        held_out_recordings=tuple(r.name for r in held_out_of(case)),
        seconds=time.perf_counter() - begin,
        localised=located,
        shares=shares_of(compile_plant(case.plant), case.split.seen) if case.adapter is None else (),
        maps=_maps(case, stages, better if outcome.repaired is not case.plant else None),
        carried=tuple(outcome.carried),
        written=tuple(
            with_units(
                written_effects(
                    case.plant, outcome.repaired, outcome.named, outcome.ties, outcome.near_misses, outcome.refused
                ),
                dataset,
            )
        ),
        near_misses=tuple(with_units(outcome.near_misses, dataset)),
        delays=axis_delays(case.plant, outcome.repaired),
        forces=force_comparisons(stages),
        candidates=tuple(row for stage in stages if stage.result for row in stage.result.compared),
        traces=proof.traces,
        notes=(
            *outcome.notes,
            *proposal.notes,
            *(untested_forces(case, stages) if case.adapter is None else ()),
            *filter(None, [left_out_sentence(case.plant.machine.left_out) if case.adapter is None else ""]),
            *(case.adapter.notes([s.problem for s in stages]) if case.adapter is not None else ()),
        ),
        experiments=proposal.experiments,
        world_gap=proof.world,
        machine_diff=steps.machine_diff(study, proof),
        promotion=promotion,
        settings={"seed": seed, "forms": forms, "carry": carry, "noise": dict(case.noise), "localise_only": localise_only},
    )


def _maps(case: Case, stages: Sequence[Stage], repaired: Array | None) -> tuple[Map, ...]:
    """Maps over the fit and selection recordings, stage by stage."""
    machine, units = case.plant.machine, case.dataset.units
    of_stages = (maps_of(s.problem, case.theta, s.split.seen, s.sigma, machine, units, repaired) for s in stages)
    return tuple(item for maps in of_stages for item in maps)


def _verdict(outcome: ProofOutcome, located: Sequence[StageGap], shown: Sequence[Excitation], localise_only: bool) -> Verdict:
    if outcome.named:
        return "named"
    if outcome.ties:
        return "ambiguous"
    above = {item.target for item in located if item.stage_rmse > EXPLAINED * item.noise_floor}
    if outcome.unnamed or (localise_only and above):
        return "unnamed"
    return "insufficient_excitation" if any(e.target in above and not e.sufficient for e in shown) else "no_gap"
