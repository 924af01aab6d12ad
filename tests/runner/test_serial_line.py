"""A device as a line: its path, and other programs that have it open."""

from __future__ import annotations

import os
import subprocess
import sys
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest
from live_machine import DATABASE, SIGNALS, VALVES

from sysid.errors import InputError
from sysid_rl.run.can import CanSettings, CanTransport
from sysid_rl.run.serial_line import OtherReaders, device_channel, other_programs, split_channel

OPENS = "import os, sys; f = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY); print(1, flush=True); sys.stdin.read()"


@pytest.fixture
def terminal() -> Iterator[str]:
    """A device whose other end is in this process."""
    master, slave = os.openpty()
    tty.setraw(slave)
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


@pytest.fixture
def other(terminal: str) -> Iterator[int]:
    """Another program that has it open."""
    words = [sys.executable, "-c", OPENS, terminal]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "1\n"
        yield process.pid
        process.kill()


@pytest.mark.parametrize(
    ("folder", "name", "rate"),
    [("plain", "can0", None), ("a@b", "can0", None), ("a@b", "can0", 921600), ("plain", "can@1", None),
     ("a@9600", "can0", None),
     ("plain", "can0@115200", None), ("x@1@2", "y@3", 115200)],
)  # fmt: skip
def test_an_at_sign_in_a_path_is_no_baud_rate(tmp_path: Path, terminal: str, folder: str, name: str, rate: int | None) -> None:
    link = tmp_path / folder / name
    link.parent.mkdir()
    link.symlink_to(terminal)
    channel = str(link) if rate is None else f"{link}@{rate}"
    assert split_channel(channel) == (terminal, rate)
    assert device_channel(channel) == (terminal if rate is None else f"{terminal}@{rate}")
    transport = CanTransport(CanSettings(DATABASE, SIGNALS, VALVES, channel=channel, listen=0.02))
    with pytest.raises(InputError, match="MACHINE_STATUS is missing"):
        transport.open()


def test_whatever_a_driver_raises_is_an_adapter_that_cannot_be_opened(terminal: str) -> None:
    settings = CanSettings(DATABASE, SIGNALS, VALVES, channel=terminal, options={"sleep_after_open": "long"})
    with pytest.raises(InputError, match=r"cannot be opened .*; expected a CAN adapter"):
        CanTransport(settings, "runner.toml").open()


def test_a_device_with_an_at_sign_is_refused_and_a_link_to_it_as_well(tmp_path: Path) -> None:
    (tmp_path / "tty@1").touch()
    with pytest.raises(ValueError, match="for a baud rate"):
        device_channel(str(tmp_path / "tty@1"))
    assert device_channel("can0") == "can0"
    assert device_channel("can0@1000") == "can0@1000"


def test_another_program_on_the_line_is_named_before_anything_is_opened(terminal: str, other: int) -> None:
    found = other_programs(terminal)
    assert len(found) == 1
    assert found[0].endswith(f"(process {other})")
    transport = CanTransport(CanSettings(DATABASE, SIGNALS, VALVES, channel=terminal), "runner.toml")
    with pytest.raises(
        InputError, match=rf"runner.toml: {terminal}: .* \(process {other}\) has this line open; expected the runner alone"
    ):
        transport.open()
    with pytest.raises(InputError, match="has this line open"):  # the lock was released
        transport.open()


def test_nobody_else_is_nobody(terminal: str, tmp_path: Path) -> None:
    assert other_programs(terminal) == []
    assert other_programs(str(tmp_path / "missing")) == []
    (tmp_path / "file").touch()
    assert other_programs(str(tmp_path / "file")) == []


def test_the_machines_end_of_a_pseudo_terminal_is_no_reader() -> None:
    words = [sys.executable, "-c", "import os, sys; a, b = os.openpty(); print(os.ttyname(b), flush=True); sys.stdin.read()"]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert other_programs(process.stdout.readline().strip()) == []
        process.kill()


def test_readers_are_searched_for_once_a_second_and_never_waited_for(terminal: str, other: int) -> None:
    readers = OtherReaders(terminal)
    readers.search(0)
    end = time.monotonic() + 5.0
    while not readers.text and time.monotonic() < end:
        time.sleep(0.01)
    assert f"(process {other}) has the line open too, and takes frames of the machine" in readers.text
    bus = OtherReaders("can0")
    bus.search(0)
    assert bus.text == ""
