"""What `sysid run` does with standard streams that are closed, or whose reader is gone."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

KEEP = """
import os, sys
from sysid_rl.cli.streams import closed_stdout_ignored, open_standard_streams
open_standard_streams()
line = os.open(os.devnull, os.O_RDWR)
sys.stdout.write("text")
sys.stderr.write("text")
sys.exit(0 if line > 2 and not sys.stdin.read() else 1)
"""
READ = """
import sys
from sysid.cli.output import Printer
from sysid_rl.cli.streams import closed_stdout_ignored
printer = Printer()
for _ in range(3):
    with closed_stdout_ignored():
        printer.line("x" * 100000)
sys.exit(7)
"""
OWN = """
from sysid_rl.cli.streams import closed_stdout_ignored
with closed_stdout_ignored(False):
    raise OSError(28, "No space left on device")
"""


def run(program: str, stdout: int) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run([sys.executable, "-c", program], stdout=stdout, stderr=subprocess.PIPE, check=False, timeout=60)


def test_a_stream_that_was_closed_is_nobody_elses_number() -> None:
    words = ["sh", "-c", 'exec "$0" -c "$1" <&- >&- 2>&-', sys.executable, KEEP]
    assert subprocess.run(words, check=False, timeout=60).returncode == 0


@pytest.mark.parametrize("how", ["broken pipe", "hung up"])
def test_a_reader_who_is_gone_changes_no_exit_status(how: str) -> None:
    reading, writing = os.pipe() if how == "broken pipe" else os.openpty()
    os.close(reading)
    done = run(READ, writing)
    os.close(writing)
    assert (done.returncode, done.stderr) == (7, b"")


def test_an_error_of_the_disk_stays_one() -> None:
    done = run(OWN, subprocess.DEVNULL)
    assert b"No space left on device" in done.stderr
