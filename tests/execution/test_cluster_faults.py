"""A job whose cluster fails ends with the result of one machine, or says what is missing and goes on when called again."""

from __future__ import annotations

import os
import signal
from collections import Counter
from pathlib import Path

import pytest
from dask_cluster import cluster
from fleet_logs import write_fleet
from tasks import recordings_of, starved, stored

from sysid.errors import StoreError
from sysid.execution import LocalExecutor, TaskError

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
from sysid.execution.cluster import ClusterExecutor

COUNT = 8


def calls(folder: Path) -> list[tuple[str, float]]:
    folder.mkdir(exist_ok=True)
    return [(str(folder), float(k)) for k in range(COUNT)]


def computed(folder: Path) -> Counter[str]:
    return Counter((folder / "computed").read_text().split())


def expected(tmp_path: Path) -> list[float]:
    """The result of this process."""
    found: list[float] = LocalExecutor().run(stored, calls(tmp_path / "alone")[:2])
    return found + [2.0 * k for k in range(2, COUNT)]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of distributed's own connections
def test_after_a_restart_of_the_scheduler_the_next_call_goes_on(tmp_path: Path) -> None:
    work = calls(tmp_path / "work")
    with cluster(tmp_path / "first") as (address, processes):
        port = address.rpartition(":")[2]

        def progress(share: float, text: str) -> None:
            for process in processes:
                process.kill()

        with pytest.raises(TaskError, match=r"was lost.*Call again"):
            ClusterExecutor(address).run(stored, work, progress)
    before = {path.stem for path in (tmp_path / "work").glob("*.result")}
    assert 0 < len(before) < COUNT
    with cluster(tmp_path / "second", port=port) as (again, _):
        assert again == address
        assert ClusterExecutor(address).run(stored, work) == expected(tmp_path)
    assert all(computed(tmp_path / "work")[name] == 1 for name in before)


@pytest.mark.slow
def test_tasks_of_a_worker_that_stands_still_run_elsewhere(tmp_path: Path) -> None:
    work = calls(tmp_path / "work")
    with cluster(tmp_path / "dask", settings={"DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "5s"}) as (address, processes):
        stopped: list[int] = []

        def progress(share: float, text: str) -> None:
            if not stopped:
                stopped.append(processes[1].pid)
                for child in Path(f"/proc/{processes[1].pid}/task/{processes[1].pid}/children").read_text().split():
                    os.kill(int(child), signal.SIGSTOP)  # the worker itself is a child of its nanny

        try:
            assert ClusterExecutor(address).run(stored, work, progress) == expected(tmp_path)
        finally:
            for child in Path(f"/proc/{processes[1].pid}/task/{processes[1].pid}/children").read_text().split():
                os.kill(int(child), signal.SIGCONT)
    assert stopped


@pytest.mark.slow
def test_a_task_without_enough_memory_is_reported(tmp_path: Path) -> None:
    with pytest.raises(TaskError, match="not enough memory"):
        LocalExecutor(2).run(starved, [(0.0,), (1.0,)])
    with cluster(tmp_path, workers=1) as (address, _), pytest.raises(TaskError, match="not enough memory"):
        ClusterExecutor(address).run(starved, [(0.0,)])


@pytest.mark.slow
def test_a_workspace_that_is_away_is_reported_and_read_when_it_is_back(tmp_path: Path) -> None:
    place = write_fleet(tmp_path, {"lift-1": [0.08, 0.08]})
    work = [(str(place), "lift-1")] * 3
    whole = LocalExecutor().run(recordings_of, work)
    with cluster(tmp_path / "dask", workers=1) as (address, _):
        away = place.rename(tmp_path / "away")
        with pytest.raises(StoreError, match="lift-1"):
            ClusterExecutor(address).run(recordings_of, work)
        assert not place.exists(), "a workspace that is away is not made anew"
        away.rename(place)
        assert ClusterExecutor(address).run(recordings_of, work) == whole


@pytest.mark.slow
def test_two_jobs_at_once_on_the_same_work_have_the_same_result(tmp_path: Path) -> None:
    work = calls(tmp_path / "work")
    with cluster(tmp_path / "dask") as (address, _):
        from concurrent.futures import ThreadPoolExecutor

        with ThreadPoolExecutor(2) as pool:
            found = list(pool.map(lambda _: ClusterExecutor(address).run(stored, work), range(2)))
    assert found == [expected(tmp_path)] * 2
    assert len(list((tmp_path / "work").iterdir())) == COUNT + 1
