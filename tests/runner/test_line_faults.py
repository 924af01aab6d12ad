"""Delays, disorder and set clocks on a line to the simulated test bench, in virtual time: how soon they are reported."""

from __future__ import annotations

from pathlib import Path

import pytest
from live_machine import DATABASE, old_database
from virtual_line import VirtualLine, VirtualRun

from sysid_rl.run import serial_line


def without(folder: Path, *signals: str) -> Path:
    """The demo's database without some signals."""
    path = folder / "less.dbc"
    lines = DATABASE.read_text("utf-8").splitlines(keepends=True)
    path.write_text("".join(line for line in lines if not any(f" {signal} " in line for signal in signals)), "utf-8")
    return path


@pytest.fixture(params=["stamp, echo, time", "time", "nothing"])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """What the machine states about its time."""
    if request.param == "time":
        return old_database(tmp_path)
    return without(tmp_path, "stamp", "echo", "time") if request.param == "nothing" else DATABASE


def run(database: Path, *faults: str, seconds: float) -> VirtualRun:
    """A quiet second, then the faults."""
    found = VirtualRun(VirtualLine(database, jitter_ms=2.0)).go(1.0)
    assert found.fault == ""
    found.ages.clear()
    found.line.tell(*faults)
    return found.go(seconds)


@pytest.mark.parametrize("faults", [(), ("overtake 1",), ("clock -0.02",), ("answers 20",)])
def test_small_disorder_is_no_fault(database: Path, faults: tuple[str, ...]) -> None:
    found = run(database, *faults, seconds=3.0)
    assert found.fault == ""
    assert found.stale_s() is None
    assert found.transport.lost == 0


@pytest.mark.parametrize("more", [(), ("overtake 1",)])
def test_a_growing_delay_of_the_frames_is_seen_without_stamp_and_echo(database: Path, more: tuple[str, ...]) -> None:
    found = run(database, *more, "late_frames 0 20", seconds=4.0)
    stale = found.stale_s()
    assert stale is not None
    assert 2.0 < stale < 2.6, "of 45 ms"
    assert "late" in found.fault
    assert found.fault_s is not None
    assert found.fault_s < 3.6


def test_a_sudden_delay_is_seen_in_the_first_late_frame(database: Path) -> None:
    found = run(database, "late_frames 200 0", seconds=1.0)
    assert min(found.ages[25:]) > 0.19
    assert found.fault == "no status of the machine"


@pytest.mark.parametrize("seconds", [-10.0, -0.3, 0.3, 10.0])
def test_a_clock_that_was_set_is_a_fault(tmp_path: Path, seconds: float) -> None:
    found = run(old_database(tmp_path), f"clock {seconds}", seconds=0.5)
    assert found.fault_s is not None
    assert found.fault_s <= 0.1
    assert "it was set, or the machine has restarted" in found.fault


@pytest.mark.parametrize(("fault", "within"), [("late_commands 200 0", 0.25), ("late_commands 0 20", 3.5), ("swallow 1", 0.25)])
def test_late_and_lost_commands_are_seen_by_the_echo(fault: str, within: float) -> None:
    found = run(DATABASE, fault, seconds=4.0)
    assert found.fault_s is not None
    assert found.fault_s < within


def test_another_reader_is_named_in_place_of_the_status_that_it_took(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_line, "other_programs", lambda channel: ["cat (process 12)"])
    found = VirtualRun(VirtualLine(), channel="/dev/ttyACM0")
    assert found.go(1.0).fault == "", "nothing is searched for while all frames come"
    found.line.tell("drop MACHINE_STATUS 4")
    assert found.go(0.2).fault == "cat (process 12) has the line open too, and takes frames of the machine"


def test_what_cannot_be_seen_is_said(database: Path) -> None:
    remarks = " ".join(VirtualRun(VirtualLine(database)).transport.remarks)
    assert ("commands that arrive late are detected by the motion only" in remarks) == (database != DATABASE)
    assert ("one from the beginning by the motion only" in remarks) == (database.name == "less.dbc")


def test_without_time_and_cyclic_counter_late_readings_are_seen_by_the_motion_only(tmp_path: Path) -> None:
    path = without(tmp_path, "stamp", "echo", "time")
    path.write_text(path.read_text("utf-8").replace("SG_ counter : 16|8@1+", "SG_ counter : 16|4@1+"), "utf-8")
    line = VirtualLine(path)
    assert any("late readings are detected by the motion only" in text for text in VirtualRun(line).transport.remarks)
