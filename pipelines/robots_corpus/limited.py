"""Runs a command with limits of processor time, memory and wall time, and measures what it used."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

#: One thread in every library: models run side by side, and the memory limit counts stacks.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
#: Most characters of the output that are kept.
_KEPT = 4000


@dataclass(frozen=True)
class Limits:
    """Processor time and wall time [s], and memory [bytes] of heap, private mappings and stacks; None: not limited."""

    cpu: int
    wall: float
    memory: int | None = None


@dataclass(frozen=True)
class Done:
    """A finished command.

    Args:
        text: both outputs.
        seconds: of processor time; ``memory``: the largest resident sets of its processes [MiB].
    """

    code: int
    text: str
    seconds: float
    wall: float
    memory: float

    @property
    def broke(self) -> str:
        """What no user should see: a traceback, a crash, a limit that was reached; empty where nothing of that happened."""
        if "Traceback (most recent call last)" in self.text:
            return "traceback: " + self.text.strip().splitlines()[-1][:200]
        if self.code in (-signal.SIGXCPU, -signal.SIGKILL):
            return "limit of time reached"
        if self.code < 0:
            return f"ended by {signal.Signals(-self.code).name}"
        return "MemoryError" if "MemoryError" in self.text else ""


def run(command: Sequence[str], limits: Limits, cwd: Path | None = None, env: dict[str, str] | None = None) -> Done:
    """Run ``command`` in a process group of its own, which is ended when its wall time is over."""
    memory = "" if limits.memory is None else f"ulimit -d {limits.memory // 1024}; "
    shell = ["/bin/sh", "-c", f'ulimit -t {limits.cpu}; {memory}exec "$@"', "sh", *command]
    begin = time.monotonic()
    with tempfile.TemporaryFile() as out:
        process = subprocess.Popen(
            shell, stdout=out, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, cwd=cwd, start_new_session=True,
            env=os.environ | ONE_THREAD | {"COLUMNS": "10000"} | (env or {}),
        )  # fmt: skip
        status, seconds, resident = _wait(process.pid, begin + limits.wall)
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        text = out.read().decode("utf-8", "replace")
    kept = text if len(text) <= 2 * _KEPT else f"{text[:_KEPT]}\n…\n{text[-_KEPT:]}"
    return Done(process.returncode, kept, round(seconds, 2), round(time.monotonic() - begin, 2), round(resident / 1024))


def _wait(pid: int, until: float) -> tuple[int, float, float]:
    """Exit status, processor time [s] and largest resident set [KiB] of a process; its group is killed at ``until``."""
    largest = 0.0
    while time.monotonic() < until:
        largest = max(largest, _resident(pid))
        found, status, usage = os.wait4(pid, os.WNOHANG)
        if found:
            break
        time.sleep(0.01)
    else:
        os.killpg(pid, signal.SIGKILL)
        _, status, usage = os.wait4(pid, 0)
    return status, usage.ru_utime + usage.ru_stime, largest or float(usage.ru_maxrss)


def _resident(pid: int) -> float:
    """The largest resident sets so far of a process and of the processes that it started, together [KiB].

    The resource usage would also count that of the process which started it.
    """
    try:
        text = Path(f"/proc/{pid}/status").read_text("utf-8")
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text("utf-8").split()
    except OSError:
        return 0.0
    match = re.search(r"VmHWM:\s+(\d+)", text)
    return (float(match[1]) if match else 0.0) + sum(_resident(int(child)) for child in children)
