"""Tasks on a real Dask scheduler with worker processes, on the loopback interface."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from tasks import doubled, killed, killed_once, process_of, refused

from sysid.errors import InputError
from sysid.execution import LocalExecutor, TaskError, open_executor

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
from sysid.execution.cluster import ClusterExecutor

CALLS = [(float(k),) for k in range(6)]


@contextlib.contextmanager
def cluster(folder: Path, workers: int = 2) -> Iterator[tuple[str, list[subprocess.Popen[str]]]]:
    """A scheduler and workers as processes of their own: address, processes (the scheduler first)."""
    started: list[subprocess.Popen[str]] = []
    quiet = {"DASK_DISTRIBUTED__DASHBOARD__LINK": "", "DASK_DISTRIBUTED__ADMIN__TICK__LIMIT": "30s", "OMP_NUM_THREADS": "1"}
    paths = os.pathsep.join([str(Path(__file__).parent), str(Path(__file__).parents[2])])
    environment = {**os.environ, **quiet, "PYTHONPATH": paths}

    def start(*words: str) -> subprocess.Popen[str]:
        log = (folder / f"{words[0]}-{len(started)}.log").open("w")
        with log:
            process = subprocess.Popen(
                [sys.executable, "-m", "distributed.cli.dask_" + words[0], *words[1:]], stderr=log, stdout=log, text=True,
                env=environment, cwd=folder,
            )  # fmt: skip
        started.append(process)
        return process

    try:
        start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        address = _address(folder / "scheduler-0.log")
        for _ in range(workers):
            start(
                "worker", address, "--nworkers", "1", "--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1",
                "--local-directory", str(folder),
            )  # fmt: skip
        _workers(address, workers)
        yield address, started
    finally:
        for process in reversed(started):
            process.send_signal(signal.SIGTERM)
        for process in started:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(10.0)
            process.kill()
            process.wait()


def _address(log: Path) -> str:
    limit = time.monotonic() + 60.0
    while time.monotonic() < limit:
        found = re.search(r"Scheduler at:\s+(tcp://\S+)", log.read_text())
        if found:
            return found.group(1)
        time.sleep(0.1)
    raise AssertionError(log.read_text())


def _workers(address: str, count: int) -> None:
    from distributed import Client

    with Client(address, timeout=30, set_as_default=False) as client:
        client.wait_for_workers(count, timeout=60)


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


def slow(seconds: float) -> float:
    time.sleep(seconds)
    return seconds
