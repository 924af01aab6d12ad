"""``python -m simulated_bench live MACHINE.toml``: the simulated test bench as a process, in real time, on a serial line.

It opens a pseudo-terminal with slcan, as a CAN adapter does, and runs on its own clock: sensors and status are sent in every
cycle of its controller, commands act on arrival, and valves go neutral when commands stop. Actions of people at the machine
(dead-man switch, emergency stop, a cable unplugged) are written to a control pipe, one line each:

    dead_man 0|1 · emergency_stop 0|1 · drop MESSAGE COUNT · stuck MESSAGE 0|1 · unplug MESSAGE 0|1 · clock SECONDS · quit
    late_commands MS MS_PER_S · late_frames MS MS_PER_S · overtake 0|1 · swallow 0|1 · answers COUNT

The truth is written to a file: one line of JSON, then a row of ``COLUMNS`` in float64 for each cycle.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import select
import sys
import time
import tty
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from simulated_bench.live_bus import CanFrame, LiveBus, parse_line
from simulated_bench.live_line import LineFaults, parse_number
from simulated_bench.live_machine import LiveMachine, Watchdog
from simulated_bench.recipe import AXES, BenchRecipe
from simulated_bench.recipe_file import load_recipe
from sysid.errors import SysidError

Array = npt.NDArray[np.float64]

#: Lines that the control pipe accepts.
SWITCHES = (
    "dead_man", "emergency_stop", "drop", "stuck", "unplug", "clock", "late_commands", "late_frames", "overtake", "swallow",
    "answers", "quit",
)  # fmt: skip
#: Requested real-time priority (SCHED_FIFO).
PRIORITY = 60
#: After a delay longer than this the process does not catch up on missed cycles [ns].
_LONGEST_SLEEP_NS = 1_000_000_000
#: Columns of the truth file. Times are of the monotonic clock of the computer [ns]; ``asked`` are commands on the bus,
#: ``passed`` those behind the watchdog, ``counter`` and ``counter_ns`` the last alive counter and its arrival.
COLUMNS = (
    "at_ns",
    *(f"{name}.drive" for name in AXES),
    *(f"{name}.joint" for name in AXES),
    *(f"ee.{name}" for name in "xyz"),
    *(f"tool.{name}" for name in "xyz"),
    *(f"{name}.asked" for name in AXES),
    *(f"{name}.passed" for name in AXES),
    "enabled",
    "dead_man",
    "emergency_stop",
    "fault",
    "counter",
    "counter_ns",
)


@dataclass
class Switches:
    """State of the switches and faults that the control pipe sets."""

    dead_man: bool = False
    emergency_stop: bool = False
    drop: dict[str, int] = field(default_factory=dict)
    stuck: dict[str, bytes | None] = field(default_factory=dict)
    unplugged: set[str] = field(default_factory=set)
    #: By which the machine's clock was set [s].
    clock: float = 0.0
    line: LineFaults = field(default_factory=LineFaults)
    quit: bool = False

    def apply(self, line: str, bus: LiveBus) -> None:
        """Apply a line of the control pipe; ValueError or KeyError for an invalid one."""
        word, *rest = line.split()
        if word == "quit" and not rest:
            self.quit = True
        elif word in ("dead_man", "emergency_stop"):
            (value,) = rest
            setattr(self, word, bool(int(value)))
        elif word == "clock":
            (value,) = rest
            self.clock += parse_number(value)
        elif word not in ("drop", "stuck", "unplug"):
            self.line.apply(word, rest)
        else:
            name, count = rest
            bus.identifier(name)
            if word == "drop":
                self.drop[name] = int(count)
            elif word == "stuck":
                self.stuck.pop(name, None)
                if int(count):
                    self.stuck[name] = None
            else:
                (self.unplugged.add if int(count) else self.unplugged.discard)(name)

    def through(self, name: str, frame: CanFrame) -> CanFrame | None:
        """``frame`` of message ``name`` with the faults applied; None where it is lost."""
        if name in self.unplugged:
            return None
        if self.drop.get(name, 0) > 0:
            self.drop[name] -= 1
            return None
        if name in self.stuck:
            held = self.stuck[name]
            self.stuck[name] = held = frame.data if held is None else held
            return CanFrame(frame.identifier, frame.extended, held)
        return frame


class SerialLine:
    """The machine's end of a pseudo-terminal with slcan; nothing is sent before the other end has opened the bus."""

    def __init__(self, link: Path) -> None:
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)
        self.name = os.ttyname(self._slave)
        with contextlib.suppress(FileNotFoundError):
            link.unlink()
        link.symlink_to(self.name)
        self._link = link
        self._rest = self._unsent = b""
        self.open = False

    def receive(self) -> list[CanFrame]:
        """Received frames; the bus is opened and closed by ``O`` and ``C``, other lines are ignored, as adapters do."""
        with contextlib.suppress(BlockingIOError):
            self._rest += os.read(self.master, 65536)
        *lines, self._rest = self._rest.split(b"\r")
        # An incomplete line is kept, up to this length.
        self._rest = self._rest[-64:]
        frames = []
        for line in lines:
            if line in (b"O", b"C"):
                self.open, self._unsent = line == b"O", b""
            elif self.open and (frame := parse_line(line)) is not None:
                frames.append(frame)
        return frames

    def send(self, frames: list[CanFrame]) -> None:
        """Send whole frames; like an adapter with a full buffer, frames that the line does not accept are lost."""
        if not self.open:
            return
        self._unsent = self._unsent[self._taken(self._unsent) :]
        if not self._unsent:
            lines = b"".join(frame.line() for frame in frames)
            taken = self._taken(lines)
            end = lines.rfind(b"\r", 0, taken) + 1
            if end < taken:  # a partly sent frame has to be completed; those after it are lost
                self._unsent = lines[taken : lines.index(b"\r", taken) + 1]

    def acknowledge(self, count: int) -> None:
        """Acknowledge ``count`` frames, as some adapters do."""
        if self.open and not self._unsent:
            self._unsent = (b"Z\r" * count)[self._taken(b"Z\r" * count) :]

    def _taken(self, lines: bytes) -> int:
        """Number of bytes of ``lines`` that the line accepted."""
        try:
            return os.write(self.master, lines) if lines else 0
        except BlockingIOError:
            return 0

    def close(self) -> None:
        with contextlib.suppress(FileNotFoundError):
            self._link.unlink()
        os.close(self.master)
        os.close(self._slave)


