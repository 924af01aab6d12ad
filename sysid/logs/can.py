"""CAN logs decoded with a database: every message is a stream, every signal a column, stamped when the frame was logged.

Without a database every identifier (``0x1A7``, ``0x18FF1027x`` with 29 bits) is a stream of its bytes, ``data[0]`` and so on.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sysid.errors import InputError
from sysid.logs.can_frames import Address, FrameLog, Frames, read_frames
from sysid.logs.can_signals import decode, load_database
from sysid.logs.reader import ReadOptions
from sysid.logs.stream import Stream

if TYPE_CHECKING:
    from cantools.database.can import Database, Message

#: J1939: priority and sender are no part of the parameter group number; below this PDU format neither is the receiver.
_J1939_BROADCAST = 240
#: Identifiers that a message lists.
_LISTED = 5


@dataclass(frozen=True)
class CanReader:
    """Vector BLF and ASC, PEAK traces; candump files where the recipe names the reader (``reader = "can"``)."""

    name: str = "can"
    suffixes: tuple[str, ...] = (".blf", ".asc", ".trc")
    clocks: tuple[str, ...] = ("log",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        return frame_streams(path, read_frames(path, options.budget_of(path, "a CAN log")), options)


def frame_streams(path: Path, log: FrameLog, options: ReadOptions) -> tuple[Stream, ...]:
    """The streams of the frames in ``log``, decoded with the database that the options name.

    Raises:
        InputError: no data frames, none that the database knows, a database that cannot be read, a message that is not there.
    """
    losses = [*log.losses]
    others = [f"{n} {kind} frame{'s' if n > 1 else ''}" for n, kind in ((log.errors, "error"), (log.remotes, "remote")) if n]
    if not log.frames:
        found = f"nothing but {' and '.join(others)}" if others else "no frames"
        raise InputError(path, found, "at least one data frame", "Record the log again.")
    if others:
        losses.append(f"{path.name}: {' and '.join(others)} without data left out")
    if options.dbc is None:
        named = {address: _identifier(address) for address in log.frames}
        streams = _select(path, _unique(named), options)
        return tuple(_raw_stream(name, path, log.frames[address], losses) for address, name in streams.items())
    database = load_database(options.dbc)
    messages = {address: message for address in log.frames if (message := _message(address, database)) is not None}
    unknown = {address: len(frames.stamps) for address, frames in log.frames.items() if address not in messages}
    if unknown:
        losses.append(_unknown(path, unknown, options.dbc))
    if not messages:
        expected = "identifiers of the log: " + _some([_identifier(address) for address in log.frames])
        raise InputError(options.dbc, f"describes no frame of {path.name}", expected, "Choose the database of this bus.")
    streams = _select(path, _unique({address: message.name for address, message in messages.items()}), options)
    return tuple(
        _decoded_stream(name, path, address, messages[address], log.frames[address], losses)
        for address, name in streams.items()
    )


def _decoded_stream(name: str, path: Path, address: Address, message: Message, frames: Frames, losses: Sequence[str]) -> Stream:
    columns = decode(message, frames)
    short = int(np.count_nonzero(frames.lengths < message.length))
    own = [f"{path.name}: {name}: {short} frames are shorter than {message.length} bytes"] if short else []
    units = {signal.name: signal.unit for signal in message.signals if signal.unit}
    return Stream(name, path, {"log": frames.stamps}, columns, units, (*losses, *own), kind=f"CAN {_identifier(address)}")


def _raw_stream(name: str, path: Path, frames: Frames, losses: Sequence[str]) -> Stream:
    columns = {
        f"data[{i}]": np.where(frames.lengths > i, frames.data[:, i].astype(np.float64), np.nan)
        for i in range(frames.data.shape[1])
    }
    return Stream(name, path, {"log": frames.stamps}, columns, {}, tuple(losses), kind="CAN")


def _message(address: Address, database: Database) -> Message | None:
    """The message of an identifier; of a J1939 message with any sender and priority."""
    _, identifier, extended = address
    for message in database.messages:
        if message.frame_id == identifier and message.is_extended_frame == extended:
            return message
    if extended:
        for message in database.messages:
            if message.protocol == "j1939" and message.is_extended_frame and _group(message.frame_id) == _group(identifier):
                return message
    return None


def _group(identifier: int) -> int:
    """Parameter group number of a 29-bit identifier (SAE J1939-21)."""
    number = identifier >> 8 & 0x3FFFF
    return number if number >> 8 & 0xFF >= _J1939_BROADCAST else number & 0x3FF00


def _identifier(address: Address) -> str:
    _, identifier, extended = address
    return f"0x{identifier:X}x" if extended else f"0x{identifier:X}"


def _unique(named: Mapping[Address, str]) -> dict[Address, str]:
    """Stream names: the message's; with its identifier and bus where several send the same."""
    names = {}
    for address, name in named.items():
        same = [other for other in named if named[other] == name]
        identifier = f"@{_identifier(address)}" if len({other[1:] for other in same}) > 1 else ""
        bus = f"@bus{address[0]}" if len({other[0] for other in same}) > 1 else ""
        names[address] = name + identifier + bus
    return names


def _select(path: Path, names: Mapping[Address, str], options: ReadOptions) -> dict[Address, str]:
    options.check_streams(path, names.values(), "message", "Correct `topic` in the recipe.")
    return {address: name for address, name in names.items() if options.wants(name)}


def _unknown(path: Path, unknown: Mapping[Address, int], dbc: Path) -> str:
    listed = [f"{_identifier(address)} ({count})" for address, count in sorted(unknown.items(), key=lambda item: -item[1])]
    frames = sum(unknown.values())
    return f"{path.name}: {frames} frames of {len(unknown)} identifiers that {dbc.name} does not have: {_some(listed)}"


def _some(texts: Iterable[str]) -> str:
    listed = list(texts)
    more = f" and {len(listed) - _LISTED} more" if len(listed) > _LISTED else ""
    return ", ".join(listed[:_LISTED]) + more
