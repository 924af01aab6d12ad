"""The runner's CAN transport against the simulated test bench in its own process: real frames both ways, over a serial line."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from live_machine import DATABASE, SIGNALS, Live, live_machine

from sysid.errors import InputError, SettingsError
from sysid_rl.run.can import CanTransport

pytestmark = pytest.mark.realtime

BOOM = np.array([0.0, 0.5, 0.0, 0.0])


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    with live_machine(tmp_path_factory.mktemp("live"), "--survey") as machine:
        yield machine


@pytest.fixture
def transport(live: Live) -> Iterator[CanTransport]:
    found = CanTransport(live.settings)
    found.open()
    found.set_inputs(dead_man=False, emergency_stop=False)
    yield found
    found.close()


def drive(transport: CanTransport, commands: np.ndarray, seconds: float, enabled: bool = True) -> np.ndarray:
    """Commands every 10 ms for ``seconds``; returns them as the transport says it sent them."""
    begin = transport.now_ns()
    for k in range(round(seconds * 100)):
        transport.wait_until(begin + k * 10_000_000)
        transport.read()
        sent = transport.write(commands, enabled)
    return sent


def until(met: Callable[[], bool]) -> bool:
    """Whether ``met`` comes true within two seconds: other processes may hold up both ends of the line."""
    end = time.monotonic() + 2.0
    while not met() and time.monotonic() < end:
        time.sleep(0.005)
    return met()


def test_readings_and_commands_cross_the_line(live: Live, transport: CanTransport) -> None:
    before, _ = transport.read()
    assert set(before) == set(SIGNALS)
    drive(transport, BOOM, 0.4)
    after, inputs = transport.read()
    truth = live.truth
    assert inputs.fault == ""
    assert after["boom.cylinder"].count - before["boom.cylinder"].count >= 30
    assert after["boom.cylinder"].value > before["boom.cylinder"].value + 0.002
    assert after["boom.cylinder"].value == pytest.approx(truth["boom.drive"][-1], abs=2e-3)
    assert 0.5 in truth["boom.asked"]
    age = after["boom.cylinder"].received_ns - after["boom.cylinder"].measured_ns
    assert 0 <= age < 100_000_000, "the machine's stamp, on the clock of this computer"


def test_who_only_listens_sends_nothing_when_he_goes(live: Live) -> None:
    """Somebody else may be moving the machine."""
    time.sleep(0.1)  # until what was said before has come
    before = live.truth["counter_ns"][-1]
    listening = CanTransport(live.settings)
    listening.open()
    listening.read()
    listening.close()
    time.sleep(0.1)
    assert live.truth["counter_ns"][-1] == before


def test_negative_commands_and_steps_of_04_percent(live: Live, transport: CanTransport) -> None:
    sent = drive(transport, np.array([0.123456, -0.3, 0.001, -1.0]), 0.05)
    wanted = [0.124, -0.3, 0.0, -1.0]
    assert sent.tolist() == wanted
    axes = ("slew", "boom", "stick", "telescope")
    assert until(lambda: [live.truth[f"{axis}.asked"][-1] for axis in axes] == wanted)


@pytest.mark.parametrize("commands", [[0.0, np.nan, 0.0, 0.0], [np.inf, 0.5, 0.0, 0.0]])
def test_a_command_that_is_no_number_moves_nothing(live: Live, transport: CanTransport, commands: list[float]) -> None:
    drive(transport, np.array(commands), 0.05)
    assert until(lambda: live.truth["enabled"][-1] == 0.0)
    assert live.truth["boom.passed"][-1] == 0.0


def test_the_machine_stops_by_itself_when_commands_stop(live: Live, transport: CanTransport) -> None:
    drive(transport, BOOM, 0.15)
    assert until(lambda: transport.read()[1].fault == "machine: commands stopped")
    truth = live.truth
    moving = np.flatnonzero(truth["boom.passed"] == 0.5)[-1]
    assert 85e6 < truth["at_ns"][moving] - truth["counter_ns"][-1] < 105e6, "100 ms after the last, in cycles of 10 ms"


def test_the_machine_stops_at_once_on_fail_safe_bits(live: Live, transport: CanTransport) -> None:
    drive(transport, BOOM, 0.15)
    transport.write(BOOM, enabled=False)
    assert until(lambda: live.truth["enabled"][-1] == 0.0)
    truth = live.truth
    moving = truth["at_ns"][truth["boom.passed"] == 0.5]
    assert moving[-1] - truth["counter_ns"][-1] < 15e6
    assert until(lambda: transport.read()[1].fault == ""), "nobody commands, and that is no fault"


def test_switches_come_over_the_bus_and_are_safe_when_it_falls_silent(live: Live, transport: CanTransport) -> None:
    assert until(lambda: not transport.read()[1].dead_man)
    transport.set_inputs(dead_man=True)
    assert until(lambda: transport.read()[1].dead_man)
    transport.set_inputs(emergency_stop=True)
    drive(transport, BOOM, 0.1)
    assert until(lambda: transport.read()[1].emergency_stop)
    assert live.truth["boom.passed"][-1] == 0.0, "the button takes the pressure away, whoever commands what"
    transport.set_inputs(emergency_stop=False)
    live.tell("drop MACHINE_STATUS 40")
    assert until(lambda: transport.read()[1].fault == "no status of the machine")
    assert not transport.read()[1].dead_man
    assert until(lambda: transport.read()[1].dead_man)


def test_a_counter_that_stands_still_says_nothing(live: Live, transport: CanTransport) -> None:
    live.tell("stuck SLEW_SENSOR 1")
    time.sleep(0.05)
    before, _ = transport.read()
    time.sleep(0.1)
    after, _ = transport.read()
    live.tell("stuck SLEW_SENSOR 0")
    assert after["slew.joint"].count == before["slew.joint"].count
    assert after["boom.cylinder"].count > before["boom.cylinder"].count + 5


def test_lost_frames_are_counted(live: Live, transport: CanTransport) -> None:
    transport.read()
    lost = transport.lost
    live.tell("drop SLEW_SENSOR 5")

    def counted() -> bool:
        transport.read()
        return transport.lost - lost == 5

    assert until(counted)


def changed(folder: Path, old: str, new: str) -> Path:
    text = DATABASE.read_text("utf-8")
    assert old in text
    path = folder / "other.dbc"
    path.write_text(text.replace(old, new), "utf-8")
    return path


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ("BO_ 423 SLEW_SENSOR", "BO_ 424 SLEW_SENSOR", "SLEW_SENSOR is missing"),
        ("BO_ 423 SLEW_SENSOR", "BO_ 424 SLEW_SENSOR", "does not know 1A7"),
        ("SG_ counter : 24|8@1+", "SG_ counter : 32|8@1+", "SLEW_SENSOR repeats itself"),
        ("SG_ boom : 0|21@1- (1E-005,0)", "SG_ boom : 0|21@1- (0.001,0)", "DRAW_WIRES.boom = "),
        ("SLEW_SENSOR: 8", "SLEW_SENSOR: 7", "SLEW_SENSOR has 8 bytes, 7 in the database"),
    ],
)
def test_another_machines_database_is_refused(live: Live, tmp_path: Path, old: str, new: str, found: str) -> None:
    settings = dataclasses.replace(live.settings, database=changed(tmp_path, old, new).rename(tmp_path / "wrong.dbc"))
    with pytest.raises(InputError, match=f"{found}.*expected the messages of .*wrong.dbc"):
        CanTransport(settings).open()


def test_a_machine_that_dies_is_a_fault(tmp_path: Path) -> None:
    with live_machine(tmp_path) as machine:
        transport = CanTransport(machine.settings)
        transport.open()
        machine.kill()
        deadline = time.monotonic() + 2.0
        while not transport.read()[1].fault.startswith("bus: ") and time.monotonic() < deadline:
            time.sleep(0.01)
        assert transport.read()[1].fault.startswith("bus: ")
        assert not transport.read()[1].dead_man
        with pytest.raises(OSError, match="bus"):
            transport.write(BOOM, enabled=True)
        transport.close()
        transport.close()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"interface": "udp_multicast"}, "'udp_multicast' uses a network"),
        ({"channel": "socket://10.0.0.1:3333"}, "uses a network"),
        ({"bitrate": 125_000}, "a bus load of .* % at 125000 bit/s; expected at most 70 %"),
        ({"signals": {"slew.joint": "SLEW_SENSOR.slwe"}}, "has no signal 'slwe'; expected 'slew'"),
        ({"signals": {"slew.joint": "SLEW.slew"}}, "no message 'SLEW'"),
        ({"valves": {"slew": "DRAW_WIRES"}}, "no signal 'flow'"),
        ({"database": Path("missing.dbc")}, "missing.dbc"),
    ],
)
def test_settings_that_make_no_bus(live: Live, change: dict[str, object], message: str) -> None:
    with pytest.raises((SettingsError, InputError), match=message):
        CanTransport(dataclasses.replace(live.settings, **change))


def test_no_adapter() -> None:
    from live_machine import VALVES

    from sysid_rl.run.can import CanSettings

    transport = CanTransport(CanSettings(DATABASE, SIGNALS, VALVES, channel="/dev/no-such-adapter"))
    with pytest.raises(InputError, match=r"cannot be opened .*; expected a CAN adapter at this computer"):
        transport.open()
    with pytest.raises(OSError, match="not open"):
        transport.write(BOOM, enabled=True)
