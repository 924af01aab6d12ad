"""ASAM MDF 4 (``.mf4``): every channel group is a stream of its numeric channels; logged CAN frames are decoded like a CAN log.

The library that reads the format is an extra (``mf4``), because nothing else needs its compiled packages. Before it reads a
file, the blocks are checked: chains end, and packed data are no decompression bomb. The header links to chains of data groups,
file histories, hierarchies, attachments and events; a data group to its channel groups and its data, a channel group to its
channels, a channel to its components and its own data. No block belongs to two chains. Data are one block, or lists of blocks;
a packed one (``DZ``) states its unpacked size.

Source: ASAM MDF 4.1 programmers' guide, "Block structure".
"""

from __future__ import annotations

import struct
import traceback
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError
from sysid.extras import install_remedy
from sysid.logs.can import frame_streams
from sysid.logs.can_frames import Address, FrameLog, Frames
from sysid.logs.limits import Budget
from sysid.logs.reader import LogReader, ReadOptions, Stream
from sysid.logs.table import to_ns
from sysid.names import listed

#: Positions of the header's links to the chains: data groups, histories, hierarchies, attachments, events.
_CHAINS = {88: "DG", 96: "FH", 104: "CH", 112: "AT", 120: "EV"}
#: Id, length and number of links (24 bytes) are followed by the links to the next block of the kind and to the first child.
_COUNT, _NEXT, _BELOW = 16, 24, 32
_CHILD = {"DG": "CG", "CG": "CN", "CN": "CN", "CH": "CH"}
#: Position of the link of a data group and of a channel to their data.
_DATA = {"DG": 40, "CN": 64}
#: Of a packed block: original kind, method, parameter, size unpacked and packed.
_PACKED = struct.Struct("<2sBxLQQ")
_PIECE = 2**20


def check_blocks(path: Path, budget: Budget) -> None:
    """Raise where a chain of blocks has no end, or a packed block is larger than stated or allowed.

    Raises:
        InputError: the file is damaged, or malicious.
    """
    with path.open("rb") as file:
        packed = unpacked = 0
        for at in _blocks(path, file):
            if _read(file, at, 4) == b"##DZ":
                sizes = _packed_block(path, file, at, budget)
                packed, unpacked = packed + sizes[0], unpacked + sizes[1]
                budget.check_unpacked(path, unpacked)
        reason = budget.too_large(packed, unpacked, at_once=False)
        if reason:
            raise InputError(path, f"packed data: {reason}", "a log", "The file is damaged or malicious.")


def _blocks(path: Path, file: BinaryIO) -> Iterator[int]:
    """Positions of all blocks of data."""
    waiting = [(kind, _link(file, at)) for at, kind in _CHAINS.items()]
    seen: set[tuple[str, int]] = set()
    while waiting:
        kind, at = waiting.pop()
        if not at:
            continue
        if (kind, at) in seen:
            raise InputError(path, f"two links to the block at byte {at}", "chains of blocks that end", "The file is damaged.")
        seen.add((kind, at))
        waiting.append((kind, _link(file, at + _NEXT)))
        if kind == "DL":
            for number in range(1, int.from_bytes(_read(file, at + _COUNT, 4), "little")):
                block = _link(file, at + _NEXT + 8 * number)
                if not block:
                    break
                yield block
        if kind in _CHILD and not (kind in ("CN", "CH") and _read(file, _link(file, at + _BELOW), 4) != f"##{kind}".encode()):
            waiting.append((_CHILD[kind], _link(file, at + _BELOW)))
        if kind in _DATA:
            data = _link(file, at + _DATA[kind])
            data = _link(file, data + _NEXT) if data and _read(file, data, 4) == b"##HL" else data
            if data and _read(file, data, 4) == b"##DL":
                waiting.append(("DL", data))
            elif data:
                yield data


def _packed_block(path: Path, file: BinaryIO, at: int, budget: Budget) -> tuple[int, int]:
    """Packed and unpacked size of a packed block [bytes]."""
    head = _read(file, at + _NEXT, _PACKED.size)
    if len(head) < _PACKED.size:
        return 0, 0
    _, _, _, stated, size = _PACKED.unpack(head)
    reason = budget.too_large(size, stated)
    unpacker, left, total = zlib.decompressobj(), min(size, path.stat().st_size), 0
    while not reason and left > 0 and (piece := file.read(min(left, _PIECE))):
        left -= len(piece)
        while piece and not reason:
            try:
                total += len(unpacker.decompress(piece, _PIECE))
            except zlib.error:
                return size, total  # reported when the samples are read
            piece = unpacker.unconsumed_tail
            reason = f"more than the {stated} bytes that it states" if total > stated else ""
    if reason:
        raise InputError(path, f"a packed block at byte {at}: {reason}", "a log", "The file is damaged or malicious.")
    return size, total


def _read(file: BinaryIO, at: int, size: int) -> bytes:
    file.seek(at)
    return file.read(size)


def _link(file: BinaryIO, at: int) -> int:
    """Target of the link at this position; 0 where it is outside the file."""
    cell = _read(file, at, 8)
    target: int = struct.unpack("<Q", cell)[0] if len(cell) == 8 else 0
    return target if target < file.seek(0, 2) else 0