class LiveProcess:
    """Machine, watchdog, bus and switches, cycle after cycle by the clock.

    Args:
        database: of the bus (DBC).
        seed: of the noise.
        survey: with inclinometers and a tracker of the boom tip on the bus.
    """

    def __init__(self, recipe: BenchRecipe, database: Path, seed: int = 0, survey: bool = False) -> None:
        self.machine = LiveMachine(recipe, seed)
        self.machine.advance(np.zeros((self.machine.steps, len(AXES))))  # compile before the first cycle
        self.bus = LiveBus(database, survey)
        self.watchdog, self.switches = Watchdog(), Switches()
        self._step_ns = round(self.machine.step * 1e9)
        self.cycle_ns = self.machine.steps * self._step_ns
        self._events: list[tuple[int, CanFrame]] = []
        self._counter_ns = 0
        self.cycles = 0

    def received_frames(self, frames: list[CanFrame], now_ns: int) -> None:
        """Queue frames that are received at ``now_ns``; they act when the line has carried them."""
        line = self.switches.line
        if not line.swallows:
            self._events += [(now_ns + line.commands.at(now_ns), frame) for frame in frames]

    def cycle(self, end_ns: int) -> tuple[list[CanFrame], Array]:
        """Simulate the cycle that ends at ``end_ns``; returns the frames to send and the row of the truth."""
        machine, switches, watchdog = self.machine, self.switches, self.watchdog
        clock = machine.seconds + switches.clock
        commands = np.empty((machine.steps, len(AXES)))
        for step in range(machine.steps):
            now = end_ns - self.cycle_ns + step * self._step_ns
            while self._events and self._events[0][0] <= now:
                received_ns, frame = self._events.pop(0)
                self._take(received_ns, frame, clock + (received_ns - end_ns + self.cycle_ns) * 1e-9)
            # The emergency stop removes the pilot pressure.
            commands[step] = watchdog.passed(now) * (not switches.emergency_stop)
        machine.advance(commands)
        self.cycles += 1
        status = {
            "dead_man": float(switches.dead_man),
            "emergency_stop": float(switches.emergency_stop),
            "fault": float(watchdog.fault),
            "time": (machine.seconds + switches.clock) % self.bus.clock_period,
            "echo": float(max(watchdog.counter, 0)),
        }
        frames = self.bus.frames(machine.readings(), self.cycles, status)
        switch_states = (switches.dead_man, switches.emergency_stop, watchdog.fault, watchdog.counter, self._counter_ns)
        row = np.concatenate([[end_ns], machine.truth, watchdog.commanded, commands[-1], [watchdog.enabled], switch_states])
        return [sent for frame in frames if (sent := switches.through(self.bus.name(frame), frame)) is not None], row

    def _take(self, received_ns: int, frame: CanFrame, seconds: float) -> None:
        """Process a frame that arrived at ``received_ns``, ``seconds`` on the machine's clock."""
        if (valve := self.bus.valve(frame)) is not None:
            age = self.bus.age(frame, seconds % self.bus.clock_period)
            self.watchdog.command(*valve, received_ns, round(min(age, 1e3) * 1e9))
        elif (status := self.bus.status(frame)) is not None:
            if status[0] != self.watchdog.counter:
                self._counter_ns = received_ns
            self.watchdog.alive(*status, received_ns)


