"""The machine in real time is the machine of the recordings; its watchdog; its end of the bus. No process, no clock."""

from __future__ import annotations

import contextlib
import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulated_bench.__main__ import main
from simulated_bench.can_log import database
from simulated_bench.live import COLUMNS, SerialLine, Switches, read_truth
from simulated_bench.live_bus import VALVES, CanFrame, LiveBus, parse_line
from simulated_bench.live_machine import TIME_OUT_NS, LiveMachine, Watchdog
from simulated_bench.recipe_file import load_recipe
from simulated_bench.run import simulate
from sysid.errors import InputError

ROOT = Path(__file__).parents[2]
DATABASE = ROOT / "rl/autolog/machine.dbc"
RECIPE = ROOT / "datasets/autolog/bench.toml"
MS = 1_000_000


@pytest.fixture(scope="module")
def bus() -> LiveBus:
    return LiveBus(DATABASE, survey=True)


def test_the_live_machine_moves_as_the_recorded_one() -> None:
    recipe = load_recipe(RECIPE)
    still = replace(recipe, axes={name: replace(axis, backlash=0.0) for name, axis in recipe.axes.items()})
    recorded = simulate(still, replace(still.recordings[0], seconds=12.0)).truth
    live = LiveMachine(still)
    places = []
    for cycle in range(1200):
        places.append(live.truth)
        live.advance(np.repeat(recorded.command[[cycle * live.steps]], live.steps, axis=0))
    expected = np.hstack([recorded.drive, recorded.joint, recorded.ee, recorded.tool])[:: live.steps]
    np.testing.assert_allclose(places, expected, atol=1e-9)
    assert np.ptp(recorded.drive, axis=0).max() > 0.05


def commanded(watchdog: Watchdog, now_ns: int, counter: int, value: float = 0.4) -> None:
    for axis in range(4):
        watchdog.command(axis, value, True, now_ns)
    watchdog.alive(counter, True, now_ns)


def test_valves_are_neutral_until_somebody_commands_all_of_them() -> None:
    watchdog = Watchdog()
    assert not watchdog.passed(0).any()
    watchdog.alive(1, True, MS)
    for axis in range(3):
        watchdog.command(axis, 0.4, True, MS)
    assert not watchdog.passed(MS).any()
    watchdog.command(3, 0.4, True, MS)
    assert list(watchdog.passed(MS)) == [0.4] * 4


def test_commands_that_stop_are_forgotten_after_100_ms() -> None:
    watchdog = Watchdog()
    commanded(watchdog, 0, 1)
    assert watchdog.passed(TIME_OUT_NS).all()
    assert not watchdog.passed(TIME_OUT_NS + 1).any()
    assert watchdog.fault == 1
    commanded(watchdog, TIME_OUT_NS + 2, 2)
    assert watchdog.passed(TIME_OUT_NS + 2).all()
    assert watchdog.fault == 0


@pytest.mark.parametrize("missing", range(4))
def test_one_valve_without_commands_stops_all(missing: int) -> None:
    watchdog = Watchdog()
    commanded(watchdog, 0, 1)
    for axis in set(range(4)) - {missing}:
        watchdog.command(axis, 0.4, True, 90 * MS)
    watchdog.alive(2, True, 90 * MS)
    assert watchdog.passed(95 * MS).all()
    assert not watchdog.passed(101 * MS).any()


def test_a_counter_that_stands_still_counts_as_silence() -> None:
    watchdog = Watchdog()
    for ms in range(0, 201, 10):
        commanded(watchdog, ms * MS, counter=7)
        assert watchdog.passed(ms * MS).all() == (ms <= 100)


def test_fail_safe_bits_of_one_valve_stop_all_at_once() -> None:
    watchdog = Watchdog()
    commanded(watchdog, 0, 1)
    watchdog.command(2, 0.4, False, MS)
    assert not watchdog.passed(MS).any()
    assert watchdog.fault == 2
    watchdog.alive(2, False, 2 * MS)
    watchdog.passed(2 * MS)
    assert watchdog.fault == 0, "whoever says that he does not command is believed"


@given(st.integers(0, 2**29 - 1), st.booleans(), st.binary(max_size=8))
def test_frames_survive_the_line(identifier: int, extended: bool, data: bytes) -> None:
    frame = CanFrame(identifier if extended else identifier % 2048, extended, data)
    assert parse_line(frame.line()[:-1]) == frame