#: Channel of a group in which a bus was logged.
_BUS = "CAN_DataFrame"
#: What a master channel synchronises by (its synchronisation type); only time is a clock.
_TIME = 1
_SYNC = {0: "nothing", _TIME: "time", 2: "an angle", 3: "a distance", 4: "an index"}
#: Groups and channels in a sentence; the others are counted.
MOST = 5


class Mf4Reader(LogReader):
    """Stamps are the time of the group's master channel, from the start of the measurement as the file states it."""

    name = "mf4"
    suffixes = (".mf4",)
    clocks = ("log",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        budget = options.budget_of(path, "an MDF 4 file", None)
        with path.open("rb") as file:
            head = file.read(8)
            if head not in (b"MDF     ", b"UnFinMF "):
                raise InputError(path, f"starts with {head!r}", "'MDF     ' as in an MDF file")
            file.seek(0)
            check_blocks(path, budget)
            mdf = _open(path, file)
            try:
                return _streams(path, mdf, options, budget)
            except InputError:
                raise
            except Exception as error:  # as when it is opened
                raise _unreadable(path, error) from None
            finally:
                mdf.close()


def _open(path: Path, file: Any) -> Any:
    try:
        from asammdf import MDF
    except ImportError:
        raise InputError(
            path, "asammdf is not installed", "the extra that reads MDF files", install_remedy("asammdf")
        ) from None
    try:
        return MDF(file)
    except Exception as error:  # the library raises many unrelated types on a damaged file
        _abandon(error)
        raise _unreadable(path, error) from None


def _abandon(error: Exception) -> None:
    """Close the library's partly built object, which otherwise raises once more when it is garbage-collected."""
    for frame, _ in traceback.walk_tb(error.__traceback__):
        half_built: Any = frame.f_locals.get("self")
        if type(half_built).__name__ == "MDF4":
            half_built._tempfile.close()
            half_built._closed = True


def _unreadable(path: Path, error: Exception) -> InputError:
    return InputError(path, f"not readable as MDF 4 ({type(error).__name__}: {error})", "an MDF 4 file")


def _streams(path: Path, mdf: Any, options: ReadOptions, budget: Budget) -> tuple[Stream, ...]:
    start_ns = int(mdf.header.abs_time)
    budget.check_topics(path, len(mdf.groups), "channel groups")
    names: dict[str, int] = {}
    buses: list[int] = []
    for index, group in enumerate(mdf.groups):
        if not group.channel_group.cycles_nr:
            continue
        if any(channel.name == _BUS for channel in group.channels):
            buses.append(index)
            continue
        title = group.channel_group.acq_name or f"group {index}"
        names[f"{title} {index}" if title in names else title] = index
    if options.dbc is not None and not buses:
        remedy = "Leave `dbc` out: the channels have names."
        raise InputError(path, "no logged CAN frames", f"frames that {options.dbc.name} describes", remedy)
    if not names and not buses:
        raise InputError(path, "no channel group with samples", "at least one", "Record the measurement again.")
    if buses and (options.dbc is not None or not names):
        others = f"{path.name}: channel groups beside the CAN frames left out: {listed(list(names), MOST)}"
        return _with_losses(frame_streams(path, _frames(path, mdf, buses, start_ns), options), (others,) if names else ())
    options.check_streams(path, names, "channel group", "Correct `topic` in the recipe.")
    chosen = {name: index for name, index in names.items() if options.wants(name)}
    cells = sum(int(mdf.groups[i].channel_group.cycles_nr) * len(mdf.groups[i].channels) for i in chosen.values())
    budget.check_numbers(path, cells)
    streams, left_out = [], []
    for name, index in chosen.items():
        found = _group_stream(path, mdf, name, index, start_ns)
        if isinstance(found, Stream):
            streams.append(found)
        else:
            left_out.append(f"{name}: {found}")
    if not streams or (left_out and options.streams is not None):
        remedy = "Record it with a time channel and numbers, or leave this group out of the recipe."
        raise InputError(path, listed(left_out, MOST), "a channel group of numbers over time", remedy)
    if buses:
        left_out.append(f"logged CAN frames of {len(buses)} groups, which need `dbc`")
    return _with_losses(streams, tuple(f"{path.name}: {text}: left out" for text in left_out))


def _with_losses(streams: Iterable[Stream], losses: tuple[str, ...]) -> tuple[Stream, ...]:
    return tuple(replace(stream, losses=(*stream.losses, *losses)) for stream in streams)


def _group_stream(path: Path, mdf: Any, name: str, index: int, start_ns: int) -> Stream | str:
    """The numeric channels of one group, or why there are none."""
    group = mdf.groups[index]
    master = mdf.masters_db.get(index)
    if master is None:
        return "no master channel, so that its samples have no time"
    channel = group.channels[master]
    if channel.sync_type != _TIME:
        return f"its master channel {channel.name!r} is {_SYNC.get(channel.sync_type, 'of unknown kind')}, not time"
    _check_record(f"{path}: {name}", mdf, group)
    columns: dict[str, npt.NDArray[np.float64]] = {}
    units: dict[str, str] = {}
    left_out, invalid = [], []
    seconds: npt.NDArray[np.float64] | None = None
    for place, channel in enumerate(group.channels):
        if place == master:
            continue
        try:
            values, times, unit, marked = _samples(mdf, index, place)
        except Exception as error:
            left_out.append(f"{channel.name} ({type(error).__name__})")
            continue
        if seconds is None:
            seconds = times
        if values is None or len(values) != len(seconds):
            left_out.append(channel.name)
            continue
        label = f"{channel.name}#{place}" if channel.name in columns else channel.name
        columns[label] = values
        if marked:
            invalid.append(f"{label} {marked}")
        if unit:
            units[label] = unit
    if seconds is None or not len(seconds) or not columns:
        return f"no numbers in {listed(left_out, MOST)}" if left_out else "no channel beside its time"
    losses = [f"{path.name}: {name}: no numbers in {listed(left_out, MOST)}"] if left_out else []
    if invalid:
        losses.append(f"{path.name}: {name}: samples that the file marks as invalid are missing: {listed(invalid, MOST)}")
    stamps = to_ns(seconds, 1.0, f"{path}: {name}") + start_ns
    return Stream(name, path, {"log": stamps}, columns, units, tuple(losses))


def _check_record(where: str, mdf: Any, group: Any) -> None:
    """Raise where a channel lies outside of its record, because the library reads it without a check."""
    size = int(group.channel_group.samples_byte_nr) + int(group.channel_group.invalidation_bytes_nr)
    for channel, entry in zip(group.channels, mdf._mdf._prepare_record(group), strict=False):
        if entry is not None and not 0 <= entry[2] <= entry[2] + entry[1] <= size:
            found = f"channel {channel.name!r} in bytes {entry[2]} to {entry[2] + entry[1]}"
            raise InputError(where, found, f"a place in a record of {size} bytes", "The file is damaged.")


def _samples(mdf: Any, group: int, index: int) -> tuple[npt.NDArray[np.float64] | None, npt.NDArray[np.float64], str, int]:
    """Values in the stated unit (raw ones of texts), NaN where they are marked invalid; times, unit, number of marks."""
    signal: Any = mdf.get(group=group, index=index, ignore_invalidation_bits=True)
    if signal.samples.dtype.kind not in "fiub":
        signal = mdf.get(group=group, index=index, raw=True, ignore_invalidation_bits=True)
    times = np.asarray(signal.timestamps, dtype=np.float64)
    if signal.samples.dtype.kind not in "fiub" or signal.samples.ndim != 1:
        return None, times, "", 0
    with np.errstate(invalid="ignore"):  # a signalling NaN
        values = signal.samples.astype(np.float64)
    marked = np.zeros(len(values), dtype=bool)
    if signal.invalidation_bits is not None:
        marked = np.asarray(signal.invalidation_bits, dtype=bool)
        values[marked] = np.nan
    return values, times, str(signal.unit or ""), int(np.count_nonzero(marked))


def _frames(path: Path, mdf: Any, buses: list[int], start_ns: int) -> FrameLog:
    """The logged data frames of all buses, grouped by bus and identifier."""
    parts: dict[Address, list[Frames]] = {}
    for index in buses:
        _check_record(f"{path}: group {index}", mdf, mdf.groups[index])
        logged: Any = mdf.get(_BUS, group=index, raw=False)
        table = logged.samples
        stamps = to_ns(np.asarray(logged.timestamps, np.float64), 1.0, f"{path}: group {index}") + start_ns
        fields = table.dtype.names or ()

        def part(name: str, table: Any = table, fields: Any = fields) -> npt.NDArray[Any]:
            return np.asarray(table[f"{_BUS}.{name}"] if f"{_BUS}.{name}" in fields else np.zeros(len(table), np.int64))

        identifiers = part("ID").astype(np.int64) & 0x1FFFFFFF
        extended = (part("IDE").astype(np.int64) != 0) | (identifiers > 0x7FF)
        busses, lengths, data = part("BusChannel").astype(np.int64), part("DataLength").astype(np.int64), part("DataBytes")
        keys = np.column_stack([busses, identifiers, extended])
        for key in np.unique(keys, axis=0):
            own = (keys == key).all(axis=1)
            width = int(lengths[own].max(initial=0))
            address = (str(key[0]), int(key[1]), bool(key[2]))
            parts.setdefault(address, []).append(Frames(stamps[own], data[own][:, :width].astype(np.uint8), lengths[own]))
    return FrameLog({address: _joined(pieces) for address, pieces in parts.items()})


def _joined(pieces: list[Frames]) -> Frames:
    width = max(piece.data.shape[1] for piece in pieces)
    data = np.vstack([np.pad(piece.data, ((0, 0), (0, width - piece.data.shape[1]))) for piece in pieces])
    stamps = np.concatenate([piece.stamps for piece in pieces])
    order = np.argsort(stamps, kind="stable")
    return Frames(stamps[order], data[order], np.concatenate([piece.lengths for piece in pieces])[order])
