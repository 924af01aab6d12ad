"""Fault injection between the runner and a machine, for tests of the supervisor.

Each fault is a frozen dataclass; a plan gives the times at which it is active.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid_rl.run.clock import SECOND
from sysid_rl.run.transport import MachineInputs, Measurement, Transport

Array = npt.NDArray[np.float64]
Readings = dict[str, Measurement]


@dataclass(frozen=True)
class DroppedFrames:
    """Frames are lost: readings keep their values. ``signals`` empty: all."""

    signals: tuple[str, ...] = ()


@dataclass(frozen=True)
class Frozen:
    """A sensor repeats one value."""

    signal: str


@dataclass(frozen=True)
class Delayed:
    """Readings are delayed by ``seconds``; with ``stamped`` false their stamps do not show it."""

    seconds: float
    signals: tuple[str, ...] = ()
    stamped: bool = True


@dataclass(frozen=True)
class NotANumber:
    """A sensor sends NaN."""

    signal: str


@dataclass(frozen=True)
class Jumped:
    """A sensor has the bias ``by`` [m or rad]."""

    signal: str
    by: float


@dataclass(frozen=True)
class Scaled:
    """A sensor has the scale ``factor`` about ``zero`` [m or rad]."""

    signal: str
    factor: float
    zero: float = 0.0


@dataclass(frozen=True)
class Swapped:
    """The cables of two sensors are swapped."""

    one: str
    other: str


@dataclass(frozen=True)
class ValvesSwapped:
    """The cables of the valves of two axes, by number, are swapped."""

    one: int
    other: int


@dataclass(frozen=True)
class ValveTurned:
    """The valve of an axis, by number, has reversed polarity."""

    axis: int


@dataclass(frozen=True)
class ValveDead:
    """The valve of an axis, by number, does not open."""

    axis: int


@dataclass(frozen=True)
class ValveShared:
    """The valves of two axes, by number, obey the command of ``one``."""

    one: int
    other: int


@dataclass(frozen=True)
class SensorShared:
    """The sensor ``one`` is read for ``other`` as well."""

    one: str
    other: str


@dataclass(frozen=True)
class Unplugged:
    """A sensor has no readings."""

    signal: str


@dataclass(frozen=True)
class BusOff:
    """The bus transmits nothing; ``silent``: without an error."""

    silent: bool = False


@dataclass(frozen=True)
class ReadFails:
    """Reading the line is an error; commands still arrive."""


@dataclass(frozen=True)
class WritesLost:
    """Commands do not arrive, without an error."""


@dataclass(frozen=True)
class Paused:
    """The process pauses for ``seconds``, once."""

    seconds: float


@dataclass(frozen=True)
class ClockJumped:
    """The machine's clock jumps by ``seconds``."""

    seconds: float


@dataclass(frozen=True)
class DeadManReleased:
    """The dead-man switch is released."""


@dataclass(frozen=True)
class EmergencyPressed:
    """The emergency stop is pressed."""


@dataclass(frozen=True)
class MachineReportsFault:
    """The machine reports a fault."""

    text: str = "valve driver"


Fault = (
    DroppedFrames | Frozen | Delayed | NotANumber | Jumped | Scaled | Unplugged | BusOff | ReadFails | WritesLost | Paused
    | ClockJumped | Swapped | ValvesSwapped | ValveTurned | ValveDead | ValveShared | SensorShared
    | DeadManReleased | EmergencyPressed | MachineReportsFault
)  # fmt: skip


@dataclass(frozen=True)
class Injection:
    """A fault, active from ``begin`` to ``end`` [s] after :meth:`FaultyTransport.start`, or after opening."""

    fault: Fault
    begin: float
    end: float = float("inf")


