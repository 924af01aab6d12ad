"""Two runners never have one line, under whatever names; the lock goes with the process, however that ends."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from sysid.errors import InputError
from sysid_rl.run.serial_line import lock_channel

HOLD = "import sys; from sysid_rl.run.serial_line import lock_channel; a = lock_channel('slcan', sys.argv[1], 't'); print(1, flush=True); sys.stdin.read()"  # noqa: E501


def test_a_second_runner_is_refused_under_any_name_of_the_line(tmp_path: Path) -> None:
    device, link = tmp_path / "tty", tmp_path / "by-id"
    device.touch()
    link.symlink_to(device)
    first = lock_channel("slcan", str(device), "runner.toml")
    for interface, channel in (("slcan", str(link)), ("slcan", f"{device}@115200"), ("seeedstudio", str(device))):
        with pytest.raises(InputError, match=r"runner.toml: .*: another runner has this line; expected one runner on a line"):
            lock_channel(interface, channel, "runner.toml")
    other = lock_channel("socketcan", f"can-{os.getpid()}", "runner.toml")
    first.release()
    lock_channel("slcan", str(link), "runner.toml").release()
    other.release()


def test_a_runner_that_is_killed_leaves_the_line_free(tmp_path: Path) -> None:
    words = [sys.executable, "-c", HOLD, str(tmp_path / "tty")]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "1\n"
        with pytest.raises(InputError, match="another runner has this line"):
            lock_channel("slcan", str(tmp_path / "tty"), "runner.toml")
        process.kill()
        process.wait()
    lock_channel("slcan", str(tmp_path / "tty"), "runner.toml").release()
