"""CAN logs decoded with a database: every message is a stream, every signal a column, stamped when the frame was logged.

The signals that a multiplexer selects are a stream of their own for each selection, ``MODES[mode=1]``, with the stamps of the
frames that contain them.

Without a database every identifier (``0x1A7``, ``0x18FF1027x`` with 29 bits) is a stream of its bytes, ``data[0]`` and so on.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sysid.errors import InputError
from sysid.logs.can_frames import Address, FrameLog, Frames, read_frames
from sysid.logs.can_signals import decode, is_j1939, load_database, measured, selected, switch_of
from sysid.logs.reader import LogReader, ReadOptions, Stream

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal

#: J1939: priority and sender are no part of the parameter group number; below this PDU format neither is the receiver.
_J1939_BROADCAST = 240
#: Identifiers that a message lists.
_LISTED = 5


class CanReader(LogReader):
    """Vector BLF and ASC, PEAK traces; candump files where the recipe names the reader (``reader = "can"``)."""

    name = "can"
    suffixes = (".blf", ".asc", ".trc")
    clocks = ("log",)

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
        by_address = _unique(named)
        options.check_streams(path, by_address.values(), "message", "Correct `topic` in the recipe.")
        return tuple(
            _raw_stream(name, path, log.frames[address], losses) for address, name in by_address.items() if options.wants(name)
        )
    database = load_database(options.dbc)
    messages = {address: message for address in log.frames if (message := _message(address, database)) is not None}
    unknown = {address: len(frames.stamps) for address, frames in log.frames.items() if address not in messages}
    if unknown:
        losses.append(_unknown(path, unknown, options.dbc))
    if not messages:
        expected = "identifiers of the log: " + _some([_identifier(address) for address in log.frames])
        raise InputError(options.dbc, f"describes no frame of {path.name}", expected, "Choose the database of this bus.")
    names = _unique({address: message.name for address, message in messages.items()})
    parts = {address: _selections(messages[address]) for address in names}
    every = [names[address] + selection for address, selections in parts.items() for selection in selections]
    options.check_streams(path, every, "message", "Correct `topic` in the recipe.")
    for address, selections in parts.items():
        _check_fields(path, names[address], selections, options)
    streams: list[Stream] = []
    for address, name in names.items():
        wanted = {name + selection: signals for selection, signals in parts[address].items() if options.wants(name + selection)}
        if wanted:
            message, frames = messages[address], log.frames[address]
            kind = f"CAN {_identifier(address)}"
            streams += _decoded_streams(
                path, wanted, message, is_j1939(message, database), frames, tuple(losses), kind, options
            )
    if not streams:
        found = f"no frame selects {' or '.join(sorted(options.streams or every))}"
        raise InputError(path, found, "frames with these signals", "Leave these signals out of the recipe.")
    return tuple(streams)


def _selections(message: Message) -> dict[str, list[str]]:
    """Selection → its signals: ``""`` those in every frame, ``[mode=1]`` those that a multiplexer selects.

    Each selection is a stream, because its signals are sent at other times than those of the others.
    """
    found: dict[str, list[str]] = {"": []}
    for signal in message.signals:
        found.setdefault(_selection(signal, message), []).append(signal.name)
    return found


def _check_fields(path: Path, name: str, selections: Mapping[str, Sequence[str]], options: ReadOptions) -> None:
    """Raise where a recipe names a selected signal in the stream of its message instead of that of its selection."""
    for selection, signals in selections.items():
        misplaced = set(signals) & {field for field in (options.fields or {}).get(name, ()) if selection}
        if misplaced:
            found = f"{sorted(misplaced)[0]!r} is not in every frame of {name!r}: a multiplexer selects it"
            topic = f"{name}{selection}"
            raise InputError(
                path, found, f"the stream of its selection, {topic!r}", f'Write `topic = "{topic}"` in the recipe.'
            )


def _selection(signal: Signal, message: Message) -> str:
    switch = switch_of(signal, message)
    if switch is None:
        return ""
    return f"{_selection(switch, message)}[{switch.name}={_ranges(signal.multiplexer_ids or ())}]"


def _ranges(numbers: Iterable[int]) -> str:
    """``1-3,7`` of 1, 2, 3 and 7."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return ",".join(str(first) if first == last else f"{first}-{last}" for first, last in runs)


def _decoded_streams(
    path: Path,
    wanted: Mapping[str, Sequence[str]],
    message: Message,
    j1939: bool,
    frames: Frames,
    losses: tuple[str, ...],
    kind: str,
    options: ReadOptions,
) -> Iterator[Stream]:
    """A stream for each of the ``wanted`` selections (name → signals) that occurs in ``frames``."""
    columns, said = measured(message, j1939, frames, decode(message, frames))
    short = int(np.count_nonzero(frames.lengths < message.length))
    units = {signal.name: signal.unit for signal in message.signals if signal.unit}
    for name, signals in wanted.items():
        rows = selected(message.get_signal_by_name(signals[0]), message, frames) if signals else frames.lengths >= 0
        if not rows.any():
            continue
        own = [f"{path.name}: {name}: {short} frames are shorter than {message.length} bytes"] if short else []
        fields = options.fields.get(name, frozenset()) if options.fields is not None else frozenset(signals)
        own += [f"{path.name}: {name}: {key}: {text}" for key in signals if key in fields for text in said.get(key, ())]
        yield Stream(
            name,
            path,
            {"log": frames.stamps[rows]},
            {key: columns[key][rows] for key in signals},
            {key: units[key] for key in signals if key in units},
            (*losses, *own),
            kind=kind,
        )


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
            if is_j1939(message, database) and _group(message.frame_id) == _group(identifier):
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


def _unknown(path: Path, unknown: Mapping[Address, int], dbc: Path) -> str:
    listed = [f"{_identifier(address)} ({count})" for address, count in sorted(unknown.items(), key=lambda item: -item[1])]
    frames = sum(unknown.values())
    return f"{path.name}: {frames} frames of {len(unknown)} identifiers that {dbc.name} does not have: {_some(listed)}"


def _some(texts: Iterable[str]) -> str:
    listed = list(texts)
    more = f" and {len(listed) - _LISTED} more" if len(listed) > _LISTED else ""
    return ", ".join(listed[:_LISTED]) + more
