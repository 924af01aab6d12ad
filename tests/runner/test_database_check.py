"""A database that differs from the machine's in any message or signal is refused before the machine is opened, or works."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from live_machine import DATABASE, SIGNALS, VALVES
from virtual_line import VirtualLine

from sysid.errors import InputError, SettingsError
from sysid_rl.run.bus import BusSettings, MachineBus
from sysid_rl.run.can import CanSettings, CanTransport

#: Without comments and names of values, which a changed signal would contradict.
TEXT = re.sub(r"^(?:CM_|VAL_) .*\n", "", DATABASE.read_text("utf-8"), flags=re.MULTILINE)
MESSAGES = re.findall(r"^BO_ \d+ (\w+):", TEXT, re.MULTILINE)
SIGNAL = re.compile(
    r"^ SG_ (?P<name>\w+) : (?P<start>\d+)\|(?P<length>\d+)@(?P<order>\d)(?P<sign>[+-]) \((?P<scale>[^,]+),0\) "
)


def block(message: str) -> str:
    """The lines of a message and its signals."""
    found = re.search(rf"^BO_ \d+ {message}:.*\n(?: SG_ .*\n)*", TEXT, re.MULTILINE)
    assert found is not None
    return found[0]


def changed_signals(line: str) -> Iterator[tuple[str, str]]:
    """What can be wrong with a signal: its line, and as a word."""
    part = SIGNAL.match(line)
    assert part is not None
    yield "removed", ""
    yield "renamed", line.replace(f"SG_ {part['name']} ", "SG_ another ", 1)
    yield "signed", line.replace(f"@{part['order']}{part['sign']}", f"@{part['order']}{'-' if part['sign'] == '+' else '+'}")
    yield "scaled", line.replace(f"({part['scale']},", f"({2.0 * float(part['scale']):g},")
    yield "shifted", line.replace(f"({part['scale']},0)", f"({part['scale']},1)")
    yield "shorter", line.replace(f"|{part['length']}@", f"|{max(1, int(part['length']) - 1)}@")
    yield "one bit", line.replace(f"|{part['length']}@", "|1@")
    yield "moved", line.replace(f": {part['start']}|", f": {int(part['start']) ^ 1}|")
    yield "selected", line.replace(f"SG_ {part['name']} :", f"SG_ {part['name']} m0 :")
    yield "narrow", re.sub(r"\[.*?\|", "[1|", line)
    yield "of degrees", re.sub(r'\] ".*?"', '] "deg"', line)


def databases() -> Iterator[tuple[str, str]]:
    """Every database with one difference."""
    for message in MESSAGES:
        own = block(message)
        head, *lines = own.splitlines(keepends=True)
        yield f"{message} removed", TEXT.replace(own, "")
        yield f"{message} renamed", TEXT.replace(own, own.replace(message, "ANOTHER"))
        yield f"{message} longer", TEXT.replace(own, own.replace(head, re.sub(r": \d", ": 12", head)))
        yield f"{message} shorter", TEXT.replace(own, own.replace(head, re.sub(r": \d", ": 1", head)))
        yield f"{message} twice", TEXT.replace(own, own + own.replace(message, "ANOTHER") + "\n")
        for bit in (10, 14, 20, 62, 63):
            yield f"{message} with bit {bit}", TEXT.replace(own, f'{own} SG_ more : {bit}|1@1+ (1,0) [0|1] "" RUNNER\n')
        for line in lines:
            name = line.split()[1]
            for word, other in changed_signals(line):
                yield f"{message}.{name} {word}", TEXT.replace(own, own.replace(line, other))


CASES = dict(databases())


@pytest.fixture(scope="module")
def line() -> VirtualLine:
    return VirtualLine()


def refused(path: Path, line: VirtualLine) -> str:
    """Why a transport with this database is refused, when it is configured or while it listens; "" if it runs."""
    try:
        transport = CanTransport(CanSettings(path, SIGNALS, VALVES, listen=0.05), "runner.toml", bus=line, clock=line)
        transport.open()
    except (SettingsError, InputError) as error:
        return str(error)
    for command in (0.0, 0.004, 1.0, -0.3):
        line.wait_until(line.now + 10_000_000)
        readings, inputs = transport.read()
        assert not inputs.fault.startswith("bus")
        assert set(readings) == set(SIGNALS)
        transport.write(np.full(4, command), True)
    return ""


@pytest.mark.parametrize("message", MESSAGES)
def test_every_difference_is_refused_or_works(message: str, tmp_path: Path, line: VirtualLine) -> None:
    path = tmp_path / "machine.dbc"
    for name in (name for name in CASES if re.split(r"[. ]", name)[0] == message):
        path.write_text(CASES[name], "utf-8")
        why = refused(path, line)
        assert not why or re.match(r"(runner.toml: |.*machine.dbc: ).*; expected ", why, re.DOTALL), name
        place, _, what = name.partition(" ")
        # ISO 11783-7 says where flow, state and fail-safe bits are; the rest is the machine's own, and it stays shut.
        if message.startswith("AUX_VALVE") and not place.endswith(".stamp"):
            assert why or what in ("twice", "narrow", "of degrees", "selected"), f"{name}: the machine would understand else"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "AUX_VALVE_1_COMMAND with bit 63",
            "AUX_VALVE_1_COMMAND: the runner has no value for more; expected flow, state, fail_safe",
        ),
        ("AUX_VALVE_2_COMMAND.stamp removed", "AUX_VALVE_2_COMMAND: no stamp, which other valve commands have"),
        ("MACHINE_STATUS.time removed", "stamp answers the machine's time, but MACHINE_STATUS has no time"),
        ("MACHINE_STATUS.echo shorter", "MACHINE_STATUS: echo has other values than counter of RUNNER_STATUS"),
        ("MACHINE_STATUS.dead_man scaled", "MACHINE_STATUS: dead_man is scaled; expected an unsigned integer"),
        ("AUX_VALVE_0_COMMAND.flow scaled", "AUX_VALVE_0_COMMAND: flow 250 is 200 %; expected 100 %"),
        ("AUX_VALVE_0_COMMAND.state moved", "(ISO 11783-7)"),
        ("DRAW_WIRES twice", "DRAW_WIRES: has the identifier of DRAW_WIRES, ANOTHER"),
        ("SLEW_SENSOR longer", "SLEW_SENSOR: has 12 bytes; expected 1 to 8 bytes"),
    ],
)
def test_the_message_and_signal_are_named(name: str, message: str, tmp_path: Path, line: VirtualLine) -> None:
    path = tmp_path / "machine.dbc"
    path.write_text(CASES[name], "utf-8")
    assert message in refused(path, line)


def test_values_come_in_si(tmp_path: Path, line: VirtualLine) -> None:
    """A database in degrees."""
    path = tmp_path / "degrees.dbc"
    old = '(1E-006,0) [-3.2|3.2] "rad" RUNNER\n SG_ counter : 24|8@1+'
    assert TEXT.count(old) == 1
    path.write_text(
        TEXT.replace(old, old.replace("1E-006", "5.729577951e-05").replace("3.2", "183.4").replace("rad", "deg")), "utf-8"
    )
    found = []
    for database in (DATABASE, path):
        transport = CanTransport(CanSettings(database, SIGNALS, VALVES, listen=0.05), bus=line, clock=line)
        transport.open()
        found.append(transport.read()[0]["slew.joint"].value)
    assert found[1] == pytest.approx(found[0], abs=1e-3)
    assert abs(found[0]) > 0.01


def test_an_alive_counter_without_its_last_value_goes_on(tmp_path: Path) -> None:
    """As in AUTOSAR: the value of all ones is none. Its 16th frame could not be sent."""
    path = tmp_path / "machine.dbc"
    text = TEXT.replace("SG_ counter : 0|8@1+ (1,0) [0|255]", "SG_ counter : 0|8@1+ (1,0) [0|253]")
    path.write_text(text.replace("SG_ echo : 24|8@1+ (1,0) [0|255]", "SG_ echo : 24|8@1+ (1,0) [0|253]"), "utf-8")
    bus = MachineBus(BusSettings(path, SIGNALS, VALVES), "runner.toml")
    counts = [bus.encode([0.0] * 4, True)[-1][1][0] for _ in range(600)]
    assert set(counts) == set(range(254))
