"""A flight log is shown while it is written: nothing twice, nothing half, and the end is seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from flights import AXES, MACHINE, SIGNALS, cycle
from rerun_file import curves

from sysid.cli import main as sysid
from sysid.errors import InputError
from sysid_rl.run.cycle import Violation
from sysid_rl.run.flight_log import FlightLog
from sysid_rl.run.flight_messages import CYCLES, VERDICTS
from sysid_rl.run.mcap_pieces import MAGIC
from sysid_rl.run.tail import Tail

TOPICS = frozenset((CYCLES, VERDICTS))


def flown(folder: Path, cycles: int) -> Path:
    with FlightLog(folder, MACHINE, AXES, SIGNALS, {}, clock_ns=0) as log:
        for number in range(cycles):
            verdict = Violation("velocity", "boom", "clamp", 0.5, 0.4, "faster than allowed")
            log.record(cycle(number, verdicts=(verdict,) if number == 7 else ()))
    return log.path


def test_a_log_that_grows_byte_by_byte_is_heard_once(tmp_path: Path) -> None:
    whole = flown(tmp_path / "logs", 40).read_bytes()
    path = tmp_path / "growing.mcap"
    path.write_bytes(whole[:8])
    tail = Tail(path, TOPICS)
    heard = []
    for end in range(8, len(whole) + 1, 997):
        path.write_bytes(whole[:end])
        heard += tail.new()
    path.write_bytes(whole)
    heard += tail.new()
    assert tail.finished
    assert [message.body.number for message in heard if message.topic == CYCLES] == list(range(40))
    assert [message.body.cycle for message in heard if message.topic == VERDICTS] == [7]
    assert tail.new() == []


def test_an_end_that_is_taken_back_is_not_heard(tmp_path: Path) -> None:
    whole = flown(tmp_path / "logs", 40).read_bytes()
    path = tmp_path / "growing.mcap"
    path.write_bytes(whole[: len(whole) // 2])
    tail = Tail(path, TOPICS)
    before = tail.new()
    path.write_bytes(whole[: len(whole) // 2 - 3])  # the disk was full
    assert tail.new() == []
    path.write_bytes(whole)
    assert len(before) + len(tail.new()) == 41


def test_a_log_that_is_taken_away_has_ended(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    path.write_bytes(MAGIC)
    tail = Tail(path, TOPICS)
    assert (tail.new(), tail.finished) == ([], False)
    path.unlink()
    assert (tail.new(), tail.finished) == ([], True)


def test_what_is_no_log_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"time,boom\n")
    with pytest.raises(InputError, match="a flight log"):
        Tail(path, TOPICS)


def test_a_flight_becomes_a_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, out = flown(tmp_path / "logs", 250), tmp_path / "flight.rrd"
    with pytest.raises(SystemExit) as ended:
        sysid(["view", str(log), "--out", str(out)])
    assert ended.value.code == 0
    assert "250 cycles" in capsys.readouterr().out
    shown = curves(out)
    assert {"/axes/boom/joint", "/axes/boom/setpoint", "/timing/lateness", "/log", "/machine/target"} <= set(shown)
    times, values = shown["/commands/boom"]
    assert times == pytest.approx(np.arange(250) / 100.0, abs=1e-6)
    assert values == pytest.approx([cycle(number).commands[1] for number in range(250)])
    assert len(shown["/log"][0]) == 2  # it runs, and one objection
