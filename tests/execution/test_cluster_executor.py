"""Tasks on a real Dask scheduler with worker processes, on the loopback interface."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from dask_cluster import cluster
from tasks import doubled, killed, killed_once, process_of, refused, reported, slow

from sysid.errors import InputError
from sysid.execution import LocalExecutor, TaskError, open_executor

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
from sysid.execution.cluster import ClusterExecutor

CALLS = [(float(k),) for k in range(6)]


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with cluster(tmp_path_factory.mktemp("cluster")) as (found, _):
        yield found


def test_results_are_those_of_one_machine(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SYSID_CLUSTER", address)
    executor = open_executor()
    assert executor == ClusterExecutor(address)
    assert executor.run(doubled, CALLS) == LocalExecutor().run(doubled, CALLS)
    assert os.getpid() not in executor.run(process_of, CALLS)


def test_tasks_that_report_run_as_well(address: str) -> None:
    assert ClusterExecutor(address).run(reported, CALLS[:2], reports=True) == [0.0, 1.0]


def test_an_error_of_a_task_keeps_its_parts(address: str) -> None:
    with pytest.raises(InputError) as caught:
        ClusterExecutor(address).run(refused, CALLS)
    assert (caught.value.where, caught.value.remedy) == ("log.csv", "Remove it.")


def test_a_task_whose_worker_is_killed_runs_again_elsewhere(address: str, tmp_path: Path) -> None:
    found = ClusterExecutor(address).run(killed_once, [(str(tmp_path), value) for (value,) in CALLS])
    assert found == [value for (value,) in CALLS]
    assert (tmp_path / "1.0").exists()


def test_a_scheduler_that_does_not_answer_is_reported() -> None:
    with pytest.raises(TaskError, match="does not answer"):
        ClusterExecutor("tcp://127.0.0.1:9", connect_s=1.0).run(doubled, CALLS)


def test_a_missing_certificate_is_reported() -> None:
    with pytest.raises(TaskError, match=r"no certificate.*distributed\.comm\.tls"):
        ClusterExecutor("tls://127.0.0.1:9", connect_s=1.0).run(doubled, CALLS)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of distributed's own connections
def test_a_task_that_ends_every_worker_is_reported(tmp_path: Path) -> None:
    with cluster(tmp_path) as (found, _), pytest.raises(TaskError, match="ended the workers"):
        ClusterExecutor(found).run(killed, CALLS[:1])


@pytest.mark.slow
def test_a_scheduler_that_is_lost_is_reported(tmp_path: Path) -> None:
    with cluster(tmp_path) as (found, processes):
        executor = ClusterExecutor(found)

        def progress(share: float, text: str) -> None:
            processes[0].kill()

        with pytest.raises(TaskError, match="was lost"):
            executor.run(slow, [(0.1,), (20.0,), (20.0,)], progress)
