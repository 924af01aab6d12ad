"""Tasks in this process and in processes of this machine."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tasks import doubled, killed, process_of, refused, reported

from sysid.errors import InputError
from sysid.execution import LocalExecutor, TaskError, open_executor

CALLS = [(float(k),) for k in range(5)]


@pytest.mark.parametrize("workers", [1, 2])
def test_results_are_in_the_order_of_the_calls(workers: int) -> None:
    shares: list[float] = []
    assert LocalExecutor(workers).run(doubled, CALLS, lambda share, _: shares.append(share)) == [0.0, 2.0, 4.0, 6.0, 8.0]
    assert shares == sorted(shares)


def test_one_worker_is_this_process_and_several_are_others() -> None:
    assert set(LocalExecutor(1).run(process_of, CALLS)) == {os.getpid()}
    assert os.getpid() not in LocalExecutor(2).run(process_of, CALLS)


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_of_a_task_keeps_its_parts(workers: int) -> None:
    with pytest.raises(InputError) as caught:
        LocalExecutor(workers).run(refused, CALLS)
    assert (caught.value.where, caught.value.remedy) == ("log.csv", "Remove it.")


def test_a_worker_that_is_killed_is_reported() -> None:
    with pytest.raises(TaskError, match="ended without a result"):
        LocalExecutor(2).run(killed, CALLS)


def test_tasks_report_their_own_progress() -> None:
    seen: list[tuple[float, str]] = []
    found = LocalExecutor(2).run(reported, CALLS[:2], lambda share, text: seen.append((share, text)), reports=True)
    assert found == [0.0, 1.0]
    assert any("half of 0" in text or "half of 1" in text for _, text in seen)
    assert [share for share, _ in seen] == sorted(share for share, _ in seen)
    alone: list[float] = []
    assert LocalExecutor(1).run(reported, CALLS[:2], lambda share, _: alone.append(share), reports=True) == found
    assert alone == [0.0, 0.25, 0.5, 0.75]


# A shell starts its background jobs with SIGINT ignored, which child processes inherit.
INTERRUPTED = """
import signal, sys
from sysid.execution import LocalExecutor
from tasks import endless

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    LocalExecutor(2).run(endless, [(sys.argv[1], 0.0), (sys.argv[1], 1.0)], reports=True)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_an_interrupt_kills_the_workers(tmp_path: Path) -> None:
    script = tmp_path / "interrupted.py"
    script.write_text(INTERRUPTED)
    paths = os.pathsep.join([str(Path(__file__).parent), str(Path(__file__).parents[2])])
    process = subprocess.Popen(
        [sys.executable, script, tmp_path], env={**os.environ, "PYTHONPATH": paths}, stderr=subprocess.PIPE
    )
    marks = [tmp_path / "0.pid", tmp_path / "1.pid"]
    while not all(mark.exists() and mark.read_text() for mark in marks):
        assert process.poll() is None, process.stderr
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    try:
        _, text = process.communicate(timeout=60.0)
    finally:
        process.kill()
    assert b"KeyboardInterrupt" in text
    for mark in marks:
        status = Path(f"/proc/{mark.read_text()}/stat")
        assert not status.exists() or status.read_text().rpartition(")")[2].split()[0] == "Z"


def test_no_calls_are_no_work() -> None:
    assert LocalExecutor(2).run(doubled, []) == []


def test_without_settings_work_stays_in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SYSID_CLUSTER", raising=False)
    assert open_executor() == LocalExecutor(1)
    assert open_executor(workers=2) == LocalExecutor(2)
