"""The flight log holds everything, survives its writer, never holds up the loop, and is a recording to ingest."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import flights
import numpy as np
import pytest
from flights import AXES, MACHINE, SIGNALS, cycle
from mcap.reader import NonSeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory

from sysid.cli import main as sysid
from sysid.errors import SettingsError, StorageError
from sysid.logs.mcap import McapReader
from sysid.logs.reader import ReadOptions
from sysid_rl.run.cycle import Violation
from sysid_rl.run.flight_log import WAITING, FlightLog, provenance
from sysid_rl.run.mcap_pieces import PieceWriter

pytestmark = pytest.mark.realtime

WORDS = {"versions": {"policy": "autolog@1"}, "sha256": {"recipe": "0" * 64}}


def flown(folder: Path, cycles: int, **options: object) -> FlightLog:
    with FlightLog(folder, MACHINE, AXES, SIGNALS, WORDS, clock_ns=0, **options) as log:  # type: ignore[arg-type]
        for number in range(cycles):
            verdict = Violation("velocity", "boom", "clamp", 0.5, 0.4, "faster than allowed")
            log.record(cycle(number, verdicts=(verdict,) if number == 7 else ()))
    return log


def test_everything_is_in_it_for_any_reader(tmp_path: Path) -> None:
    log = flown(tmp_path, 250)
    with log.path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 250 * (len(SIGNALS) + 2) + 1
        assert {item.name: item.metadata for item in reader.iter_metadata()} == WORDS
        messages: dict[str, list[object]] = {}
        for _, channel, _, message in reader.iter_decoded_messages():
            messages.setdefault(channel.topic, []).append(message)
    turn = messages["/cycles"][20]
    wanted = cycle(20)
    assert (turn.number, turn.state, turn.source, turn.enabled) == (20, "running", "policy", True)  # type: ignore[attr-defined]
    assert (turn.dead_man, turn.emergency_stop, turn.fault) == (True, False, "")  # type: ignore[attr-defined]
    assert (turn.lateness_ns, turn.latency_ns) == (50_000, 700_000)  # type: ignore[attr-defined]
    assert list(turn.command) == list(wanted.commands)  # type: ignore[attr-defined]
    assert list(turn.target) == list(wanted.target)  # type: ignore[attr-defined]
    assert np.isnan(turn.ee).all()  # type: ignore[attr-defined]
    (verdict,) = messages["/verdicts"]
    assert (verdict.cycle, verdict.check, verdict.target, verdict.reaction, verdict.found, verdict.limit, verdict.text) == (  # type: ignore[attr-defined]
        7, "velocity", "boom", "clamp", 0.5, 0.4, "faster than allowed",
    )  # fmt: skip


def test_a_reading_that_stands_still_is_said_once_and_neutral_is_zero(tmp_path: Path) -> None:
    import dataclasses

    with FlightLog(tmp_path, MACHINE, AXES, SIGNALS, WORDS, clock_ns=0) as log:
        first = cycle(0)
        log.record(first)
        log.record(dataclasses.replace(cycle(1), readings=first.readings, enabled=False))
    streams = {stream.name: stream for stream in McapReader().read(log.path, ReadOptions())}
    assert len(streams["/readings/boom.cylinder"].columns["value"]) == 1
    assert list(streams["/commands"].columns["command[boom]"]) == [first.commands[1], 0.0]


@contextmanager
def writing(folder: Path, rate: float, limit: int = 0) -> Iterator[subprocess.Popen[str]]:
    words = [sys.executable, flights.__file__, str(folder), str(rate), str(limit)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(flights.ROOT), str(flights.ROOT / "rl")))}
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=environment) as process:
        try:
            yield process
        finally:
            process.kill()


def test_a_log_cut_by_kill_9_is_ingested(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "logs"
    with writing(folder, 800.0) as process:
        assert process.stdout is not None
        last = 0
        while last < 2400:
            last = int(process.stdout.readline().split()[0])
        os.kill(process.pid, signal.SIGKILL)
    (path,) = folder.glob("motion-*/flight.mcap")
    with path.open("rb") as file:
        kept = sum(channel.topic == "/cycles" for _, channel, _ in _left(file))
    assert kept >= last - 1000, "a second, and what the disk took"
    with pytest.raises(SystemExit) as stop:
        sysid(["--workspace", str(tmp_path / "workspace"), "ingest", str(folder), "--json", str(tmp_path / "out.json")])
    assert stop.value.code == 0, capsys.readouterr().err
    found = json.loads((tmp_path / "out.json").read_text())
    rows = sum(recording["rows"] for recording in found["recordings"])
    assert kept - 300 < rows <= kept, "all but the guards between the parts of one recording"


def _left(file):  # type: ignore[no-untyped-def]
    from mcap.exceptions import McapError

    try:
        yield from NonSeekingReader(file).iter_messages(log_time_order=False)
    except (McapError, EOFError):
        return


def test_a_full_disk_is_a_fault_and_what_was_synced_stays(tmp_path: Path) -> None:
    with writing(tmp_path, 150.0, limit=60_000) as process:
        assert process.stdout is not None
        lines = list(process.stdout)
        assert process.wait() != 0, "closing says that the log is not whole"
    assert "flight log: File too large" in lines[-1]
    (path,) = tmp_path.glob("motion-*/flight.mcap")
    assert path.stat().st_size <= 60_000
    (stream,) = [s for s in McapReader().read(path, ReadOptions()) if s.name == "/cycles"]
    assert len(stream.columns["number"]) > 100
    assert list(stream.columns["number"]) == list(range(len(stream.columns["number"])))


def test_a_run_that_never_began_leaves_no_recording(tmp_path: Path) -> None:
    log = flown(tmp_path, 0)
    log.close()
    assert not list(tmp_path.glob("motion-*"))


def test_a_disk_that_is_nearly_full_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match=r"MiB free; expected .* Make room"):
        FlightLog(tmp_path, MACHINE, AXES, SIGNALS, WORDS, reserve=2**60)
    assert not list(tmp_path.glob("motion-*"))


def test_the_loop_never_waits_for_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stuck = threading.Event()
    monkeypatch.setattr("sysid_rl.run.mcap_pieces.os.fsync", lambda _: stuck.wait(10.0))
    monkeypatch.setattr("sysid_rl.run.flight_log.SYNC_EVERY", 0.0)
    stuck.set()
    with FlightLog(tmp_path, MACHINE, AXES, SIGNALS, WORDS, clock_ns=0) as log:
        stuck.clear()
        one = cycle(0)
        begin = time.monotonic()
        for _ in range(WAITING + 200):
            log.record(one)
        assert time.monotonic() - begin < 0.5
        assert log.lost >= 100
        assert f"{WAITING} cycles wait" in log.fault
        stuck.set()
    with log.path.open("rb") as file:
        said = {item.name: item.metadata for item in make_reader(file).iter_metadata()}
    assert said["lost"] == {"cycles": str(log.lost)}


def test_logs_of_one_machine_share_a_folder_and_another_machine_is_refused(tmp_path: Path) -> None:
    first, second = flown(tmp_path, 3), flown(tmp_path, 3, kind="poses")
    assert first.folder != second.folder
    assert 'poses = ["poses-*"]' in (tmp_path / "recipe.toml").read_text()
    assert 'motion = ["motion-*"]' in (tmp_path / "recipe.toml").read_text()
    other = tmp_path / "other" / "machine.toml"
    other.parent.mkdir()
    other.write_text(MACHINE.read_text().replace("rate_hz = 100.0", "rate_hz = 50.0"))
    with pytest.raises(SettingsError, match="holds logs of another machine"):
        FlightLog(tmp_path, other, AXES, SIGNALS, WORDS)


def test_provenance(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    words = provenance({"recipe": tmp_path / "a"}, {"policy": "autolog@3"})
    assert words["sha256"]["recipe"] == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert words["versions"] == {"policy": "autolog@3"}
    assert {"sysid", "python", "numpy"} <= set(words["software"])


def test_how_a_run_ended_stands_in_the_log(tmp_path: Path) -> None:
    with FlightLog(tmp_path, MACHINE, AXES, SIGNALS, WORDS, clock_ns=0) as log:
        log.record(cycle(0))
        log.add_metadata("end", {"ended": "quit", "why": "SIGTERM"})
    with log.path.open("rb") as file:
        found = {item.name: item.metadata for item in make_reader(file).iter_metadata()}
    assert found == {**WORDS, "end": {"ended": "quit", "why": "SIGTERM"}}


def test_a_disk_that_never_answers_does_not_keep_a_run_from_ending(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sysid_rl.run.flight_log.CLOSE_S", 0.05)
    log = FlightLog(tmp_path, MACHINE, AXES, SIGNALS, WORDS, clock_ns=0)
    gate = threading.Event()
    monkeypatch.setattr(PieceWriter, "sync", lambda writer: gate.wait(20.0))
    log.record(cycle(0))
    with pytest.raises(StorageError, match="the disk does not respond for"):
        log.close()
    gate.set()
    for thread in threading.enumerate():
        if thread.name == "flight log":
            thread.join()