def run_live(options: argparse.Namespace) -> None:
    """Run until ``quit`` or the end of ``options.seconds``.

    Raises:
        SysidError: an invalid recipe or database.
    """
    process = LiveProcess(load_recipe(options.machine), options.database, options.seed, options.survey)
    # Real-time priority, where it is permitted.
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    if not options.control.exists():
        os.mkfifo(options.control)
    # Open for writing as well, so that the pipe does not end when a writer closes it.
    control = os.open(options.control, os.O_RDWR | os.O_NONBLOCK)
    line = SerialLine(options.pty)
    rest = b""
    with options.truth.open("wb", buffering=0) as truth:
        head = {"columns": COLUMNS, "machine": process.machine.recipe.name, "cycle_ns": process.cycle_ns}
        truth.write(json.dumps(head).encode() + b"\n")
        sys.stdout.write(f"ready {line.name}\n")
        sys.stdout.flush()
        due = time.monotonic_ns() + process.cycle_ns
        end = due + options.seconds * 1e9
        try:
            while due < end and not process.switches.quit:
                faults = process.switches.line
                while (now := time.monotonic_ns()) < due:
                    line.send(faults.arrived(now))
                    until = min(due, faults.due_ns() or due)
                    ready, _, _ = select.select([line.master, control], [], [], max(0, until - now) * 1e-9)
                    if line.master in ready:
                        received = line.receive()
                        if faults.swallows:
                            line.acknowledge(len(received))
                        process.received_frames(received, time.monotonic_ns())
                    if control in ready:
                        *lines, rest = (rest + os.read(control, 4096)).split(b"\n")
                        _apply_switches(lines, process)
                frames, row = process.cycle(due)
                process.switches.line.sent(frames, process.bus.identifier("MACHINE_STATUS"), process.cycles, due)
                line.send(process.switches.line.arrived(due))
                line.acknowledge(process.switches.line.answers)
                truth.write(row.tobytes())
                due += process.cycle_ns
                if time.monotonic_ns() - due > _LONGEST_SLEEP_NS:
                    due = time.monotonic_ns()  # do not catch up
        finally:
            line.close()
            os.close(control)


def _apply_switches(lines: list[bytes], process: LiveProcess) -> None:
    for line in lines:
        try:
            process.switches.apply(line.decode(), process.bus)
        except (ValueError, KeyError, TypeError):
            sys.stderr.write(f"control: {line!r} is none of {', '.join(SWITCHES)}\n")


def read_truth(path: Path) -> dict[str, Array]:
    """Columns of a truth file, which may be incomplete."""
    data = path.read_bytes()
    start = data.index(b"\n") + 1
    columns = json.loads(data[:start])["columns"]
    width = 8 * len(columns)
    rows = np.frombuffer(data, np.float64, count=(len(data) - start) // width * len(columns), offset=start)
    return dict(zip(columns, rows.reshape(-1, len(columns)).T, strict=True))


def main(arguments: list[str]) -> int:
    """Exit status: 0 at the end, 2 for invalid arguments."""
    parser = argparse.ArgumentParser(prog="python -m simulated_bench live", description="The test bench in real time.")
    parser.add_argument("machine", type=Path, help="bench recipe (TOML)")
    parser.add_argument("--database", type=Path, required=True, help="CAN database of the machine (DBC)")
    parser.add_argument("--pty", type=Path, required=True, help="link to create to the serial line (slcan)")
    parser.add_argument("--control", type=Path, required=True, help="pipe for switches and faults, created where it is missing")
    parser.add_argument("--truth", type=Path, required=True, help="file for the true motion")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="duration of the run")
    parser.add_argument("--seed", type=int, default=0, help="seed of the noise")
    parser.add_argument("--survey", action="store_true", help="with inclinometers and a tracker of the boom tip on the bus")
    try:
        run_live(parser.parse_args(arguments))
    except SysidError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0
