"""The stages of a gap as tasks: the same result as in threads, on processes and on a Dask cluster."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dask_cluster import cluster
from plant_data import dataset_of, nominal

from sysid.datasets import Dataset, Store
from sysid.datasets.versions.manifest import PartRecord
from sysid.errors import SettingsError
from sysid.execution import LocalExecutor, TaskError, open_executor
from sysid.gap import find_gap, steps
from sysid.gap.prepare.case import stage_candidates
from sysid.gap.result import GapResult
from sysid.gap.search_tasks import SearchTasks, from_result, search_tasks, to_result
from sysid.machine import KnownEffect
from sysid.plant import nominal_plant
from sysid.registry import Registry

HIDDEN = (
    KnownEffect("valve_deadband", "boom", {"positive": 0.1, "negative": 0.07}),
    KnownEffect("backlash", "slew", {"width": 0.01}, "drive"),
)


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace with recordings of an arm that hides a dead-band and a backlash."""
    folder = tmp_path_factory.mktemp("workspace")
    made = dataset_of(nominal(*HIDDEN), 10.0, seed=3)
    channels = {recording.name: () for recording in made.recordings}
    units = {
        signal: "1" if "command" in signal else "rad" if "joint" in signal else "m" for signal in made.recordings[0].signals
    }
    units |= {"time": "s", "wrist.command": "rad"}
    Store(folder).save(replace(made, name="arm", units=units, digest=f"{1:064x}"), channels, PartRecord(1))
    return folder


@pytest.fixture(scope="module")
def dataset(workspace: Path) -> Dataset:
    return Store(workspace).load("arm")


def gap_of(dataset: Dataset, workspace: Path, tasks: SearchTasks | None = None) -> GapResult:
    return find_gap(dataset, nominal_plant(dataset.machine), Registry(workspace), forms="simple", tasks=tasks)


def content(result: GapResult) -> Any:
    """Everything but the time that it took."""
    return json.loads(json.dumps(replace(result, seconds=0.0).to_json()))


@pytest.fixture(scope="module")
def alone(dataset: Dataset, workspace: Path) -> Any:
    return content(gap_of(dataset, workspace))


@pytest.mark.slow
def test_the_plain_form_of_a_result_is_complete(dataset: Dataset) -> None:
    study = steps.search(steps.open_study(dataset, nominal_plant(dataset.machine)), forms="simple")
    searched = [stage for stage in study.stages if stage.found.stage_fit is not None]
    assert searched
    for stage in study.stages:
        written = from_result(stage.found)
        read = to_result(json.loads(json.dumps(written)), stage.problem, stage_candidates(study.case, stage))
        assert from_result(read) == written
        assert read.problem is stage.problem
        np.testing.assert_array_equal(read.fit.theta, stage.found.fit.theta)
    fit, decision = searched[0].found.stage_fit, searched[0].found.stage_fit.decision
    shared = [k for k, model in enumerate(fit.models) if model is decision.model]
    again = to_result(from_result(searched[0].found), searched[0].problem, stage_candidates(study.case, searched[0]))
    assert [k for k, model in enumerate(again.stage_fit.models) if model is again.stage_fit.decision.model] == shared


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_tasks_give_the_result_of_one_process(dataset: Dataset, workspace: Path, alone: Any, workers: int) -> None:
    tasks = search_tasks(workspace, open_executor(workers=2))
    assert tasks is not None
    tasks = replace(tasks, executor=LocalExecutor(workers))
    shares = list[float]()
    found = find_gap(
        dataset, nominal_plant(dataset.machine), Registry(workspace), forms="simple", tasks=tasks,
        progress=lambda share, text: shares.append(share),
    )  # fmt: skip
    assert content(found) == alone
    assert {(effect.name, effect.target) for effect in found.effects} == {("valve_deadband", "boom"), ("backlash", "slew")}
    assert shares == sorted(shares)


@pytest.mark.slow
def test_a_cluster_gives_the_result_of_one(dataset: Dataset, workspace: Path, alone: Any, tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    with cluster(tmp_path / "dask") as (address, _):
        assert content(gap_of(dataset, workspace, search_tasks(workspace, open_executor(address)))) == alone


def test_one_process_has_no_tasks(workspace: Path) -> None:
    assert search_tasks(workspace, open_executor()) is None


def test_tasks_need_a_registry(dataset: Dataset, workspace: Path) -> None:
    with pytest.raises(SettingsError, match="tasks without a registry"):
        find_gap(dataset, nominal_plant(dataset.machine), tasks=SearchTasks(LocalExecutor(2), str(workspace)))


@pytest.mark.slow
def test_a_lost_scheduler_is_an_error(dataset: Dataset, workspace: Path) -> None:
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    with pytest.raises(TaskError):
        gap_of(dataset, workspace, search_tasks(workspace, open_executor("tcp://127.0.0.1:9")))
