"""The search of a stage as a task, its caller, and its result as plain values: numbers, text, lists and dictionaries.

A candidate is written by its label, and read as that of the receiver, who derives the same candidates from the same recordings.
Fits of models are written once, since several lists of a result contain the same fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from sysid.datasets import Store
from sysid.execution import Executor, LocalExecutor
from sysid.gap.candidates import Candidate, Unknown
from sysid.gap.decision import Decision, NearMiss
from sysid.gap.fit import Fit
from sysid.gap.likelihood.explained import Explained
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.prepare.case import Case, Stage, open_case, stage_candidates
from sysid.gap.problem import Problem
from sysid.gap.result import ComparedModel, EffectEvidence
from sysid.gap.stage_model import StageFit
from sysid.gap.stage_result import AcceptedEffect, StageResult
from sysid.gap.stage_search import Forms, find_stage
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


Plain = dict[str, Any]

#: What a result consists of, apart from candidates, problems, fits of models, arrays and plain values.
_CLASSES = {
    found.__name__: found
    for found in (
        AcceptedEffect, ComparedModel, Decision, EffectEvidence, Explained, Fit, NearMiss, StageFit, StageResult, Unknown,
    )
}  # fmt: skip


def from_result(result: StageResult) -> Plain:
    """The result without its problem, which the receiver has."""
    models: list[Plain] = []
    known: dict[int, int] = {}

    def fields_of(value: Any) -> Plain:
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}

    def plain(value: Any) -> Any:
        if isinstance(value, ModelFit):
            if id(value) not in known:
                known[id(value)] = len(models)
                models.append(fields_of(value))
            return {"model": known[id(value)]}
        if isinstance(value, Candidate):
            return {"candidate": value.label}
        if isinstance(value, Problem):
            return {"problem": value.stage}
        if isinstance(value, np.ndarray):
            return {"array": value.ravel().tolist(), "shape": list(value.shape)}
        if isinstance(value, np.generic):
            return value.item()
        if isinstance(value, Mapping):
            return {"map": {key: plain(item) for key, item in value.items()}}
        if isinstance(value, Sequence) and not isinstance(value, str):
            return [plain(item) for item in value]
        if type(value).__name__ in _CLASSES:
            return {"class": type(value).__name__, "fields": fields_of(value)}
        if value is None or isinstance(value, str | int | float | bool):
            return value
        raise TypeError(f"{type(value).__name__} in the result of a stage has no plain form")

    return {"result": plain(result), "models": models}


def to_result(written: Plain, problem: Problem, candidates: Sequence[Candidate]) -> StageResult:
    """The result of a stage with this problem and these candidates."""
    known = {candidate.label: candidate for candidate in candidates}
    models: list[ModelFit] = []

    def value_of(entry: Any) -> Any:
        if isinstance(entry, list):
            return tuple(value_of(item) for item in entry)
        if not isinstance(entry, dict):
            return entry
        if "model" in entry:
            return models[entry["model"]]
        if "candidate" in entry:
            return known[entry["candidate"]]
        if "problem" in entry:
            return problem
        if "array" in entry:
            return np.array(entry["array"], dtype=np.float64).reshape(entry["shape"])
        if "map" in entry:
            return {key: value_of(item) for key, item in entry["map"].items()}
        return _CLASSES[entry["class"]](**fields_from(entry["fields"]))

    def fields_from(entries: Plain) -> Plain:
        return {key: value_of(item) for key, item in entries.items()}

    models += [ModelFit(**fields_from(entry)) for entry in written["models"]]
    found = value_of(written["result"])
    assert isinstance(found, StageResult)
    return found
