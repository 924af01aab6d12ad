"""The search at every stage of a case, in parallel where stages are independent."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from sysid.datasets.checks.roles import is_pose_set
from sysid.gap.adapters.adapter import SimulatorAdapter
from sysid.gap.arm.servos import beside_each_other, with_link_masses
from sysid.gap.prepare.case import Case, Stage
from sysid.gap.prepare.noise import shown_floor
from sysid.gap.search_tasks import SearchTasks
from sysid.gap.sensor_scales import with_sensor_scales
from sysid.gap.stage_result import StageResult
from sysid.gap.stage_search import Forms, find_stage
from sysid.machine import EffectKey
from sysid.plant import compile_plant
from sysid.plant.model import WORKERS, core_taken
from sysid.progress import Progress, part


def search_stages(
    case: Case, stages: Sequence[Stage], forms: Forms, progress: Progress, tasks: SearchTasks | None = None
) -> tuple[Stage, ...]:
    """The stages with the result of each.

    Args:
        tasks: searches the stages in other processes; by default in threads of this one. A user's simulator, the stages of a
            pose set and the servos of an arm, each beside what was found on the others, are searched here.
    """
    if case.adapter is not None:
        return _one_by_one(case, case.adapter, stages, forms, progress)
    with threadpool_limits(1):  # the answer does not depend on the number of threads
        return _independent(case, stages, forms, progress, None if is_pose_set(case.dataset) else tasks)


def _independent(
    case: Case, stages: Sequence[Stage], forms: Forms, progress: Progress, tasks: SearchTasks | None
) -> tuple[Stage, ...]:
    """Stages driven by their measured inputs are independent, but for the servos of an arm.

    The links of an arm come first: the axes are searched with the masses found.
    """
    links = [stage for stage in stages if stage.problem.kind.whole_arm]
    if links:
        first = replace(links[0], result=find_stage(case, links[0], forms, lambda share, text: progress(0.1 * share, text)))
        rest = [_with_links(s, first) for s in stages if not s.problem.kind.whole_arm]
        return (first, *_independent(case, rest, forms, part(progress, 0.1, 1.0), tasks))
    model = compile_plant(case.plant)
    floors = (shown_floor(model, s.problem, s.split.seen, s.theta, s.sigma) for s in stages)
    stages = [replace(stage, sigma=floor) for stage, floor in zip(stages, floors, strict=True)]
    coupled = [k for k, stage in enumerate(stages) if stage.problem.carried]
    apart = [k for k in range(len(stages)) if k not in coupled]
    found, share, turns = list(stages), len(apart) / max(len(stages), 1), itertools.count(1)
    if apart:
        search = _in_threads if tasks is None else tasks.run
        results = search(case, [stages[k] for k in apart], forms, part(progress, 0.0, share))
        for k, result in zip(apart, results, strict=True):
            found[k] = _with_result(stages[k], result)

    def in_turn(some: Sequence[Stage]) -> list[StageResult]:
        end = share + (1.0 - share) * min(next(turns) / len(coupled), 1.0)
        return _in_threads(case, some, forms, lambda _, text: progress(end, text))

    for k, stage in zip(coupled, beside_each_other(case, [stages[k] for k in coupled], in_turn), strict=True):
        found[k] = stage

    def again(stage: Stage, refuted: frozenset[EffectKey]) -> Stage:
        return _with_result(stage, find_stage(case, stage, forms, lambda share, text: progress(1.0, text), refuted))

    return with_link_masses(with_sensor_scales(found, again), again)


def _with_result(stage: Stage, result: StageResult) -> Stage:
    return replace(stage, problem=result.problem, result=result)


def _in_threads(case: Case, stages: Sequence[Stage], forms: Forms, progress: Progress) -> list[StageResult]:
    """As many stages at a time as there are cores."""
    done = [0.0] * len(stages)
    stopped = threading.Event()

    def one(k: int) -> StageResult:
        def stage_progress(share: float, text: str) -> None:
            if stopped.is_set():
                raise CancelledError
            done[k] = max(done[k], share)
            progress(sum(done) / len(stages), text)

        with core_taken():
            return find_stage(case, stages[k], forms, stage_progress)

    pool = ThreadPoolExecutor(min(WORKERS, max(len(stages), 1)), thread_name_prefix="sysid-stage")
    try:
        found = list(pool.map(one, range(len(stages))))
    except BaseException:  # an interrupt, or an error of one stage: the others end at their next fit, nobody waits for them
        stopped.set()
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()
    return found


def _with_links(stage: Stage, links: Stage) -> Stage:
    """A stage with the masses that the links stage found where its force is one of theirs."""
    if stage.problem.signals[0] not in links.problem.signals:
        return stage
    fit = links.found.stage_fit
    loads = fit.open_loads if fit is not None else {}
    return replace(stage, theta=links.found.fit.theta.copy(), open_load=loads.get(stage.problem.target, 0.0))


def _one_by_one(
    case: Case, adapter: SimulatorAdapter, stages: Sequence[Stage], forms: Forms, progress: Progress
) -> tuple[Stage, ...]:
    """With a user's simulator, the input of a stage depends on the effects found before it."""
    found, theta = list[Stage](), case.theta
    for k, stage in enumerate(stages):
        stage_progress = part(progress, k / len(stages), (k + 1) / len(stages))
        prepared = replace(stage, problem=adapter.with_input_effects(stage.problem, theta))
        found.append(replace(prepared, result=find_stage(case, prepared, forms, stage_progress)))
        if stage.problem.kind.commanded:
            fitted = found[-1].found.fit.theta
            theta = np.where(fitted != case.theta, fitted, theta)
    return tuple(found)
