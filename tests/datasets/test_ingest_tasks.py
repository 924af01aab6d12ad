"""An ingest by tasks gives the version of an ingest in one process, to the byte."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from fleet_logs import one_lift
from version_content import content

from sysid.datasets import Store, append, ingest, vacuum
from sysid.errors import AlignmentError, InputError
from sysid.execution import LocalExecutor, TaskError

ROOT = Path(__file__).parents[2]
DEMO = ROOT / "datasets/autolog"


def elsewhere(recording: Path) -> None:
    """Add a file whose clock cannot be aligned: another day, and nothing that both clocks have seen."""
    seconds = np.arange(200) / 50.0 + 1e6
    pd.DataFrame({"time": seconds, "boom.speed": np.zeros(200)}).to_csv(recording / "speed.csv", index=False)


def files(workspace: Path) -> list[str]:
    return sorted(str(path.relative_to(workspace)) for path in workspace.rglob("*") if path.is_file() and path.name != ".lock")


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_tasks_give_the_same_version_to_the_byte(tmp_path: Path, workers: int) -> None:
    logs = one_lift(tmp_path / "logs")
    ingest(logs, tmp_path / "alone")
    shares: list[float] = []
    found = ingest(logs, tmp_path / "tasks", progress=lambda share, _: shares.append(share), executor=LocalExecutor(workers))
    expected, store = Store(tmp_path / "alone"), Store(tmp_path / "tasks")
    assert content(store, found.reference) == content(expected, found.reference)
    for mine, theirs in zip(found.recordings, expected.load(found.reference).recordings, strict=True):
        assert (mine.name, mine.start_ns) == (theirs.name, theirs.start_ns)
        assert mine.table.equals(theirs.table)
    assert shares == sorted(shares)
    part = tmp_path / "tasks" / store.manifest(found.reference)["parts"][0]["folder"]
    assert {entry.name for entry in part.iterdir()} == {"samples", "channels"}
    assert {path.name for path in part.rglob("*.*") if path.name.startswith(".")} <= {"._last_checkpoint"}
    assert ingest(logs, tmp_path / "tasks", executor=LocalExecutor(workers)).version == 1


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_motion_capture_and_poses_by_tasks(tmp_path: Path, workers: int) -> None:
    """With a survey of rigid bodies, clocks with a common skew, static poses, and a recording that is cut."""
    logs = tmp_path / "logs"
    for file in DEMO.rglob("*"):
        if file.is_file() and (file.parent == DEMO or file.parent.name in ("manual-01", "manual-06", "poses")):
            copy = logs / file.relative_to(DEMO)
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(file.read_bytes())
    ingest(logs, tmp_path / "alone")
    found = ingest(logs, tmp_path / "tasks", executor=LocalExecutor(workers))
    assert any("#" in recording.name for recording in found.recordings)
    assert content(Store(tmp_path / "tasks"), found.reference) == content(Store(tmp_path / "alone"), found.reference)


def test_a_recording_without_a_place_in_time_is_left_out(tmp_path: Path) -> None:
    logs = one_lift(tmp_path / "logs")
    elsewhere(logs / "run-1")
    expected = ingest(logs, tmp_path / "alone")
    found = ingest(logs, tmp_path / "tasks", executor=LocalExecutor())
    assert [recording.name for recording in found.recordings] == ["run-0", "run-2", "run-3"]
    assert any("left out: recording run-1" in note for note in found.quality["notes"])
    assert content(Store(tmp_path / "tasks"), "lift@1") == content(Store(tmp_path / "alone"), expected.reference)


def test_an_append_by_tasks_is_the_append_of_one_process(tmp_path: Path) -> None:
    logs = one_lift(tmp_path / "logs")
    for name in ("alone", "tasks"):
        ingest([logs / "run-0", logs / "run-1"], tmp_path / name, logs / "machine.toml")
    append(logs, tmp_path / "alone", "lift")
    found = append(logs, tmp_path / "tasks", "lift", executor=LocalExecutor())
    assert found.version == 2
    assert content(Store(tmp_path / "tasks"), "lift@2") == content(Store(tmp_path / "alone"), "lift@2")


def test_a_log_that_cannot_be_used_leaves_nothing(tmp_path: Path) -> None:
    logs = one_lift(tmp_path / "logs", 2)
    (logs / "run-1" / "log.csv").write_text("time,boom.command,boom.jiont\n0,0,0\n1,0,0\n")
    with pytest.raises(InputError, match=r"run-1.*unknown column 'boom.jiont'"):
        ingest(logs, tmp_path / "ws", executor=LocalExecutor())
    assert files(tmp_path / "ws") == []


def test_no_recording_has_a_place_in_time(tmp_path: Path) -> None:
    logs = one_lift(tmp_path / "logs", 1)
    elsewhere(logs / "run-0")
    with pytest.raises(AlignmentError, match="run-0"):
        ingest(logs, tmp_path / "ws", executor=LocalExecutor())
    assert files(tmp_path / "ws") == []


def test_a_lost_process_leaves_no_version_and_the_next_call_makes_it(tmp_path: Path) -> None:
    logs = one_lift(tmp_path / "logs", 2)

    def progress(share: float, text: str) -> None:
        import multiprocessing

        for process in multiprocessing.active_children() if share > 0.3 else ():
            process.kill()

    with pytest.raises(TaskError, match="ended without a result"):
        ingest(logs, tmp_path / "ws", progress=progress, executor=LocalExecutor(2))
    assert files(tmp_path / "ws") == []
    assert ingest(logs, tmp_path / "ws", executor=LocalExecutor()).version == 1


KILLED = """
import os, signal, sys
from sysid.datasets import ingest
from sysid.execution import LocalExecutor

def progress(share, text):
    if share > float(sys.argv[3]):
        os.kill(os.getpid(), signal.SIGKILL)

ingest(sys.argv[1], sys.argv[2], progress=progress, executor=LocalExecutor())
"""


@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
def test_leftovers_of_a_killed_ingest_are_removed_by_the_next_one_but_not_those_of_a_live_one(tmp_path: Path) -> None:
    logs = one_lift(tmp_path / "logs", 2)
    command = [sys.executable, "-c", KILLED, str(logs), str(tmp_path / "ws"), "0.7"]
    assert subprocess.run(command, env={**os.environ, "PYTHONPATH": str(ROOT)}, check=False).returncode == -signal.SIGKILL
    store = Store(tmp_path / "ws")
    (left,) = store.leftovers("lift")
    assert list(store.versions("lift")) == []
    with store.files.lock(f"datasets/lift/data/{left}"):
        assert [item.reason for item in vacuum(store, lambda *_: []).kept] == ["a writer is at work on it"]
        assert ingest(logs, tmp_path / "ws", executor=LocalExecutor()).version == 1
        assert list(store.leftovers("lift")) == [left]
    vacuum(store, lambda *_: [])
    assert list(store.leftovers("lift")) == []
    assert store.load("lift@1").digest == ingest(logs, tmp_path / "alone").digest
