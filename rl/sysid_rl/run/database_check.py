"""Everything that the first frames of a run need of a CAN database, proven before the machine is opened.

A database passes if each message that the runner sends or reads can be encoded and decoded as the runner does it, with neutral
and extreme values; anything else is refused with the message and signal that is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from sysid.errors import InputError, SettingsError
from sysid.units import si_factor

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

#: Bytes of a frame.
LONGEST = 8
#: Shortest period of the machine's time, of stamps, and of counters by which a delay is measured [s].
SHORTEST_PERIOD_S = 1.0
_REMEDY = "Is it the database of this machine? Change it, or the recipe."
#: Units that need no unit library.
_PLAIN = ("", "m", "rad", "s")


def signal_of(message: Message, name: str) -> Signal | None:
    """The signal ``name``; None if there is none."""
    return next((signal for signal in message.signals if signal.name == name), None)


def values_of(signal: Signal) -> int:
    """Number of values of an unsigned integer signal; a maximum in the database excludes those above it."""
    number = 1 << signal.length
    if signal.maximum is None:
        return number
    return min(number, round((float(signal.maximum) - float(signal.offset)) / float(signal.scale)) + 1)


def factor_of(signal: Signal) -> float:
    """Factor from the unit of the database to SI; one without a known unit."""
    unit = (signal.unit or "").strip()
    if unit in _PLAIN:
        return 1.0
    try:
        return si_factor(unit)[0]
    except InputError:
        return 1.0


class DatabaseCheck:
    """Checks of one database; each raises :class:`sysid.errors.SettingsError`.

    Args:
        where: the recipe, for messages.
    """

    def __init__(self, where: str) -> None:
        self.where = where

    def refuse(self, message: Message, found: str, expected: str) -> SettingsError:
        """The error for ``message``."""
        return SettingsError(f"{self.where}: {message.name}", found, expected, _REMEDY)

    def layout(self, messages: Sequence[Message], every: Iterable[Message]) -> None:
        """One role a message, one message an identifier, plain frames of whole, separate signals."""
        from cantools.database.errors import Error

        known: dict[tuple[int, bool], list[str]] = {}
        for message in every:
            known.setdefault((message.frame_id, message.is_extended_frame), []).append(message.name)
        for k, message in enumerate(messages):
            if message in messages[:k]:
                raise self.refuse(message, "stands for two things", "one message for each valve, the status, and the runner")
            if len(twins := known[message.frame_id, message.is_extended_frame]) > 1:
                raise self.refuse(message, f"has the identifier of {', '.join(twins)}", "an identifier of its own")
            if message.is_multiplexed() or message.is_container:
                raise self.refuse(message, "is multiplexed", "the same signals in each frame")
            if not 1 <= message.length <= LONGEST:
                raise self.refuse(message, f"has {message.length} bytes", f"1 to {LONGEST} bytes")
            try:
                message.refresh(strict=True)
            except Error as error:
                raise self.refuse(message, f"{error}", "signals that fit into the message, side by side") from None

    def whole(self, message: Message, name: str) -> None:
        """``name``, if the message has it, is an unsigned integer without scale and offset."""
        signal = signal_of(message, name)
        if signal is None:
            return
        if signal.is_float or signal.is_signed or float(signal.scale) != 1.0 or float(signal.offset) != 0.0:
            kind = "a floating-point number" if signal.is_float else "signed" if signal.is_signed else "scaled"
            raise self.refuse(message, f"{name} is {kind}", "an unsigned integer with scale 1 and offset 0")

    def seconds(self, message: Message, name: str) -> None:
        """``name`` is an integer clock in seconds that begins anew after :data:`SHORTEST_PERIOD_S` or more."""
        signal = signal_of(message, name)
        assert signal is not None
        if (unit := (signal.unit or "").strip()) not in ("", "s"):
            raise self.refuse(message, f"the unit of {name} is {unit!r}", "s, with its scale")
        if signal.is_float or signal.is_signed or float(signal.scale) <= 0.0 or float(signal.offset) != 0.0:
            raise self.refuse(message, f"{name} is not an unsigned integer with a scale", "steps of a clock from zero on")
        self.period(message, name, values_of(signal) * float(signal.scale))

    def period(self, message: Message, name: str, seconds: float) -> None:
        """``name`` begins anew after ``seconds``: late enough to measure a delay."""
        if seconds < SHORTEST_PERIOD_S:
            raise self.refuse(message, f"{name} begins anew after {seconds:g} s", f"{SHORTEST_PERIOD_S:g} s or more")

    def sent(self, message: Message, names: Sequence[str], optional: Sequence[str] = ()) -> None:
        """The runner sends ``names`` of the message and nothing else, in an extended frame."""
        for signal in message.signals:
            if signal.name not in (*names, *optional):
                raise self.refuse(
                    message,
                    f"the runner has no value for {signal.name}",
                    f"{', '.join((*names, *optional))}; other bits are ones",
                )
        if not message.is_extended_frame:
            raise self.refuse(message, "has an identifier of 11 bits", "29 bits (J1939)")

    def decodes(self, message: Message) -> None:
        """Frames of zeros and of ones can be decoded, into numbers."""
        for byte in (b"\x00", b"\xff"):
            try:
                values = message.decode(byte * message.length, decode_choices=False)
                numbers = isinstance(values, Mapping) and all(isinstance(value, int | float) for value in values.values())
            except Exception as error:  # whatever the library raises, it would raise it in the run
                raise self.refuse(message, f"a frame cannot be decoded ({error})", "a message that can be decoded") from None
            if not numbers:
                raise self.refuse(message, "has values that are no numbers", "numbers")

    def carries(self, message: Message, data: bytes, coded: Mapping[str, int]) -> None:
        """``data`` has the raw values ``coded``."""
        values = message.decode(data, decode_choices=False, scaling=False)
        assert isinstance(values, dict)
        for name, value in coded.items():
            if values[name] != value:
                raise self.refuse(message, f"{name} {value} is sent as {values[name]}", "enough bits")

    def valve(self, message: Message, data: bytes, coded: Mapping[str, int]) -> None:
        """``data`` is a valve command of ISO 11783-7: flow in byte 1, state and fail-safe bits in byte 3, ones between
        them."""
        wanted = bytes([coded["flow"], 0xFF, coded["fail_safe"] << 6 | 0x30 | coded["state"]])
        if data[:3] != wanted:
            found = f"flow, state and fail_safe are sent as {data[:3].hex(' ').upper()}"
            raise self.refuse(message, found, f"{wanted.hex(' ').upper()} (ISO 11783-7)")

    def full_flow(self, message: Message, flow: Signal, steps: int) -> None:
        """``steps`` of ``flow`` are 100 %."""
        full, unit = steps * float(flow.scale) + float(flow.offset), (flow.unit or "").strip()
        if flow.is_signed or flow.is_float or not any(math.isclose(full, value, rel_tol=1e-6) for value in (1.0, 100.0)):
            raise self.refuse(message, f"flow {steps} is {full:g} {unit}".rstrip(), "100 %, in steps of 0.4 % (ISO 11783-7)")
