"""The simulated test bench and the runner's transport in one process, on one virtual clock: a line without a serial device."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import can
import numpy as np
from live_machine import DATABASE, ROOT, SIGNALS, VALVES

from simulated_bench.live import LiveProcess
from simulated_bench.live_bus import CanFrame
from simulated_bench.recipe_file import load_recipe
from sysid_rl.run.can import CanSettings, CanTransport

MS = 1_000_000
CYCLE = 10 * MS


@dataclass
class VirtualLine:
    """The machine's end: clock and bus of the transport. Lines of the control pipe inject faults."""

    database: Path = DATABASE
    jitter_ms: float = 0.0
    now: int = 0

    def __post_init__(self) -> None:
        self.process = LiveProcess(load_recipe(ROOT / "datasets/autolog/bench.toml"), self.database)
        self.status = self.process.bus.identifier("MACHINE_STATUS")
        self._due = CYCLE
        self._arrived: list[CanFrame] = []
        self._rng = np.random.default_rng(0)

    def tell(self, *lines: str) -> None:
        for line in lines:
            self.process.switches.apply(line, self.process.bus)

    def now_ns(self) -> int:
        return self.now

    def wait_until(self, ns: int) -> None:
        faults = self.process.switches.line
        while self._due <= ns:
            frames, _ = self.process.cycle(self._due)
            late = round(self._rng.uniform(0.0, self.jitter_ms) * MS)
            faults.sent(frames, self.status, self.process.cycles, self._due + late)
            self._due += CYCLE
        self.now = max(self.now, ns)
        self._arrived += faults.arrived(self.now)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if not self._arrived:
            return None
        frame = self._arrived.pop(0)
        return can.Message(arbitration_id=frame.identifier, is_extended_id=frame.extended, data=frame.data)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.process.received_frames([CanFrame(msg.arbitration_id, msg.is_extended_id, bytes(msg.data))], self.now)

    def shutdown(self) -> None:
        """Nothing to close."""


@dataclass
class VirtualRun:
    """A transport on a virtual line, opened; commands every cycle."""

    line: VirtualLine
    database: Path | None = None
    channel: str = ""
    #: Second of the first fault text, that text, and age of the oldest reading in each cycle [s].
    fault_s: float | None = None
    fault: str = ""
    ages: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        settings = CanSettings(self.database or self.line.database, SIGNALS, VALVES, channel=self.channel)
        self.transport = CanTransport(settings, bus=self.line, clock=self.line)
        self.transport.open()
        self.line.tell("dead_man 1")

    def go(self, seconds: float, command: float = 0.2) -> VirtualRun:
        """Read and command for so long, 1 ms after the machine's cycles."""
        begin = self.line.now
        for k in range(1, round(seconds * 100) + 1):
            self.line.wait_until(begin // CYCLE * CYCLE + k * CYCLE + MS)
            readings, inputs = self.transport.read()
            self.ages.append(max(self.line.now - reading.measured_ns for reading in readings.values()) * 1e-9)
            if inputs.fault and self.fault_s is None:
                self.fault_s, self.fault = (self.line.now - begin) * 1e-9, inputs.fault
            self.transport.write(np.full(4, command), True)
        return self

    def stale_s(self, after_s: float = 0.045) -> float | None:
        """Second of the first cycle with a reading older than ``after_s``."""
        return next((0.01 * k for k, age in enumerate(self.ages) if age > after_s), None)
