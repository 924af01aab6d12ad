"""Ingest on a real Dask scheduler: the version of one process, also when a worker is killed or the ingest is interrupted."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from dask_cluster import ROOT, cluster
from fleet_logs import one_lift
from version_content import content

from sysid.cli import main
from sysid.datasets import Store, ingest
from sysid.datasets.versions.vacuum import vacuum

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
from sysid.execution.cluster import ClusterExecutor


def worker_of(nanny: int) -> int:
    """The process that runs the tasks of a nanny."""
    return int(Path(f"/proc/{nanny}/task/{nanny}/children").read_text().split()[0])


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_an_ingest_whose_worker_is_killed_gives_the_same_version(tmp_path: Path) -> None:
    logs = one_lift(tmp_path / "logs")
    ingest(logs, tmp_path / "alone")
    with cluster(tmp_path / "dask") as (address, processes):
        killed: list[int] = []

        def progress(share: float, text: str) -> None:
            if share > 0.3 and not killed:
                killed.append(worker_of(processes[1].pid))
                os.kill(killed[0], signal.SIGKILL)

        found = ingest(logs, tmp_path / "ws", progress=progress, executor=ClusterExecutor(address))
        assert killed
        assert content(Store(tmp_path / "ws"), found.reference) == content(Store(tmp_path / "alone"), "lift@1")
        with pytest.raises(SystemExit) as ended:
            main(["--workspace", str(tmp_path / "cli"), "ingest", str(logs), "--cluster", address])
        assert not ended.value.code
    assert content(Store(tmp_path / "cli"), "lift@1") == content(Store(tmp_path / "alone"), "lift@1")


INTERRUPTED = """
import os, signal, sys
from sysid.datasets import ingest
from sysid.execution import open_executor

def progress(share, text):
    if share > 0.3:
        signal.raise_signal(signal.SIGINT)

signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job of a shell ignores it
ingest(sys.argv[1], sys.argv[2], progress=progress, executor=open_executor(sys.argv[3]))
"""


@pytest.mark.slow
def test_an_interrupted_ingest_leaves_no_version_and_the_next_call_makes_it(tmp_path: Path) -> None:
    logs = one_lift(tmp_path / "logs", 2)
    with cluster(tmp_path / "dask") as (address, _):
        command = [sys.executable, "-c", INTERRUPTED, str(logs), str(tmp_path / "ws"), address]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        done = subprocess.run(command, env=environment, check=False, stderr=subprocess.PIPE)
        assert b"KeyboardInterrupt" in done.stderr
        assert list(Store(tmp_path / "ws").versions("lift")) == []
        assert ingest(logs, tmp_path / "ws", executor=ClusterExecutor(address)).version == 1
    vacuum(Store(tmp_path / "ws"), lambda *_: ())  # a task that was running may have written after the interrupt
    assert list(Store(tmp_path / "ws").leftovers("lift")) == []
    assert list(Store(tmp_path / "ws").versions("lift")) == [1]
