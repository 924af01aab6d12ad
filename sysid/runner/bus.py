"""Decode and encode frames by a machine's CAN database, and compute the bus load.

Valve commands follow ISO 11783-7 (PGN 65072 … 65079): flow in steps of 0.4 %, the port in the state, fail-safe bits. Any
message may have an alive counter, a signal ``counter``: a frame with an unchanged counter is not new.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sysid.config import Strict
from sysid.errors import SettingsError, nearest
from sysid.logs.can_signals import load_database

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal

Array = npt.NDArray[np.float64]

#: Auxiliary valve commands (ISO 11783-7) and their values.
FIRST_PGN, LAST_PGN = 65072, 65079
BLOCKED, EXTEND, RETRACT = 0, 1, 2
FAIL_SAFE_BLOCK, FAIL_SAFE_ERROR = 0, 2
#: Steps of full flow.
FULL = 250
#: An alive counter.
COUNTER = "counter"
#: In the machine's status: its time, and the newest alive counter that it received from the runner.
TIME, ECHO = "time", "echo"
#: In a valve command: the machine's time that it answers, modulo the signal's maximum. All ones: not known.
STAMP = "stamp"
#: J1939 two-bit states; other values are not available.
OFF, ON = 0, 1


@dataclass(frozen=True)
class BusSettings(Strict):
    """``[transport]`` of a machine on a CAN bus.

    Args:
        database: DBC file of the machine, relative to the recipe.
        signals: canonical signal → ``MESSAGE.signal`` of the database.
        valves: axis → its valve command message, in the order of the machine's axes.
        status: message with ``dead_man``, ``emergency_stop``, optionally ``fault``, ``time`` (of the machine's clock, s) and
            ``echo`` (the newest alive counter that the machine received).
        alive: message with ``counter`` and ``enabled`` that the runner sends.
        bitrate: [bit/s]. max_load: highest permitted bus load, with frames of maximum length.
    """

    database: Path
    signals: Mapping[str, str]
    valves: Mapping[str, str]
    status: str = "MACHINE_STATUS"
    alive: str = "RUNNER_STATUS"
    bitrate: int = 250_000
    max_load: float = 0.7


@dataclass(frozen=True)
class ReceivedFrame:
    """A decoded frame.

    Args:
        message: its name.
        values: canonical signal → SI value; for the status message its own signals.
        fresh: its alive counter has changed, or it has none.
        lost: frames missing before it, by its counter.
    """

    message: str
    values: Mapping[str, float]
    fresh: bool
    lost: int


class MachineBus:
    """Encoder and decoder of one machine.

    Raises:
        SettingsError: names that the database does not have, messages that are no valve commands, a bus load above the limit.
        InputError: no database.
    """

    def __init__(self, settings: BusSettings, where: str) -> None:
        self.settings, self.where = settings, where
        database = load_database(settings.database)
        self._messages = {message.name: message for message in database.messages}
        self.known = frozenset((message.frame_id, message.is_extended_frame) for message in database.messages)
        self._status = self._message(settings.status, "status", ("dead_man", "emergency_stop"))
        self._alive = self._message(settings.alive, "alive", (COUNTER, "enabled"))
        self.axes = tuple(settings.valves)
        self._valves = [self._valve(axis, name) for axis, name in settings.valves.items()]
        self.signals = tuple(settings.signals)
        self._sources: dict[str, dict[str, str]] = {}
        for signal, source in settings.signals.items():
            name, _, own = source.partition(".")
            self._message(name, f"signals.{signal!r}", (own,))
            self._sources.setdefault(name, {})[own] = signal
        #: Required messages, by identifier and whether it is an extended one.
        wanted = (self._status, *(self._messages[name] for name in self._sources))
        self.expected = {(message.frame_id, message.is_extended_frame): message for message in wanted}
        self._counted: dict[str, int] = {}
        self.sent_count = 0
        fields = [signal.name for signal in self._status.signals]
        #: Whether the status echoes the command counter, and whether valve commands have time stamps.
        self.echoes = ECHO in fields
        self.stamps = TIME in fields and all(STAMP in [signal.name for signal in valve.signals] for valve in self._valves)
        self.load = bus_load(database, settings.bitrate)
        if not self.load <= settings.max_load:
            raise SettingsError(
                f"{self.where}: bitrate",
                f"a bus load of {100 * self.load:.0f} % at {settings.bitrate} bit/s",
                f"at most {100 * settings.max_load:.0f} % (max_load)",
                "Raise the bit rate, or send less often (GenMsgCycleTime of the database).",
            )

    def _message(self, name: str, key: str, needed: Sequence[str]) -> Message:
        if name not in self._messages:
            raise SettingsError(
                f"{self.where}: {key}",
                f"{self.settings.database} has no message {name!r}",
                nearest(name, self._messages),
                "Is it the database of this machine?",
            )
        message = self._messages[name]
        names = [signal.name for signal in message.signals]
        for one in needed:
            if one not in names:
                raise SettingsError(f"{self.where}: {key}", f"message {name} has no signal {one!r}", nearest(one, names))
        return message

    def _valve(self, axis: str, name: str) -> Message:
        message = self._message(name, f"valves.{axis}", ("flow", "state", "fail_safe"))
        pgn = (message.frame_id >> 8) & 0x3FFFF
        if not message.is_extended_frame or not FIRST_PGN <= pgn <= LAST_PGN:
            raise SettingsError(
                f"{self.where}: valves.{axis}",
                f"{name} has PGN {pgn}",
                f"an auxiliary valve command of ISO 11783-7, PGN {FIRST_PGN} to {LAST_PGN}",
            )
        return message

    def decode(self, identifier: int, extended: bool, data: bytes) -> ReceivedFrame | None:
        """A decoded frame; None for messages that are not required.

        Raises:
            ValueError: it has another length than in the database, or cannot be decoded.
        """
        from cantools.database.errors import DecodeError

        message = self.expected.get((identifier, extended))
        if message is None:
            return None
        if len(data) != message.length:
            raise ValueError(f"{message.name} has {len(data)} bytes, {message.length} in the database")
        try:
            fields = message.decode(data, decode_choices=False)
        except DecodeError as error:
            raise ValueError(f"{message.name} cannot be decoded ({error})") from None
        assert isinstance(fields, dict)
        fresh, lost = self._count(message, fields)
        if message is self._status:
            return ReceivedFrame(message.name, {name: _number(value) for name, value in fields.items()}, fresh, lost)
        names = self._sources[message.name]
        return ReceivedFrame(message.name, {names[name]: _number(fields[name]) for name in names}, fresh, lost)

    def _count(self, message: Message, fields: Mapping[str, object]) -> tuple[bool, int]:
        if COUNTER not in fields:
            return True, 0
        count = int(_number(fields[COUNTER]))
        before = self._counted.get(message.name)
        self._counted[message.name] = count
        if before is None:
            return True, 0
        ahead = (count - before) % (1 << message.get_signal_by_name(COUNTER).length)
        return ahead > 0, max(ahead - 1, 0)

    def implausible(self, frame: ReceivedFrame) -> str:
        """A text about the first value outside its range in the database; "" if there is none."""
        for signal, value in frame.values.items():
            source = self.settings.signals.get(signal)
            own = self._messages[frame.message].get_signal_by_name(source.partition(".")[2] if source else signal)
            low, high = own.minimum, own.maximum
            if (
                low is not None
                and high is not None
                and low < high
                and not low - _half_step(own) <= value <= high + _half_step(own)
            ):
                return f"{frame.message}.{own.name} = {value:g} is outside of [{low:g}, {high:g}]"
        return ""

    def encode(self, commands: Sequence[float], enabled: bool, answered: float | None = None) -> list[tuple[int, bytes]]:
        """Frames (29-bit identifier, data) of a set of commands in [-1, 1], the status of the runner last.

        Not enabled, or with a command that is not finite: no flow, blocked, and fail-safe bits for an error.

        Args:
            answered: the machine's time that this set answers [s]; None: not known.
        """
        enabled = enabled and _finite(commands)
        safe = FAIL_SAFE_BLOCK if enabled else FAIL_SAFE_ERROR
        out = []
        for message, command in zip(self._valves, coded_commands(commands, enabled), strict=True):
            state = BLOCKED if command == 0.0 else EXTEND if command > 0.0 else RETRACT
            coded = {"flow": round(abs(command) * FULL), "state": state, "fail_safe": safe}
            if self.stamps:
                coded[STAMP] = _stamp(message.get_signal_by_name(STAMP), answered)
            # Not strict: the stamp for "not known" is above the signal's maximum.
            out.append((message.frame_id, bytes(message.encode(coded, scaling=False, padding=True, strict=False))))
        self.sent_count = (self.sent_count + 1) % (1 << self._alive.get_signal_by_name(COUNTER).length)
        coded = {COUNTER: self.sent_count, "enabled": ON if enabled else OFF}
        out.append((self._alive.frame_id, bytes(self._alive.encode(coded, scaling=False, padding=True))))
        return out


def coded_commands(commands: Sequence[float] | Array, enabled: bool) -> list[float]:
    """Commands in the steps of a valve command (0.4 %), limited to [-1, 1]; zeros if they are sent as not enabled."""
    if not (enabled and _finite(commands)):
        return [0.0] * len(commands)
    return [math.copysign(round(min(abs(float(command)), 1.0) * FULL) / FULL, command) for command in commands]


def _finite(commands: Sequence[float] | Array) -> bool:
    return all(math.isfinite(command) for command in commands)


def _stamp(signal: Signal, seconds: float | None) -> int:
    """``seconds`` in the signal's steps, rounded down: a stamp is never ahead of its clock."""
    unknown = (1 << signal.length) - 1
    if seconds is None or not math.isfinite(seconds):
        return unknown
    scale = float(signal.scale)
    turn = unknown if signal.maximum is None else min(unknown, round(float(signal.maximum) / scale) + 1)
    return math.floor(seconds / scale + 1e-6) % turn


def _number(value: object) -> float:
    assert isinstance(value, int | float)
    return float(value)


def _half_step(signal: Signal) -> float:
    """Half a quantisation step, for limits between two steps."""
    return 0.5 * abs(float(signal.scale))


def bus_load(database: Database, bitrate: int) -> float:
    """Share of the bus that all cyclic messages of ``database`` use, with the maximum of stuff bits."""
    return sum(
        frame_bits(message.length, message.is_extended_frame) * 1e3 / message.cycle_time
        for message in database.messages
        if message.cycle_time
    ) / bitrate  # fmt: skip


def frame_bits(length: int, extended: bool) -> int:
    """Most bits of a data frame of ``length`` bytes, interframe space included.

    Source: Tindell, Burns, Wellings, Calculating controller area network (CAN) message response times (1995), corrected by
    Davis et al. (2007): g + 8s + 13 + ⌊(g + 8s − 1)/4⌋ bits, g = 34 or 54 that can be stuffed besides the data.
    """
    stuffed = (54 if extended else 34) + 8 * length
    return stuffed + 13 + (stuffed - 1) // 4


def format_identifiers(identifiers: Iterable[tuple[int, bool]]) -> str:
    """Identifiers in hexadecimal."""
    return ", ".join(f"{number:08X}" if extended else f"{number:03X}" for number, extended in sorted(identifiers))
