"""Commands to frames and frames to readings, by the database of the demo's machine; how full its bus is."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from live_machine import DATABASE, SIGNALS, VALVES, old_database

from sysid.errors import SettingsError
from sysid_rl.run.bus import BusSettings, MachineBus, bus_load, coded_commands, frame_bits
from sysid_rl.run.can import CanSettings, CanTransport

SETTINGS = BusSettings(DATABASE, SIGNALS, VALVES)
BUS = MachineBus(SETTINGS, "runner.toml")
DESCRIBED = cantools.database.load_file(DATABASE)


@given(st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4))
def test_commands_arrive_to_half_a_step(commands: list[float]) -> None:
    frames = BUS.encode(commands, enabled=True)
    for (identifier, data), command in zip(frames, commands, strict=False):
        said = DESCRIBED.decode_message(identifier, data, decode_choices=False)
        sign = {0: 0.0, 1: 1.0, 2: -1.0}[said["state"]]
        assert sign * said["flow"] / 100.0 == pytest.approx(command, abs=0.002 + 1e-12)
        assert said["fail_safe"] == 0
        assert data[1] == 255, "reserved bits are ones"
        assert data[3:] == b"\xff" * 5, "no time of the machine is known"


@given(st.lists(st.floats(), min_size=4, max_size=4), st.booleans())
def test_nothing_leaves_the_range_and_no_number_enables_nothing(commands: list[float], enabled: bool) -> None:
    said = [
        DESCRIBED.decode_message(identifier, data, decode_choices=False) for identifier, data in BUS.encode(commands, enabled)
    ]
    fit = enabled and bool(np.isfinite(commands).all())
    assert said[-1]["enabled"] == int(fit)
    for valve in said[:-1]:
        assert 0.0 <= valve["flow"] <= 100.0
        assert valve["fail_safe"] == (0 if fit else 2)
        assert fit or (valve["flow"], valve["state"]) == (0, 0)


@given(st.lists(st.floats(), min_size=4, max_size=4), st.booleans())
def test_coded_commands_are_those_in_the_frames(commands: list[float], enabled: bool) -> None:
    frames = BUS.encode(commands, enabled)[:-1]
    said = [DESCRIBED.decode_message(identifier, data, decode_choices=False) for identifier, data in frames]
    decoded = [{0: 0.0, 1: 1.0, 2: -1.0}[valve["state"]] * valve["flow"] / 100.0 for valve in said]
    assert coded_commands(commands, enabled) == pytest.approx(decoded, abs=1e-12)


def test_the_alive_counter_goes_on() -> None:
    counts = [BUS.encode([0.0] * 4, True)[-1][1][0] for _ in range(300)]
    assert set(np.diff(counts) % 256) == {1}


def test_readings_counters_and_lost_frames() -> None:
    bus = MachineBus(SETTINGS, "runner.toml")
    message = DESCRIBED.get_message_by_name("SLEW_SENSOR")
    heard = [
        bus.decode(message.frame_id, False, bytes(message.encode({"slew": 0.25, "counter": counter}, padding=True)))
        for counter in (254, 255, 255, 0, 4)
    ]
    assert [(item.fresh, item.lost) for item in heard if item] == [(True, 0), (True, 0), (False, 0), (True, 0), (True, 3)]
    assert heard[0] is not None
    assert heard[0].values == pytest.approx({"slew.joint": 0.25})
    assert bus.decode(0x123, False, bytes(8)) is None
    with pytest.raises(ValueError, match="SLEW_SENSOR has 3 bytes, 8 in the database"):
        bus.decode(message.frame_id, False, bytes(3))


def test_bits_of_a_frame() -> None:
    """135 and 160 bits: the known worst cases of 8 bytes with 11 and 29 bits of identifier (Davis et al. 2007)."""
    assert frame_bits(8, extended=False) == 135
    assert frame_bits(8, extended=True) == 160


def test_load_of_the_bus() -> None:
    seven = 7 * 160 + 135 + 160 / 2 + 100
    load = bus_load(DESCRIBED, 250_000)
    own = sum(frame_bits(m.length, m.is_extended_frame) / (m.cycle_time * 1e-3) for m in DESCRIBED.messages) / 250_000
    assert load == pytest.approx(own)
    assert 0.9 * seven * 100 / 250_000 < load < 1.3 * seven * 100 / 250_000
    with pytest.raises(SettingsError, match=r"a bus load of \d+ % at 250000 bit/s; expected at most 30 %"):
        MachineBus(dataclasses.replace(SETTINGS, max_load=0.3), "runner.toml")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"status": "STATUS"}, "has no message 'STATUS'; expected 'RUNNER_STATUS'"),
        ({"alive": "DRAW_WIRES"}, "message DRAW_WIRES has no signal 'enabled'"),
        ({"valves": VALVES | {"boom": "RUNNER_STATUS"}}, "message RUNNER_STATUS has no signal 'flow'"),
    ],
)
def test_names_that_the_database_does_not_have(change: dict[str, object], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        MachineBus(dataclasses.replace(SETTINGS, **change), "runner.toml")  # type: ignore[arg-type]


def test_a_valve_command_needs_its_pgn(tmp_path: Path) -> None:
    path = tmp_path / "odd.dbc"
    odd = 0x0CFF3128 | 1 << 31
    path.write_text(DATABASE.read_text().replace(str(0x0CFE3128 | 1 << 31), str(odd)))
    with pytest.raises(SettingsError, match=r"valves.boom: AUX_VALVE_1_COMMAND has PGN 65329; expected .* PGN 65072 to 65079"):
        MachineBus(dataclasses.replace(SETTINGS, database=path), "runner.toml")


@pytest.mark.parametrize(("seconds", "raw"), [(0.0, 0), (12.3459, 12345), (63.9999, 63999), (64.0, 0), (429496.0, 56000)])
def test_a_command_says_which_time_of_the_machine_it_answers(seconds: float, raw: int) -> None:
    for _, data in BUS.encode([0.5] * 4, True, seconds)[:-1]:
        assert int.from_bytes(data[3:5], "little") == raw
        assert data[5:] == b"\xff" * 3


def test_a_database_without_stamp_and_echo_is_one_all_the_same(tmp_path: Path) -> None:
    bus = MachineBus(dataclasses.replace(SETTINGS, database=old_database(tmp_path)), "runner.toml")
    assert (bus.stamps, bus.echoes) == (False, False)
    assert (BUS.stamps, BUS.echoes) == (True, True)
    assert [data[3:] for _, data in bus.encode([0.5] * 4, True, 3.0)[:-1]] == [b"\xff" * 5] * 4


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bitrate": 0}, "bitrate: 0; expected 10000 to 1e"),
        ({"listen": 1e9}, "listen: 1e.09; expected 0 to 60"),
        ({"listen": -1.0}, "listen: -1; expected 0 to 60"),
        ({"max_load": float("nan")}, "max_load: nan; expected 0.01 to 1"),
        ({"interface": "slcna"}, "interface: 'slcna'; expected 'slcan'"),
        ({"options": {"timeout": 5}}, "options.timeout: is set by the runner"),
        ({"options": {"bitrate": 5}}, "options.bitrate: is set by the runner"),
    ],
)
def test_settings_that_would_let_the_loop_wait_or_fail(change: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        CanTransport(dataclasses.replace(CanSettings(DATABASE, SIGNALS, VALVES), **change), "runner.toml")
