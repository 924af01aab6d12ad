"""A machine on a CAN bus, through any local adapter of python-can (socketcan, slcan, pcan, kvaser …).

Before the first command the transport listens: every message that the recipe maps must arrive with a changing counter and
values inside the database's range, and no unknown identifier may appear. The database of another machine fails this test.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError, SettingsError, nearest
from sysid_rl.run.bus import COUNTER, ECHO, ON, TIME, BusSettings, MachineBus, ReceivedFrame, coded_commands, format_identifiers
from sysid_rl.run.clock import SECOND, Clock, MonotonicClock
from sysid_rl.run.line_delay import CommandRoundTrip, MachineClock
from sysid_rl.run.serial_line import OtherReaders, device_channel, lock_channel, require_alone
from sysid_rl.run.transport import RELEASED_INPUTS, MachineInputs, Measurement

if TYPE_CHECKING:
    from can import BusABC, Message
    from filelock import BaseFileLock

Array = npt.NDArray[np.float64]

#: Interfaces of python-can that use a network; commands to a machine are not sent through it.
NETWORKED = ("udp_multicast", "socketcand", "remote", "zmq")
#: Options that other keys set, or that would let the loop wait.
OWN_OPTIONS = {"interface", "channel", "bitrate", "timeout", "config_context", "ignore_config"}
#: Without a status for this time the switches count as released [ns].
STATUS_TIME_OUT_NS = 100_000_000
#: Without a status for this time other programs on the line are searched for [ns].
LOSS_NS = 25_000_000
#: Error frame of socketcan: the controller is off the bus (CAN_ERR_BUSOFF).
_BUS_OFF = 0x40
#: Time between two looks at the line while listening [ns].
LISTEN_STEP_NS = 2_000_000
#: Longest wait of a frame for the adapter [s]; half of the machine's time-out.
_SEND = 0.05
#: Most frames read in one cycle: a busy bus may not delay the loop.
_FRAMES = 256


@dataclass(frozen=True)
class CanSettings(BusSettings):
    """``[transport]`` with an adapter.

    Args:
        interface, channel: of python-can: ``slcan`` and ``/dev/ttyACM0``, ``socketcan`` and ``can0``.
        options: further options of that interface.
        listen: listening time before anything is sent [s].
        control: control pipe of a simulated test bench (its switches).
    """

    interface: str = "slcan"
    channel: str = ""
    options: Mapping[str, str | int | float | bool] = field(default_factory=dict)
    listen: float = 0.5
    control: Path | None = None


class Bus(Protocol):
    """What is used of an open bus of python-can."""

    def recv(self, timeout: float | None = None) -> Message | None: ...

    def send(self, msg: Message, timeout: float | None = None) -> None: ...

    def shutdown(self) -> None: ...


class CanTransport:
    """See :class:`sysid_rl.run.transport.Transport`. Stamps of the machine are mapped to the clock of this end of the line.

    Args:
        settings: ``[transport]`` of the recipe, paths resolved.
        where: the recipe, for messages.
        bus: an open bus instead of that of the settings.
        clock: of this end; by default the computer's monotonic clock. A simulated machine may bring its own.

    Raises:
        SettingsError: settings that do not fit the database, a bus load above the limit, a network interface, impossible
            values.
    """

    def __init__(
        self, settings: CanSettings, where: str = "[transport]", bus: Bus | None = None, clock: Clock | None = None
    ) -> None:
        self.settings, self.where = settings, where
        clock = clock or MonotonicClock()
        self.now_ns, self.wait_until = clock.now_ns, clock.wait_until
        _check_settings(settings, where)
        self.machine = MachineBus(settings, where)
        self.signals, self.axes = self.machine.signals, self.machine.axes
        self._bus: Bus | None = bus
        self._lock: BaseFileLock | None = None
        self._readings: dict[str, Measurement] = {}
        self._counts = dict.fromkeys(self.signals, 0)
        self._status: ReceivedFrame | None = None
        self._status_ns = 0
        self._clock, self._round_trip = MachineClock(self.machine.period, self.machine.clock), CommandRoundTrip()
        self._read_ns = 0
        #: Errors that ended reading and sending: a line that cannot be read may still transmit the fail-safe bits.
        self._fault, self._send_fault = "", ""
        self._commanded = False
        #: Numbers of lost frames (by alive counters) and malformed frames; unknown identifiers.
        self.lost = self.malformed = 0
        self.unknown: set[tuple[int, bool]] = set()
        self._readers = OtherReaders(settings.channel)
        self._malformed_text = ""

    @property
    def remarks(self) -> tuple[str, ...]:
        """What this machine cannot check, one sentence each."""
        found, settings = [], self.settings
        if not self.machine.echoes:
            found.append(f"{settings.status} has no {ECHO}: commands that arrive late are detected by the motion only")
        if not self.machine.clock:
            found.append(
                f"{settings.status} has no {TIME}, and no cyclic {COUNTER}: late readings are detected by the motion only"
            )
        elif not self.machine.timed:
            found.append(
                f"{settings.status} has no {TIME}: a delay is measured by its count, one from the beginning by the motion only"
            )
        if not self.machine.stamps:
            found.append("the valve commands have no stamp: the machine executes delayed commands")
        return tuple(found)

    def open(self) -> None:
        """Open the adapter and listen.

        Raises:
            InputError: no such adapter, or traffic that does not fit the database.
        """
        if self._bus is None:
            self._lock = lock_channel(self.settings.interface, self.settings.channel, self.where)
            try:
                require_alone(self.settings.channel, self.where)
                self._bus = _open(self.settings)
            except InputError:
                self._lock.release()
                raise
            except Exception as error:  # whatever a driver raises
                self._lock.release()
                place = f"{self.where}: {self.settings.interface} {self.settings.channel}"
                found = f"cannot be opened ({str(error) or type(error).__name__})"
                raise InputError(
                    place, found, "a CAN adapter at this computer", "Is it there, and do the options fit it?"
                ) from None
        self._listen()

    def _listen(self) -> None:
        """Raise InputError unless the traffic fits the database."""
        received: dict[str, int] = {}
        wrong: list[str] = []
        end = self.now_ns() + round(self.settings.listen * SECOND)
        while self.now_ns() < end:
            for item in self._receive():
                received[item.message] = received.get(item.message, 0) + item.fresh
                if (text := self.machine.implausible(item)) and text not in wrong:
                    wrong.append(text)
            if self._fault or self._malformed_text:
                break
            self.wait_until(self.now_ns() + LISTEN_STEP_NS)
        if self._malformed_text:
            wrong.insert(0, self._malformed_text)
        if text := self._clock.late(self.now_ns()):
            wrong.append(text)
        for message in self.machine.expected.values():
            due = self.settings.listen * 1e3 / (message.cycle_time or 1e3 * self.settings.listen)
            # The first frame counts as fresh whatever its counter.
            if received.get(message.name, 0) < max(1, min(2, math.floor(due / 2))):
                wrong.append(f"{message.name} is missing" if message.name not in received else f"{message.name} repeats itself")
        if self.unknown:
            wrong.append(f"the database does not know {format_identifiers(self.unknown)}")
        if self._fault:
            wrong.insert(0, self._fault)
        if wrong:
            self.close()
            raise InputError(
                f"{self.where}: {self.settings.channel or self.settings.interface}",
                "; ".join(wrong[:4]),
                f"the messages of {self.settings.database}",
                "Is the machine on, at this bit rate, is this its database, and does no other program read the line?",
            )

    def read(self) -> tuple[Mapping[str, Measurement], MachineInputs]:
        self._receive()
        self._read_ns = self.now_ns()
        return dict(self._readings), self._inputs()

    def _receive(self) -> list[ReceivedFrame]:
        """Read the waiting frames; an error of the line becomes the fault that :meth:`read` reports until the bus is reopened.

        Any exception of the adapter's driver is such an error: it may not end a run without a ramp.
        """
        received: list[ReceivedFrame] = []
        if self._bus is None or self._fault:
            return received
        try:
            for _ in range(_FRAMES):
                frame = self._bus.recv(0)
                if frame is None:
                    break
                if (item := self._frame(frame)) is not None:
                    received.append(item)
        except Exception as error:
            self._fault = f"bus: {str(error) or type(error).__name__}"
        return received

    def _frame(self, frame: Message) -> ReceivedFrame | None:
        now = self.now_ns()
        if frame.is_error_frame:
            if frame.arbitration_id & _BUS_OFF:
                self._fault = "bus off"
            return None
        identity = (frame.arbitration_id, frame.is_extended_id)
        if identity not in self.machine.known:
            self.unknown.add(identity)
            return None
        try:
            item = self.machine.decode(*identity, bytes(frame.data))
        except ValueError as error:  # its readings age
            self.malformed += 1
            self._malformed_text = f"{error}"
            return None
        if item is None:
            return None
        self.lost = max(0, self.lost + item.lost)
        if not item.fresh:
            return item
        if item.message == self.settings.status:
            self._status, self._status_ns = item, now
            self._clock.tick(self.machine.seconds(item), now)
            if self.machine.echoes:
                self._round_trip.echoed(int(item.values[ECHO]), now)
            return item
        measured = self._clock.measured(now)
        for signal, value in item.values.items():
            self._counts[signal] += 1
            self._readings[signal] = Measurement(value, measured, now, self._counts[signal])
        return item

    def _inputs(self) -> MachineInputs:
        if self._status is None or self._fault:
            return replace(RELEASED_INPUTS, fault=self._fault or "no status of the machine")
        values = self._status.values
        now = self.now_ns()
        late = now - self._status_ns > STATUS_TIME_OUT_NS
        if now - self._status_ns > LOSS_NS:
            self._readers.search(now)
        # Two bits each: off, on, error, not available. The last two count as the safe state.
        dead_man = int(values["dead_man"]) == ON and not late
        pressed = int(values["emergency_stop"]) != 0
        text = self._readers.text or (
            "no status of the machine" if late else self._round_trip.late(now) or self._clock.late(now)
        )
        if not text and (code := int(values.get("fault", 0.0))):
            text = self._fault_text(code)
        return MachineInputs(dead_man, pressed, text)

    def _fault_text(self, code: int) -> str:
        """The text of a fault code of the machine."""
        status = next(m for m in self.machine.expected.values() if m.name == self.settings.status)
        choices: Mapping[int, Any] = status.get_signal_by_name("fault").choices or {}
        return f"machine: {choices.get(code, code)}"

    def write(self, commands: Array, enabled: bool) -> Array:
        from can import Message

        if self._bus is None or self._send_fault:
            raise OSError(self._send_fault or "the bus is not open")
        self._commanded = True
        # The commands answer the readings of this cycle: the stamp shows a delay since then to the machine.
        answered = self._clock.now(self._read_ns)
        try:
            for identifier, data in self.machine.encode([float(command) for command in commands], enabled, answered):
                self._bus.send(Message(arbitration_id=identifier, is_extended_id=True, data=data), timeout=_SEND)
        except Exception as error:  # see _receive
            self._send_fault = f"bus: {str(error) or type(error).__name__}"
            self._fault = self._fault or self._send_fault
            raise OSError(self._send_fault) from error
        if self.machine.echoes:
            self._round_trip.sent(self.machine.sent_count, self.now_ns())
        return np.array(coded_commands(commands, enabled))

    def set_inputs(self, dead_man: bool | None = None, emergency_stop: bool | None = None) -> None:
        """Set the switches of a simulated test bench.

        Raises:
            SettingsError: the machine has no control pipe: a person holds its switches.
        """
        if self.settings.control is None:
            raise SettingsError(f"{self.where}: control", "none", "the control pipe of a simulated test bench")
        lines = [f"{name} {int(value)}\n" for name, value in (("dead_man", dead_man), ("emergency_stop", emergency_stop))
                 if value is not None]  # fmt: skip
        pipe = os.open(self.settings.control, os.O_WRONLY | os.O_NONBLOCK)
        try:
            os.write(pipe, "".join(lines).encode())
        finally:
            os.close(pipe)

    def close(self) -> None:
        """Send the fail-safe state if commands were sent, and close the bus. May be called again.

        If the machine does not receive it, its own time-out closes the valves.
        """
        if self._bus is None:
            return
        try:
            if self._commanded and not self._send_fault:
                self.write(np.zeros(len(self.axes)), enabled=False)
        except OSError as error:
            self._fault = str(error)
        try:
            self._bus.shutdown()
        except Exception as error:  # a missing adapter cannot be closed
            self._fault = self._fault or f"bus: {str(error) or type(error).__name__}"
        self._bus = None
        if self._lock is not None:
            self._lock.release()


def _open(settings: CanSettings) -> BusABC:
    from can import Bus

    channel = device_channel(settings.channel)
    options: dict[str, Any] = dict(settings.options)
    if settings.interface == "slcan":
        from sysid_rl.run.slcan import SlcanBus

        # Some serial boards need a wait after opening: an option. Reading never waits.
        options = {"sleep_after_open": 0.0, "timeout": 0.0} | options
        return SlcanBus(channel, bitrate=settings.bitrate, **options)
    if settings.interface != "socketcan":
        options["bitrate"] = settings.bitrate
    # The recipe describes the bus completely, without configuration files of python-can.
    return Bus(interface=settings.interface, channel=channel, ignore_config=True, **options)


def _check_settings(settings: CanSettings, where: str) -> None:
    """Raise SettingsError for an adapter that uses a network or is unknown, impossible numbers, and options of the runner."""
    from can import VALID_INTERFACES

    far = "://" in settings.channel
    if settings.interface in NETWORKED or far:
        raise SettingsError(
            f"{where}: {'channel' if far else 'interface'}",
            f"{settings.channel if far else settings.interface!r} uses a network",
            "a CAN adapter at this computer (socketcan, slcan, pcan, kvaser …)",
            "A network can delay commands, or transmit those of somebody else.",
        )
    if settings.interface not in VALID_INTERFACES:
        raise SettingsError(
            f"{where}: interface", repr(settings.interface), nearest(settings.interface, sorted(VALID_INTERFACES))
        )
    for key, found, low, high in (
        ("bitrate", settings.bitrate, 10_000, 1_000_000),
        ("listen", settings.listen, 0.0, 60.0),
        ("max_load", settings.max_load, 0.01, 1.0),
    ):
        if not low <= found <= high:
            raise SettingsError(f"{where}: {key}", f"{found:g}", f"{low:g} to {high:g}")
    if own := sorted(OWN_OPTIONS & settings.options.keys()):
        raise SettingsError(f"{where}: options.{own[0]}", "is set by the runner", "other options of python-can's interface")
