"""Ctrl-C: acknowledged at once, exit status 130, and nothing of the command is left running."""

from __future__ import annotations

import os
import pty
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

#: As a user waits for it; the figures of an idle machine are a hundredth of it.
PATIENCE_S = 20.0
#: The main thread ends by itself, waits for a thread that computes, or swallows the interrupt as a library might.
WORK = {
    "sleep": "time.sleep(60)",
    "pool": "with ThreadPoolExecutor(2) as pool: list(pool.map(time.sleep, [60, 60]))",
    "swallow": "while True:\n        try: time.sleep(60)\n        except KeyboardInterrupt: pass",
    "children": "subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)']).wait()",
}
SCRIPT = """
import signal, subprocess, sys, time
from concurrent.futures import ThreadPoolExecutor
from sysid.cli import main
from sysid.cli.verbs import VERBS, Verb
import click

@click.command()
def work():
    print("begun", flush=True)
    {work}

VERBS["work"] = Verb("__main__:work", "For this test.")
signal.signal(signal.SIGINT, signal.default_int_handler)
main(["work"])
"""


def start(work: str, out: int, folder: Path) -> subprocess.Popen[bytes]:
    script = folder / "work.py"
    script.write_text(SCRIPT.format(work=WORK[work]))
    return subprocess.Popen([sys.executable, str(script)], stdout=out, stderr=out, start_new_session=True)


def read_until(source: int, text: bytes, seen: bytes = b"") -> bytes:
    end = time.monotonic() + PATIENCE_S
    while text not in seen and time.monotonic() < end:
        if select.select([source], [], [], 0.1)[0]:
            try:
                seen += os.read(source, 4096)
            except OSError:  # the other end of a terminal is closed
                break
    assert text in seen, seen
    return seen


def members(session: int) -> list[int]:
    """Living processes of a session."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[3]) == session and fields[0] != "Z":
                found.append(int(entry.name))
    return found


@pytest.mark.parametrize("terminal", [False, True], ids=["pipe", "terminal"])
@pytest.mark.parametrize("work", WORK)
def test_an_interrupt_is_acknowledged_and_ends_everything(work: str, terminal: bool, tmp_path: Path) -> None:
    source, sink = pty.openpty() if terminal else os.pipe()
    process = start(work, sink, tmp_path)
    os.close(sink)
    seen = read_until(source, b"begun")
    os.kill(process.pid, signal.SIGINT)
    seen = read_until(source, b"stopping", seen)
    assert process.wait(PATIENCE_S) == 130
    seen = read_until(source, b"interrupted; nothing half-written is visible", seen)
    assert b"Traceback" not in seen
    assert terminal or b"\x1b" not in seen, "no control characters without a terminal"
    end = time.monotonic() + PATIENCE_S
    while (left := members(process.pid)) and time.monotonic() < end:
        time.sleep(0.05)
    assert not left
    os.close(source)


def test_a_second_interrupt_ends_at_once(tmp_path: Path) -> None:
    """Between the two nothing of the grace period has to pass: the grace is made longer than the test waits."""
    source, sink = os.pipe()
    script = tmp_path / "work.py"
    script.write_text("import sysid.cli.interruption as i\ni.GRACE_S = 1e4\n" + SCRIPT.format(work=WORK["swallow"]))
    process = subprocess.Popen([sys.executable, str(script)], stdout=sink, stderr=sink, start_new_session=True)
    os.close(sink)
    seen = read_until(source, b"begun")
    os.kill(process.pid, signal.SIGINT)
    read_until(source, b"stopping", seen)
    os.kill(process.pid, signal.SIGINT)
    assert process.wait(PATIENCE_S) == 130
    os.close(source)


def test_an_interrupt_that_the_caller_ignores_stays_ignored() -> None:
    """As under nohup."""
    code = (
        "import os, signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "from sysid.cli.interruption import interruptible\n"
        "with interruptible():\n    os.kill(os.getpid(), signal.SIGINT)\nprint('done')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert (done.returncode, done.stdout) == (0, "done\n")


def test_a_verb_can_take_over_the_interrupt() -> None:
    """As the runner of a machine, which stops the machine first."""
    code = (
        "import os, signal, time\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from sysid.cli.interruption import interruptible, leave_interrupts\n"
        "with interruptible():\n    leave_interrupts()\n    try:\n        os.kill(os.getpid(), signal.SIGINT)\n"
        "        time.sleep(5)\n    except KeyboardInterrupt:\n        time.sleep(1.5)\n        print('ramped down')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "ramped down\n", "")
