"""The simulated test bench's end of a CAN bus: its database, and frames as an slcan adapter carries them.

Source of the lines: Lawicel, CANUSB manual, "ASCII commands".
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from simulated_bench.recipe import AXES
from sysid.errors import InputError

if TYPE_CHECKING:
    from cantools.database.can import Message

#: Signals of the machine in the messages of the database.
SENT = {
    "DRAW_WIRES": {"boom": "boom.cylinder", "stick": "stick.cylinder", "telescope": "telescope.joint"},
    "SLEW_SENSOR": {"slew": "slew.joint"},
}
#: Those that are on the bus while the machine is being commissioned.
SURVEY = {
    "INCLINOMETERS": {"boom": "boom.joint", "stick": "stick.joint"},
    "TIP_TRACKER": {"x": "ee.x", "y": "ee.y", "z": "ee.z"},
}
VALVES = tuple(f"AUX_VALVE_{k}_COMMAND" for k in range(len(AXES)))
#: Words of ISO 11783-7.
EXTEND, RETRACT, BLOCKED, FAIL_SAFE_ERROR = 1, 2, 0, 2
ON = 1


@dataclass(frozen=True)
class CanFrame:
    """One CAN frame."""

    identifier: int
    extended: bool
    data: bytes

    def line(self) -> bytes:
        """As a line of an slcan adapter."""
        head = f"T{self.identifier:08X}" if self.extended else f"t{self.identifier:03X}"
        return f"{head}{len(self.data)}{self.data.hex().upper()}\r".encode()


def parse_line(line: bytes) -> CanFrame | None:
    """The data frame of a line without its end; None for anything else, damaged frames included."""
    digits = {b"T": 8, b"t": 3}.get(line[:1])
    if digits is None or len(line) < 2 + digits:
        return None
    try:
        identifier, length = int(line[1 : 1 + digits], 16), int(line[1 + digits : 2 + digits])
        data = bytes.fromhex(line[2 + digits : 2 + digits + 2 * length].decode("ascii"))
    except ValueError:
        return None
    return CanFrame(identifier, digits == 8, data) if len(data) == length <= 8 else None


class LiveBus:
    """Encodes messages of the machine and decodes commands, by the database of its bus."""

    def __init__(self, path: Path, survey: bool) -> None:
        from cantools.database.can import Database
        from cantools.database.errors import Error

        database = Database()
        try:
            database.add_dbc_string(path.read_text("cp1252"))
            self._sent = {**SENT, **(SURVEY if survey else {})}
            self._messages: dict[str, Message] = {
                name: database.get_message_by_name(name) for name in ("MACHINE_STATUS", *self._sent)
            }
            self._valves = {database.get_message_by_name(name).frame_id: k for k, name in enumerate(VALVES)}
            self._described: dict[int, Message] = {
                database.get_message_by_name(name).frame_id: database.get_message_by_name(name)
                for name in (*VALVES, "RUNNER_STATUS")
            }
        except (OSError, KeyError, UnicodeDecodeError, Error) as error:
            raise InputError(path, f"{error}", "the CAN database of the machine (DBC)") from error
        self._names = {message.frame_id: name for name, message in self._messages.items()}
        self._counters = dict.fromkeys(self._messages, 0)
        time = next((signal for signal in self._messages["MACHINE_STATUS"].signals if signal.name == "time"), None)
        #: After which the machine's clock begins anew on the bus [s].
        self.clock_period = math.inf if time is None else (1 << time.length) * float(time.scale)

    def frames(self, readings: dict[str, float], cycle: int, status: dict[str, float]) -> list[CanFrame]:
        """Frames that the machine sends in a cycle, its status first."""
        out = [self._encode("MACHINE_STATUS", status)]
        for name, signals in self._sent.items():
            every = max((self._messages[name].cycle_time or 10) // 10, 1)
            if cycle % every == 0:
                out.append(self._encode(name, {signal: readings[source] for signal, source in signals.items()}))
        return out

    def _encode(self, name: str, values: dict[str, float]) -> CanFrame:
        message = self._messages[name]
        width = message.get_signal_by_name("counter").length
        self._counters[name] = (self._counters[name] + 1) % (1 << width)
        coded = {}
        for signal in message.signals:
            if signal.name in values:
                # A converter saturates at the ends of its range.
                bits = signal.length - (1 if signal.is_signed else 0)
                low = -(1 << bits) if signal.is_signed else 0
                raw = round((values[signal.name] - float(signal.offset)) / float(signal.scale))
                coded[signal.name] = min(max(raw, low), (1 << bits) - 1)
        coded["counter"] = self._counters[name]
        return CanFrame(
            message.frame_id, message.is_extended_frame, bytes(message.encode(coded, scaling=False, padding=True, strict=False))
        )

    def age(self, frame: CanFrame, seconds: float) -> float:
        """Age of the stamp of a valve command at ``seconds`` of the machine's clock [s]; negative for a stamp in the future.

        Zero where commands have no stamp in the database, infinite where the stamp is not available.
        """
        message = self._described[frame.identifier]
        stamp = next((signal for signal in message.signals if signal.name == "stamp"), None)
        if stamp is None:
            return 0.0
        raw, scale = _raw(message, frame)["stamp"], float(stamp.scale)
        turn = round(float(stamp.maximum or 0.0) / scale) + 1
        if raw >= turn:
            return math.inf
        age = (seconds / scale - raw) % turn
        return (age - turn if age > 0.5 * turn else age) * scale

    def valve(self, frame: CanFrame) -> tuple[int, float, bool] | None:
        """Axis, command in [-1, 1], and validity of a valve command; None for other frames."""
        axis = self._valves.get(frame.identifier)
        message = self._described.get(frame.identifier)
        if axis is None or message is None or not frame.extended or len(frame.data) != message.length:
            return None
        values = _raw(message, frame)
        flow, state = values["flow"], values["state"]
        # Flows above 250 are the standard's error and not-available indicators; states above 2 are not supported.
        fit = values["fail_safe"] != FAIL_SAFE_ERROR and flow <= 250 and state in (BLOCKED, EXTEND, RETRACT)
        sign = {EXTEND: 1.0, RETRACT: -1.0}.get(state, 0.0)
        return axis, sign * min(flow, 250) / 250.0, fit

    def status(self, frame: CanFrame) -> tuple[int, bool] | None:
        """Alive counter of the sender of commands, and whether it is enabled; None for other frames."""
        message = self._described.get(frame.identifier)
        if message is None or frame.identifier in self._valves or len(frame.data) != message.length:
            return None
        values = _raw(message, frame)
        return values["counter"], values["enabled"] == ON

    def identifier(self, name: str) -> int:
        """Identifier of a message that the machine sends.

        Raises:
            KeyError: there is no message of that name.
        """
        return self._messages[name].frame_id

    def name(self, frame: CanFrame) -> str:
        """Message of a frame that the machine sends."""
        return self._names[frame.identifier]


def _raw(message: Message, frame: CanFrame) -> dict[str, int]:
    values = message.decode(frame.data, decode_choices=False, scaling=False)
    assert isinstance(values, dict)
    return {name: int(value) for name, value in values.items() if isinstance(value, int)}
