"""Worker processes end with their parent, however it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PATIENCE_S = 20.0
PARENT = """
import os, time
if os.fork() == 0:
    from sysid.children import end_with_parent
    end_with_parent(os.getppid())
    print(os.getpid(), flush=True)
    time.sleep(60)
time.sleep(60)
"""


def alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(sys.platform != "linux", reason="the signal of a parent's end is Linux's")
def test_a_worker_ends_with_its_killed_parent() -> None:
    parent = subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    worker = int(parent.stdout.readline())
    os.kill(worker, signal.SIGINT)  # a terminal sends it to both: only the parent reacts
    time.sleep(0.2)
    assert alive(worker)
    parent.kill()
    parent.wait()
    end = time.monotonic() + PATIENCE_S
    while alive(worker) and time.monotonic() < end:
        time.sleep(0.02)
    assert not alive(worker)
    parent.stdout.close()


def test_a_worker_whose_parent_has_ended_already_does_not_begin() -> None:
    code = "from sysid.children import end_with_parent\nend_with_parent(1 << 22)\nprint('begun')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert (done.returncode, done.stdout) == (1, "")
