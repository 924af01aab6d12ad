"""A Dask scheduler with worker processes, on the loopback interface."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

ROOT = Path(__file__).parents[2]
#: Without an address of its own, the HTTP server listens on every interface.
QUIET = ("--dashboard-address", "127.0.0.1:0")


@contextlib.contextmanager
def cluster(
    folder: Path, workers: int = 2, port: str = "0", settings: Mapping[str, str] | None = None
) -> Iterator[tuple[str, list[subprocess.Popen[str]]]]:
    """A scheduler and workers as processes of their own: address, processes (the scheduler first).

    Args:
        settings: environment of the processes, for settings of Dask.
    """
    folder.mkdir(exist_ok=True)
    started: list[subprocess.Popen[str]] = []
    quiet = {"DASK_DISTRIBUTED__DASHBOARD__LINK": "", "DASK_DISTRIBUTED__ADMIN__TICK__LIMIT": "30s", "OMP_NUM_THREADS": "1"}
    paths = os.pathsep.join([str(ROOT / "tests/execution"), str(ROOT)])
    environment = {**os.environ, **quiet, "PYTHONPATH": paths, **(settings or {})}

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
        start("scheduler", "--host", "127.0.0.1", "--port", port, *QUIET)
        address = _address(folder / "scheduler-0.log")
        for _ in range(workers):
            start(
                "worker", address, "--nworkers", "1", "--nthreads", "1", *QUIET, "--host", "127.0.0.1",
                "--local-directory", str(folder),
            )  # fmt: skip
        _workers(address, workers)
        yield address, started
    finally:
        for processes in (started[1:], started[:1]):  # the scheduler last: workers wait for one that has ended
            for process in processes:
                process.send_signal(signal.SIGCONT)  # one that a test has stopped
                process.send_signal(signal.SIGTERM)
            for process in processes:
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
