"""The gap workflow in one call: localise → candidates → select → prove."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from sysid.compiled import is_compiled
from sysid.errors import SettingsError
from sysid.gap import steps
from sysid.gap.adapters.simulator import Simulator, name_of
from sysid.gap.experiment import Planning
from sysid.gap.following import Fields, Following, completed
from sysid.gap.prepare.case import excitation, force_comparisons, held_out_of, untested_forces
from sysid.gap.proof import ProofOutcome
from sysid.gap.result import NOT_MEASURED, GapResult
from sysid.gap.search_tasks import SearchTasks
from sysid.gap.stage_search import Forms
from sysid.gap.statement import left_out_sentence
from sysid.gap.written import with_units
from sysid.plant import Plant
from sysid.progress import Progress, part, silent

if TYPE_CHECKING:
    from sysid.datasets.recording import Dataset
    from sysid.registry import Registry


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
    keep: Callable[[GapResult], object] | None = None,
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
        keep: stores a result. It is called with the answer as soon as the effects are decided, and with the whole result.

    Returns:
        The result. What follows the decision and fails is in its ``missing``: errors on held-out recordings and in the world,
        storage, promotion, maps, planned recordings.

    Raises:
        ExcitationError: no stage is measured at both ends, or no recording to fit, to select or to hold out.
        InputError: a user's simulator failed before the decision, or returned no table of signals.
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
    _check_simulator(plant, add, carry, localise_only)
    first = "localising" if is_compiled() else "compiling the simulation (once after an installation), localising"
    report(0.0, first)
    study = steps.open_study(dataset, plant, seed)
    located = steps.localise(study)
    case = study.case
    stored = registry if case.adapter is None else None
    reference = steps.register(case, case.plant, stored, {}) if stored is not None else case.reference
    if localise_only:
        outcome = ProofOutcome(case.plant)
    else:
        elsewhere = replace(tasks, plant=reference) if tasks is not None else None
        study = steps.search(study, forms, part(report, 0.02, 0.75), tasks=elsewhere)
        report(0.75, "deciding on held-out recordings")
        outcome = steps.decide_on(study)
    stages = list(study.stages)
    shown = excitation(case, stages)
    notes = (
        *outcome.notes,
        *(untested_forces(case, stages) if case.adapter is None else ()),
        *filter(None, [left_out_sentence(case.plant.machine.left_out) if case.adapter is None else ""]),
        *(case.adapter.notes([s.problem for s in stages]) if case.adapter is not None else ()),
    )
    above = {item.target for item in located if item.disagrees}
    following = Following(
        study,
        steps.Proof(outcome, NOT_MEASURED, NOT_MEASURED, ()),
        shown,
        any(item.target in above and not item.sufficient for item in shown),
        localise_only and bool(above),
        notes,
        report,
    )
    answer = GapResult(
        dataset=dataset.reference,
        plant_before=reference,
        plant_after="",
        verdict=following.verdict,
        effects=tuple(with_units(outcome.named, dataset)),
        unnamed=tuple(outcome.unnamed),
        ambiguous=tuple(outcome.ties),
        next_experiment=(),
        gap=NOT_MEASURED,
        stage_gap=NOT_MEASURED,
        excitation=shown,
        held_out_recordings=tuple(r.name for r in held_out_of(case)),
        seconds=time.perf_counter() - begin,
        localised=located,
        near_misses=tuple(with_units(outcome.near_misses, dataset)),
        forces=force_comparisons(stages),
        order=case.order,
        candidates=tuple(row for stage in stages if stage.result for row in stage.result.compared),
        notes=notes,
        settings={"seed": seed, "forms": forms, "carry": carry, "noise": dict(case.noise), "localise_only": localise_only},
    )
    parts: dict[str, Callable[[], Fields]] = {}
    if carry:
        parts["residual networks"] = following.carry
    parts["errors on held-out recordings"] = following.errors
    if case.adapter is None and not localise_only and (add if world is None else world):
        parts["errors in the PyBullet world"] = following.world
    parts["values that the repair writes"] = following.written
    if add and stored is not None and (carry or outcome.repaired is not case.plant):
        parts["stored repair"] = partial(following.store, stored)
        parts["promotion"] = partial(following.promote, stored)
    parts["next recordings"] = following.next_recordings
    if case.adapter is None:
        parts["shares of the stages"] = following.shares
    parts["maps of the error"] = following.maps
    if planning is not None and case.adapter is None and not localise_only and case.split.seen:  # poses alone: no motion
        parts["planned recordings"] = partial(following.plan, planning)
    result = completed(answer, parts, keep)
    report(1.0, "done")
    return replace(result, seconds=time.perf_counter() - begin)


def _check_simulator(plant: Plant | Simulator, add: bool, carry: bool, localise_only: bool) -> None:
    """Raises SettingsError: what is asked for is impossible with this simulation."""
    if carry and localise_only:
        raise SettingsError(
            "find_gap", "carry and localise_only", "one of them", "A residual network needs the residual of a search."
        )
    if isinstance(plant, Plant) or not (add or carry):
        return
    where = f"simulator {name_of(plant)}"
    if add:
        raise SettingsError(where, "cannot be stored", "a plant", "Get the repaired simulator from sysid.gap.steps.add.")
    raise SettingsError(where, "cannot hold a residual network", "a plant")