@pytest.mark.realtime
def test_a_line_that_nobody_reads_loses_whole_frames(tmp_path: Path) -> None:
    line = SerialLine(tmp_path / "can0")
    other = os.open(tmp_path / "can0", os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

    def take() -> bytes:
        """All that waits in the line; its two ends are brought together by the kernel when it gets to it."""
        taken, end = b"", time.monotonic() + 0.2
        while time.monotonic() < end:
            with contextlib.suppress(BlockingIOError):
                taken += os.read(other, 65536)
                end = time.monotonic() + 0.2
        return taken

    try:
        os.write(other, b"O\r")
        while not line.open:
            line.receive()
        sent = 0
        received_frames = []
        for burst in (3000, 1, 1, 20, 3000, 1):
            line.send([CanFrame(0x100, False, (sent + k).to_bytes(8, "big")) for k in range(burst)])
            sent += burst
            received_frames.append(take())
    finally:
        os.close(other)
        line.close()
    *whole, rest = b"".join(received_frames).split(b"\r")
    frames = [parse_line(one) for one in whole]
    assert rest == b""
    assert all(frame is not None and len(frame.data) == 8 for frame in frames)
    numbers = [int.from_bytes(frame.data, "big") for frame in frames if frame is not None]
    assert numbers == sorted(set(numbers))
    assert len(numbers) < sent, "all of it found room: nothing was tried"


@given(st.binary(max_size=40))
def test_noise_on_the_line_is_no_frame_or_a_whole_one(line: bytes) -> None:
    frame = parse_line(line)
    assert frame is None or len(frame.data) <= 8


@given(st.integers(0, 255), st.integers(0, 15), st.integers(0, 3))
def test_every_valve_command_is_understood_or_unfit(flow: int, state: int, fail_safe: int) -> None:
    machine = LiveBus(DATABASE, survey=False)
    data = bytes([flow, 255, 0x30 | state | fail_safe << 6, 255, 255, 255, 255, 255])
    said = machine.valve(CanFrame(0x0CFE3128, True, data))
    assert said is not None
    axis, command, fit = said
    assert axis == 1
    assert -1.0 <= command <= 1.0
    assert fit == (flow <= 250 and state <= 2 and fail_safe != 2)
    assert command == pytest.approx({1: 1, 2: -1}.get(state, 0) * min(flow, 250) / 250)


def test_frames_that_are_too_short_or_of_others_command_nothing(bus: LiveBus) -> None:
    assert bus.valve(CanFrame(0x0CFE3128, True, b"\x10")) is None
    assert bus.valve(CanFrame(0x0CFE3129, True, bytes(8))) is None
    assert bus.status(CanFrame(0x0CFE3128, True, bytes(8))) is None


def test_what_the_machine_says_is_limited_and_counted(bus: LiveBus) -> None:
    import cantools

    described = cantools.database.load_file(DATABASE)
    names = "slew.joint boom.cylinder stick.cylinder telescope.joint boom.joint stick.joint ee.x ee.y ee.z"
    readings = dict.fromkeys(names.split(), 1e6)
    seen: dict[str, list[int]] = {}
    for cycle in range(4):
        for frame in bus.frames(readings, cycle, {"dead_man": 1, "emergency_stop": 0, "fault": 0, "time": 1.5, "echo": 7}):
            said = described.decode_message(frame.identifier, frame.data, decode_choices=False)
            seen.setdefault(bus.name(frame), []).append(said["counter"])
            if bus.name(frame) == "DRAW_WIRES":
                assert said["boom"] == pytest.approx((2**20 - 1) * 1e-5)
    assert np.diff(seen["SLEW_SENSOR"]).tolist() == [1, 1, 1]
    assert len(set(seen["DRAW_WIRES"])) == 2, "one bit"
    assert len(seen["TIP_TRACKER"]) == 2, "every 20 ms"


def test_the_database_holds_the_messages_of_the_logged_bus() -> None:
    import cantools

    described = cantools.database.load_file(DATABASE)
    for message in database():
        live = described.get_message_by_name(message.name)
        assert (live.frame_id, live.is_extended_frame) == (message.frame_id, message.is_extended_frame)
        for signal in message.signals:
            own = live.get_signal_by_name(signal.name)
            assert (own.start, own.length, own.byte_order, own.is_signed) == (
                signal.start,
                signal.length,
                signal.byte_order,
                signal.is_signed,
            )
            assert float(own.scale) == pytest.approx(float(signal.scale))
    assert [(described.get_message_by_name(name).frame_id >> 8) & 0x3FFFF for name in VALVES] == [65072, 65073, 65074, 65075]


@pytest.mark.parametrize("line", ["dead_man", "dead_man 1 1", "drop WIRES 3", "launch", "stuck SLEW_SENSOR x", "quit now",
                                  "clock nan", "late_frames 5", "answers inf", "launch 1 2"])  # fmt: skip
def test_the_control_pipe_takes_nothing_else(bus: LiveBus, line: str) -> None:
    with pytest.raises((ValueError, KeyError, TypeError)):
        Switches().apply(line, bus)


def test_a_database_that_is_none(tmp_path: Path) -> None:
    (tmp_path / "other.dbc").write_text('VERSION ""\nBU_: X\nBO_ 5 OTHER: 8 X\n SG_ a : 0|8@1+ (1,0) [0|0] "" X\n')
    with pytest.raises(InputError, match="expected the CAN database of the machine"):
        LiveBus(tmp_path / "other.dbc", survey=False)
    words = ["live", str(RECIPE), "--database", "none.dbc", "--pty", "p", "--control", "c", "--truth", str(tmp_path / "t")]
    assert main(words) == 2


def test_a_truth_that_was_cut_off_is_read(tmp_path: Path) -> None:
    path = tmp_path / "truth.bin"
    rows = np.arange(3.0 * len(COLUMNS)).reshape(3, -1)
    import json

    path.write_bytes(json.dumps({"columns": COLUMNS}).encode() + b"\n" + rows.tobytes()[:-11])
    truth = read_truth(path)
    assert truth["at_ns"].tolist() == [0.0, len(COLUMNS)]
