"""The search of a stage as a task, and its caller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from sysid.datasets import Store
from sysid.execution import Executor, LocalExecutor
from sysid.gap.prepare.case import Case, Stage, open_case, stage_candidates
from sysid.gap.stage_result import StageResult
from sysid.gap.stage_search import Forms, find_stage
from sysid.gap.tasks.values import Plain, from_result, to_result
from sysid.location import absolute_location, local_folder
from sysid.plant import plant_from_files
from sysid.progress import Progress
from sysid.registry import Registry


@dataclass(frozen=True)
class SearchTasks:
    """Searches stages by tasks.

    Args:
        executor: runs the tasks.
        location: the workspace, which every worker must reach.
        plant: reference of the plant under test in its registry; :func:`~sysid.gap.workflow.find_gap` sets it.
    """

    executor: Executor
    location: str
    plant: str = ""

    def run(self, case: Case, stages: Sequence[Stage], forms: Forms, progress: Progress) -> list[StageResult]:
        """The results of ``stages`` of a case, whose dataset is a version in the workspace."""
        shared = self.location, case.dataset.reference, self.plant, case.seed, forms
        calls = [(*shared, stage.label, _changes(stage)) for stage in stages]
        found = self.executor.run(search_stage, calls, progress, reports=True)
        return [
            to_result(written, stage.problem, stage_candidates(case, stage))
            for stage, written in zip(stages, found, strict=True)
        ]


def search_tasks(location: str | Path, executor: Executor) -> SearchTasks | None:
    """The tasks of an executor; None for that of one process, which searches in threads."""
    return None if executor == LocalExecutor() else SearchTasks(executor, absolute_location(location))


def search_stage(
    location: str, dataset: str, plant: str, seed: int, forms: Forms, label: str, changes: Plain, progress: Progress
) -> Plain:
    """Task: the result of one stage.

    Args:
        label: of the stage.
        changes: what the caller knows of it beyond its recordings.
    """
    case, stages = _opened(location, dataset, plant, seed)
    stage = next(stage for stage in stages if stage.label == label)
    theta, sigma = (np.array(changes[name]) for name in ("theta", "sigma"))
    stage = replace(stage, theta=theta, sigma=sigma, open_load=changes["open_load"])
    with threadpool_limits(1):
        return from_result(find_stage(case, stage, forms, progress))


def _changes(stage: Stage) -> Plain:
    return {"theta": stage.theta.tolist(), "sigma": stage.sigma.tolist(), "open_load": stage.open_load}


@lru_cache(maxsize=1)
def _opened(location: str, dataset: str, plant: str, seed: int) -> tuple[Case, list[Stage]]:
    """The case of the last task is kept: the next stage of the same gap needs it too."""
    version = Registry(local_folder(location)).load(plant)
    return open_case(Store(location).load(dataset), plant_from_files(version.files, version.reference), seed)
