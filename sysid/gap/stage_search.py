"""The search at every stage of a case: side by side where stages know nothing of each other."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Literal

import numpy as np

from sysid.gap.adapters.adapter import SimulatorAdapter
from sysid.gap.candidates import Candidate, as_nuisance
from sysid.gap.case import Case, Stage, on_itself, stage_candidates
from sysid.gap.excitation import excitation_of
from sysid.gap.finding import Finding
from sysid.gap.search import Search
from sysid.gap.strictness import Strictness
from sysid.gap.worth import SCALE
from sysid.plant.model import WORKERS
from sysid.progress import Progress, part

Forms = Literal["all", "simple"]


def search_stages(
    case: Case, stages: Sequence[Stage], strict: Strictness, forms: Forms, progress: Progress
) -> tuple[Stage, ...]:
    """The stages with what was found at each."""
    if case.adapter is None:
        return _side_by_side(case, stages, strict, forms, progress)
    return _one_by_one(case, case.adapter, stages, strict, forms, progress)


def _side_by_side(
    case: Case, stages: Sequence[Stage], strict: Strictness, forms: Forms, progress: Progress
) -> tuple[Stage, ...]:
    """Stages driven by their measured inputs know nothing of each other: as many at a time as there are cores."""
    done = [0.0] * len(stages)

    def one(k: int) -> Stage:
        def tell(share: float, text: str) -> None:
            done[k] = share
            progress(sum(done) / len(stages), text)

        return replace(stages[k], finding=_found(case, stages[k], strict, forms, tell))

    with ThreadPoolExecutor(min(WORKERS, max(len(stages), 1)), thread_name_prefix="sysid-stage") as pool:
        found = tuple(pool.map(one, range(len(stages))))
    return _as_read(case, found, strict, forms, progress)


def _as_read(case: Case, stages: tuple[Stage, ...], strict: Strictness, forms: Forms, progress: Progress) -> tuple[Stage, ...]:
    """Drives that a sensor of the wrong scale reads are searched again with that scale in the plant: it looks like a gain."""
    scales = [
        (stage.found.fit, kept.candidate)
        for stage in stages
        for kept in stage.found.named
        if stage.problem.stage == "joint" and kept.candidate.effect.name == SCALE and not kept.ties
    ]
    found = []
    for stage in stages:
        read = [(fit, scale) for fit, scale in scales if scale.target in stage.problem.signals]
        if stage.problem.stage != "command" or not read or not stage.found.fit.candidates:
            found.append(stage)
            continue
        theta = stage.theta.copy()
        for fit, scale in read:
            for unknown, value in zip(scale.unknowns, fit.values_of(scale), strict=True):
                theta[list(unknown.places)] = value
        again = replace(stage, theta=theta)
        again = replace(again, finding=_found(case, again, strict, forms, lambda share, text: progress(1.0, text)))
        # What a sensor says of a joint may not make the motion behind it worse.
        found.append(again if again.found.final_rmse <= strict.worse * stage.found.final_rmse else stage)
    return tuple(found)


def _one_by_one(
    case: Case, adapter: SimulatorAdapter, stages: Sequence[Stage], strict: Strictness, forms: Forms, progress: Progress
) -> tuple[Stage, ...]:
    """With a simulator of one's own, the input of a stage depends on the effects found before it."""
    found, theta = list[Stage](), case.theta
    for k, stage in enumerate(stages):
        tell = part(progress, k / len(stages), (k + 1) / len(stages))
        settled = replace(stage, problem=adapter.with_input_effects(stage.problem, theta))
        found.append(replace(settled, finding=_found(case, settled, strict, forms, tell)))
        if stage.problem.stage == "command":
            fitted = found[-1].found.fit.theta
            theta = np.where(fitted != case.theta, fitted, theta)
    return tuple(found)


def _found(case: Case, stage: Stage, strict: Strictness, forms: Forms, tell: Progress) -> Finding:
    tell(0.0, stage.label)
    machine = case.plant.machine
    offered = [c for c in stage_candidates(case, stage) if forms == "all" or c.form is c.effect.forms[0]]
    tried, gated = list[Candidate](), list[Candidate]()
    for candidate in offered:
        shown = not strict.gate or excitation_of(candidate, stage.split.seen, machine).sufficient
        (tried if shown else gated).append(candidate)
    nuisances = [as_nuisance(c) for c in tried if strict.free and c.effect.name in stage.problem.nuisances]
    problem = stage.problem if case.adapter is None else case.adapter.search_problem(stage.problem)
    finding = Search(
        problem, stage.theta, stage.split, stage.sigma, tried, nuisances, gated, strict, case.seed,
        on_fit=lambda text: tell(0.0, f"{stage.label}: {text}"),
    ).run()  # fmt: skip
    tell(1.0, stage.label)
    return finding if problem is stage.problem else on_itself(finding, stage, stage.theta)
