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
from sysid_rl.run.database_check import SHORTEST_PERIOD_S, DatabaseCheck, factor_of, signal_of, values_of

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
VALVE_SIGNALS = ("flow", "state", "fail_safe")
#: A frame that was overtaken is at most so many behind by its counter; one with fewer values than :data:`WIDE` cannot tell.
OVERTAKEN, WIDE = 5, 32
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
        fresh: newer than those before it by its alive counter, or it has none.
        lost: frames missing before it, by its counter; −1 for one that was counted as missing and was only overtaken.
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
        self._factors = {
            name: {own: factor_of(self._messages[name].get_signal_by_name(own)) for own in sources}
            for name, sources in self._sources.items()
        }
        self._counted: dict[str, int] = {}
        self.sent_count = 0
        #: Whether the status echoes the command counter, and whether valve commands have time stamps.
        self.echoes = signal_of(self._status, ECHO) is not None
        self.stamps = any(signal_of(valve, STAMP) is not None for valve in self._valves)
        self._check(DatabaseCheck(where), wanted, database.messages)
        #: Whether the status has the machine's time; period of that or of the count of cycles [s], and its name ("": neither).
        self.timed = signal_of(self._status, TIME) is not None
        self.period, self.clock = self._clock()
        self.load = bus_load(database, settings.bitrate)
        if not self.load <= settings.max_load:
            raise SettingsError(
                f"{self.where}: bitrate",
                f"a bus load of {100 * self.load:.0f} % at {settings.bitrate} bit/s",
                f"at most {100 * settings.max_load:.0f} % (max_load)",
                "Raise the bit rate, or send less often (GenMsgCycleTime of the database).",
            )

    def _check(self, check: DatabaseCheck, wanted: Sequence[Message], every: Sequence[Message]) -> None:
        """Raise SettingsError unless each message of a run can be sent or read as it is."""
        valves, alive, status = self._valves, self._alive, self._status
        check.layout([*wanted, alive, *valves], every)
        for message in wanted:
            check.whole(message, COUNTER)
            check.decodes(message)
        for name in ("dead_man", "emergency_stop", "fault", ECHO):
            check.whole(status, name)
        for name in (COUNTER, "enabled"):
            check.whole(alive, name)
        check.sent(alive, (COUNTER, "enabled"))
        count = alive.get_signal_by_name(COUNTER)
        if self.echoes:
            if values_of(status.get_signal_by_name(ECHO)) != values_of(count):
                found = f"{ECHO} has other values than {COUNTER} of {alive.name}"
                raise check.refuse(status, found, "the same bits and the same maximum")
            check.period(alive, COUNTER, values_of(count) * (alive.cycle_time or 10) * 1e-3)
        if signal_of(status, TIME) is not None:
            check.seconds(status, TIME)
        for valve in valves:
            check.sent(valve, VALVE_SIGNALS, (STAMP,))
            for name in VALVE_SIGNALS[1:]:
                check.whole(valve, name)
            if self.stamps:
                self._check_stamp(check, valve)
        self._check_encoding(check)

    def _check_stamp(self, check: DatabaseCheck, valve: Message) -> None:
        if signal_of(valve, STAMP) is None:
            raise check.refuse(valve, f"no {STAMP}, which other valve commands have", f"{STAMP} in each of them, or in none")
        if signal_of(self._status, TIME) is None:
            found = f"{STAMP} answers the machine's time, but {self._status.name} has no {TIME}"
            raise check.refuse(valve, found, f"{TIME} in {self._status.name}, or no {STAMP}")
        check.seconds(valve, STAMP)

    def _check_encoding(self, check: DatabaseCheck) -> None:
        """Raise SettingsError unless neutral and extreme commands, stamps and counters are in their frames."""
        number = values_of(self._alive.get_signal_by_name(COUNTER))
        for command in (0.0, 1.0 / FULL, 1.0, -1.0):
            for enabled, answered, count in ((True, None, 1), (True, 0.0, 0), (True, 1e6, number - 1), (False, 1e6, 1)):
                self.sent_count = count - 1
                wanted = [self._coded(valve, command * enabled, enabled, answered) for valve in self._valves]
                wanted.append({COUNTER: count, "enabled": ON if enabled else OFF})
                try:
                    frames = self.encode([command] * len(self._valves), enabled, answered)
                except Exception as error:  # whatever the library raises, it would raise it in the run
                    raise check.refuse(self._alive, f"commands cannot be encoded ({error})", "signals for them") from None
                for message, (_, data), coded in zip((*self._valves, self._alive), frames, wanted, strict=True):
                    check.carries(message, data, coded)
                    if message is not self._alive:
                        check.valve(message, data, coded)
        for valve in self._valves:
            check.full_flow(valve, valve.get_signal_by_name("flow"), FULL)
        self.sent_count = 0

    def _clock(self) -> tuple[float, str]:
        status = self._status
        if (time := signal_of(status, TIME)) is not None:
            return values_of(time) * float(time.scale), "the machine's clock"
        count = signal_of(status, COUNTER)
        if (
            count is None
            or not status.cycle_time
            or (period := values_of(count) * status.cycle_time * 1e-3) < SHORTEST_PERIOD_S
        ):
            return math.inf, ""
        return period, f"the count of {status.name} and its cycle time of {status.cycle_time:g} ms (GenMsgCycleTime)"

    def seconds(self, status: ReceivedFrame) -> float | None:
        """The machine's time of a status [s]: its own, or the number of its cycles; None without both."""
        if TIME in status.values:
            return status.values[TIME]
        return status.values[COUNTER] * (self._status.cycle_time or 0) * 1e-3 if self.clock else None

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
        message = self._message(name, f"valves.{axis}", VALVE_SIGNALS)
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
        names, factors = self._sources[message.name], self._factors[message.name]
        return ReceivedFrame(message.name, {names[name]: _number(fields[name]) * factors[name] for name in names}, fresh, lost)

    def _count(self, message: Message, fields: Mapping[str, object]) -> tuple[bool, int]:
        if COUNTER not in fields:
            return True, 0
        count = int(_number(fields[COUNTER]))
        before, number = self._counted.get(message.name), values_of(message.get_signal_by_name(COUNTER))
        ahead = 1 if before is None else (count - before) % number
        if number >= WIDE and number - ahead <= OVERTAKEN:
            return False, -1
        self._counted[message.name] = count
        return ahead > 0, max(ahead - 1, 0)

    def implausible(self, frame: ReceivedFrame) -> str:
        """A text about the first value outside its range in the database; "" if there is none."""
        for signal, value in frame.values.items():
            source = self.settings.signals.get(signal)
            own = self._messages[frame.message].get_signal_by_name(source.partition(".")[2] if source else signal)
            low, high, raw = own.minimum, own.maximum, value / (factor_of(own) if source else 1.0)
            if (
                low is not None
                and high is not None
                and low < high
                and not low - _half_step(own) <= raw <= high + _half_step(own)
            ):
                return f"{frame.message}.{own.name} = {raw:g} is outside of [{low:g}, {high:g}]"
        return ""

    def encode(self, commands: Sequence[float], enabled: bool, answered: float | None = None) -> list[tuple[int, bytes]]:
        """Frames (29-bit identifier, data) of a set of commands in [-1, 1], the status of the runner last.

        Not enabled, or with a command that is not finite: no flow, blocked, and fail-safe bits for an error.

        Args:
            answered: the machine's time that this set answers [s]; None: not known.
        """
        enabled = enabled and _finite(commands)
        out = []
        for message, command in zip(self._valves, coded_commands(commands, enabled), strict=True):
            coded = self._coded(message, command, enabled, answered)
            # Not strict: the stamp for "not known" is above the signal's maximum.
            out.append((message.frame_id, bytes(message.encode(coded, scaling=False, padding=True, strict=False))))
        self.sent_count = (self.sent_count + 1) % values_of(self._alive.get_signal_by_name(COUNTER))
        coded = {COUNTER: self.sent_count, "enabled": ON if enabled else OFF}
        out.append((self._alive.frame_id, bytes(self._alive.encode(coded, scaling=False, padding=True))))
        return out

    def _coded(self, message: Message, command: float, enabled: bool, answered: float | None) -> dict[str, int]:
        """Raw values of a valve command."""
        state = BLOCKED if command == 0.0 else EXTEND if command > 0.0 else RETRACT
        safe = FAIL_SAFE_BLOCK if enabled else FAIL_SAFE_ERROR
        coded = dict(zip(VALVE_SIGNALS, (round(abs(command) * FULL), state, safe), strict=True))
        if self.stamps:
            coded[STAMP] = _stamp(message.get_signal_by_name(STAMP), answered)
        return coded


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
    return math.floor(seconds / float(signal.scale) + 1e-6) % min(unknown, values_of(signal))


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
