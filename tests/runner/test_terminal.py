"""A terminal that is stopped or closed: nothing waits for it, and nothing that is sent is old."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import closing, suppress

import pytest
from runner_case import MIDDLE, RealTime, case, reopened
from test_endings import Sweep

from sysid_rl.run.cycle import Cycle
from sysid_rl.run.terminal import WAITING, Console, Terminal, redirected_output

pytestmark = pytest.mark.realtime

#: Longer than any terminal's buffer.
LINE = 4000 * "x"


@pytest.fixture(autouse=True)
def never_for_good() -> Iterator[None]:
    """What waits for a terminal would wait for ever."""

    def over(number: int, frame: object) -> None:
        raise TimeoutError("it waits for the terminal")

    before = signal.signal(signal.SIGALRM, over)
    signal.setitimer(signal.ITIMER_REAL, 20.0, 0.5)  # again and again: what ends by it waits for the terminal as well
    yield
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture
def ends() -> Iterator[tuple[int, int]]:
    """Both ends of a pseudo-terminal: a person's, and the runner's."""
    person, runner = os.openpty()
    yield person, runner
    for descriptor in (person, runner):
        with suppress(OSError):
            os.close(descriptor)


def words(terminal: Terminal, count: int) -> list[str]:
    """What was typed, once there are ``count`` words."""
    said: list[str] = []
    while len(said) < count:
        said += terminal.commands("ready", 0)
        time.sleep(0.002)
    return said


def test_typed_lines_are_words(ends: tuple[int, int]) -> None:
    with closing(Console(ends[1])) as console:
        terminal = Terminal(console, ends[1])
        os.write(ends[0], b"  ARM \n\nst")
        assert words(terminal, 1) == ["arm"]
        os.write(ends[0], b"op\n")
        assert words(terminal, 1) == ["stop"]
        terminal.notify("ready")
        seen = b""
        while b"ready\r\n" not in seen:
            seen += os.read(ends[0], 1000)


def test_nothing_waits_for_a_terminal_that_takes_nothing(ends: tuple[int, int]) -> None:
    console = Console(ends[1])
    with redirected_output(console):
        for _ in range(WAITING + 100):
            sys.stdout.write(LINE)
        sys.stderr.write(LINE)
    assert console.lost > 0
    console.close()


def test_a_person_who_is_gone_quits() -> None:
    reading, writing = os.pipe()
    terminal = Terminal(Console(2), reading)
    os.close(writing)
    assert words(terminal, 1) == ["quit: the terminal is closed (end of file)"]
    os.close(reading)


def test_a_terminal_that_cannot_be_written_quits() -> None:
    reading, writing = os.pipe()
    typed, typing = os.pipe()
    os.close(reading)
    console = Console(writing)
    terminal = Terminal(console, typed)
    terminal.notify("anybody there?")
    assert words(terminal, 1) == ["quit: the terminal is closed (Broken pipe)"]
    assert not terminal.commands("ready", 0)
    terminal.notify("nobody")
    assert console.lost == 1
    for descriptor in (writing, typing):
        os.close(descriptor)


def test_a_terminal_that_is_hung_up_quits(ends: tuple[int, int]) -> None:
    terminal = Terminal(Console(ends[1]), ends[1])
    os.close(ends[0])
    assert words(terminal, 1)[0].startswith("quit: the terminal is closed")


@pytest.mark.parametrize("how", ["stopped by Ctrl-S", "not read"])
def test_a_terminal_that_stops_opens_no_valve(ends: tuple[int, int], how: str) -> None:
    """In real time, on the simulated machine with its watchdog; the terminal is stopped in full motion, and goes on again."""
    person, runner = ends
    if how == "not read":
        tty.setraw(runner)
    console = Console(runner)
    made = case(lambda limits, chain: Sweep(1.0), kind=RealTime, operator=lambda machine: Terminal(console, runner))
    made.loop.warm_up(MIDDLE)
    reads = threading.Event()

    def reader() -> None:
        while reads.wait(10.0):
            try:
                os.read(person, 65536)
            except OSError:
                return

    def watch(cycle: Cycle) -> None:
        if cycle.state == "ready" and not made.machine.opened.count(True):
            os.write(person, b"arm\n")
        elif cycle.state == "armed":
            made.machine.set_inputs(dead_man=True)
        elif cycle.state == "running" and cycle.source == "sweep":
            stopped.append(cycle.number)
            if len(stopped) == 20:
                os.write(person, b"\x13")  # a person's Ctrl-S, or nobody who reads
                reads.clear()
            if 20 < len(stopped) < 60:
                made.operator.notify(LINE)
            if len(stopped) == 60:
                os.write(person, b"\x11")
                reads.set()
        elif cycle.state in ("ready", "fault") and stopped:
            os.write(person, b"quit\n")

    stopped: list[int] = []
    reads.set()
    threading.Thread(target=reader, daemon=True).start()
    made.loop.run(watch)
    assert len(stopped) >= 60, made.loop.outcome.notes
    assert reopened(made.machine.opened) == 0
    behind = [cycle.latency_ns for cycle in made.cycles if cycle.enabled and cycle.source != "dropped"]
    assert max(behind) < made.loop.supervisor.checks.expired.age_s * 1e9, "nothing that is sent is old"