class FaultyTransport:
    """A transport with faults.

    Args:
        transport: of the machine.
        plan: the faults; several faults of one reading apply in this order.
    """

    def __init__(self, transport: Transport, plan: tuple[Injection, ...]) -> None:
        self.transport, self.plan = transport, plan
        self.signals, self.axes = transport.signals, transport.axes
        self._begin_ns = 0
        self._kept: dict[int, Readings] = {}
        self._late: deque[tuple[int, Readings]] = deque(maxlen=256)
        self._paused: set[int] = set()

    def open(self) -> None:
        self.transport.open()
        self.start()

    def start(self) -> None:
        """Set the origin of the plan's times to now."""
        self._begin_ns = self.transport.now_ns()
        self._kept.clear()
        self._paused.clear()

    def close(self) -> None:
        self.transport.close()

    def now_ns(self) -> int:
        return self.transport.now_ns()

    def wait_until(self, ns: int) -> None:
        for k, injection in enumerate(self.plan):
            begin = self._begin_ns + round(injection.begin * SECOND)
            if isinstance(injection.fault, Paused) and k not in self._paused and ns >= begin:
                self._paused.add(k)
                ns = max(ns, begin + round(injection.fault.seconds * SECOND))
        self.transport.wait_until(ns)

    def set_inputs(self, dead_man: bool | None = None, emergency_stop: bool | None = None) -> None:
        """Set the switches of the machine, if a program can."""
        getattr(self.transport, "set_inputs")(dead_man, emergency_stop)  # noqa: B009 - not every transport has it

    def read(self) -> tuple[Mapping[str, Measurement], MachineInputs]:
        given, inputs = self.transport.read()
        readings = dict(given)
        self._late.append((self.now_ns(), dict(given)))
        for k, fault in self._now():
            if k not in self._kept:
                self._kept[k] = dict(readings)
            self._change(readings, fault, self._kept[k])
            if isinstance(fault, ReadFails):
                raise OSError("the adapter does not read")
            if isinstance(fault, BusOff) and not fault.silent:
                inputs = replace(inputs, fault="bus off")
            elif isinstance(fault, MachineReportsFault):
                inputs = replace(inputs, fault=fault.text)
            elif isinstance(fault, DeadManReleased):
                inputs = replace(inputs, dead_man=False)
                self.set_inputs(dead_man=False)
            elif isinstance(fault, EmergencyPressed):
                inputs = replace(inputs, emergency_stop=True)
                self.set_inputs(emergency_stop=True)
        return readings, inputs

    def write(self, commands: Array, enabled: bool) -> Array:
        """As the line; returns the commands at this end of it, since the runner does not notice the fault."""
        sent = commands.copy() if enabled else np.zeros(len(commands))
        for _, fault in self._now():
            if isinstance(fault, WritesLost) or (isinstance(fault, BusOff) and fault.silent):
                return sent
            if isinstance(fault, BusOff):
                raise OSError("bus off")
        faults = [fault for _, fault in self._now()]
        wired = commands
        for fault in faults:
            wired = _wired(fault, wired)
        given = self.transport.write(wired, enabled)
        return sent if faults else given

    def _now(self) -> list[tuple[int, Fault]]:
        seconds = (self.now_ns() - self._begin_ns) / SECOND
        return [(k, item.fault) for k, item in enumerate(self.plan) if item.begin <= seconds < item.end]

    def _change(self, readings: Readings, fault: Fault, kept: Readings) -> None:
        if isinstance(fault, DroppedFrames | BusOff):
            wanted = fault.signals if isinstance(fault, DroppedFrames) and fault.signals else tuple(kept)
            readings.update({signal: kept[signal] for signal in wanted if signal in kept})
        elif isinstance(fault, Delayed):
            self._delay(readings, fault)
        elif isinstance(fault, ClockJumped):
            by = round(fault.seconds * SECOND)
            for signal, reading in readings.items():
                readings[signal] = replace(reading, measured_ns=reading.measured_ns + by)
        elif isinstance(fault, Swapped):
            if fault.one in readings and fault.other in readings:
                readings[fault.one], readings[fault.other] = readings[fault.other], readings[fault.one]
        elif isinstance(fault, SensorShared):
            if fault.one in readings and fault.other in readings:
                readings[fault.other] = replace(readings[fault.other], value=readings[fault.one].value)
        elif isinstance(fault, Unplugged):
            readings.pop(fault.signal, None)
        elif isinstance(fault, Frozen | NotANumber | Jumped | Scaled) and fault.signal in readings:
            reading = readings[fault.signal]
            readings[fault.signal] = replace(reading, value=_changed(fault, reading.value, kept))

    def _delay(self, readings: Readings, fault: Delayed) -> None:
        then = self.now_ns() - round(fault.seconds * SECOND)
        old = next((values for at, values in reversed(self._late) if at <= then), self._late[0][1])
        for signal in fault.signals or tuple(readings):
            if signal in old and signal in readings:
                fresh = readings[signal]
                readings[signal] = old[signal] if fault.stamped else replace(fresh, value=old[signal].value)


def _changed(fault: Frozen | NotANumber | Jumped | Scaled, value: float, kept: Readings) -> float:
    if isinstance(fault, Frozen):
        return kept[fault.signal].value if fault.signal in kept else value
    if isinstance(fault, Jumped):
        return value + fault.by
    return fault.zero + (value - fault.zero) * fault.factor if isinstance(fault, Scaled) else float("nan")


def _wired(fault: Fault, commands: Array) -> Array:
    """Commands (A,) as they reach the valves."""
    found = commands.copy()
    if isinstance(fault, ValvesSwapped):
        found[[fault.one, fault.other]] = commands[[fault.other, fault.one]]
    elif isinstance(fault, ValveTurned):
        found[fault.axis] = -commands[fault.axis]
    elif isinstance(fault, ValveDead):
        found[fault.axis] = 0.0
    elif isinstance(fault, ValveShared):
        found[fault.other] = commands[fault.one]
    return found
