"""DataFlash logs of ArduPilot (``.bin``): every message type is a stream (``ATT``), or each of its instances (``IMU[1]``).

The library that indexes the file and knows its formats, units and multipliers is an extra (``ardupilot``); NumPy takes the
numbers of all messages of a type at once. Parameters, texts and descriptions of formats are left out.
Source: ArduPilot documentation, "Logging: message structure"; ``AP_Logger/LogStructure.h``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError
from sysid.extras import install_remedy
from sysid.logs.limits import Budget
from sysid.logs.reader import LogReader, ReadOptions, Stream
from sysid.logs.ulog import LARGEST_NS, MOST, silent
from sysid.names import listed
from sysid.units import si_factor

#: Of every message; the third byte is its type, that of a format ``FMT``.
_HEAD = b"\xa3\x95"
MAGIC = _HEAD + b"\x80"
_WHAT = "a DataFlash log of ArduPilot"
#: Columns of the time → nanoseconds.
_TIMES = {"TimeUS": 1000, "TimeMS": 1_000_000}
#: Messages that describe others or hold settings and texts.
_NO_STREAMS = ("FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG", "FILE")
#: Units of the log that have another name elsewhere.
_UNITS = {"degheading": "deg", "deglatitude": "deg", "deglongitude": "deg", "UNKNOWN": "", "instance": ""}


class ArduPilotReader(LogReader):
    """``boot`` stamps: the ``TimeUS`` (``TimeMS`` in old logs) of each message, since the autopilot booted."""

    name = "ardupilot"
    suffixes = (".bin",)
    clocks = ("boot",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        budget = options.budget_of(path, _WHAT)
        with path.open("rb") as file:
            head = file.read(3)
        if head != MAGIC:
            found = f"starts with {head.hex() or 'nothing'}"
            raise InputError(path, found, f"{MAGIC.hex()} as in a DataFlash log", "Is it another kind of .bin file?")
        log = _indexed(path)
        try:
            types, losses = _types(path, log)
        finally:
            log.close()
        return _streams(path, types, losses, options, budget)


def _indexed(path: Path) -> Any:
    """The library's index of the messages."""
    try:
        from pymavlink.DFReader import DFReader_binary
    except ImportError:
        remedy = install_remedy("pymavlink")
        raise InputError(path, "pymavlink is not installed", "the extra that reads flight logs", remedy) from None

    class Indexed(DFReader_binary):  # type: ignore[misc]  # the package has no types
        def __init__(self) -> None:
            try:
                super().__init__(str(path))
            except BaseException:
                self.filehandle.close()
                raise

        def init_clock(self) -> None:
            """No clock: the library would read messages one by one to find the date."""

    try:
        with silent():
            return Indexed()
    except Exception as error:  # the library raises many unrelated types on a damaged file
        raise InputError(path, f"not readable ({type(error).__name__}: {error})", _WHAT, "The file is damaged.") from None


@dataclass(frozen=True)
class _Type:
    """Messages of one type: their format of the library, and all of them as records (n,) named by column."""

    format: Any
    records: npt.NDArray[np.void]


def _streams(
    path: Path, types: list[_Type], losses: tuple[str, ...], options: ReadOptions, budget: Budget
) -> tuple[Stream, ...]:
    named = {name: (kind, rows) for kind in types for name, rows in _instances(kind)}
    budget.check_topics(path, len(named), "message types and instances")
    if not named:
        raise InputError(path, "no messages with a time and numbers", "at least one", "Record the flight again.")
    options.check_streams(path, named, "message type", "Correct `topic` in the recipe.")
    chosen = {name: found for name, found in named.items() if options.wants(name)}
    budget.check_numbers(path, sum(len(rows) * len(kind.records.dtype.names or ()) for kind, rows in chosen.values()))
    streams = [_stream(path, name, kind, rows, losses, options) for name, (kind, rows) in chosen.items()]
    empty = [loss for stream in streams if not len(stream) for loss in stream.losses]
    found = tuple(
        replace(stream, losses=tuple(dict.fromkeys((*stream.losses, *empty))))
        for stream in streams
        if stream.columns and len(stream)
    )
    if not found:
        raise InputError(path, "no numbers in its messages", "at least one column of numbers", "Record the flight again.")
    return found


def _types(path: Path, log: Any) -> tuple[list[_Type], tuple[str, ...]]:
    """The message types with time and numbers, and the losses."""
    data = np.frombuffer(log.data_map[:], np.uint8)
    found, losses, untimed, damaged = [], [], [], []
    covered = 0
    for number, kind in sorted(log.formats.items()):
        offsets = np.array(log.offsets[number], dtype=np.int64)
        offsets = offsets[offsets + kind.len <= len(data)]
        if not len(offsets):
            continue
        covered += len(offsets) * kind.len
        if kind.name in _NO_STREAMS:
            continue
        layout = _layout(kind)
        if layout is None:
            damaged.append(f"{kind.name} ({len(offsets)})")
        elif (first := next(iter(layout.names or ()))) not in _TIMES or layout[first].kind not in "iu":
            untimed.append(f"{kind.name} ({len(offsets)})")
        else:
            size = layout.itemsize
            rows = np.lib.stride_tricks.sliding_window_view(data, size)[offsets + 3]
            found.append(_Type(kind, np.ascontiguousarray(rows).view(layout).reshape(-1)))
    if covered < len(data):
        losses.append(
            f"{path.name}: {len(data) - covered} of {len(data)} bytes belong to no whole message and have been left out"
        )
    for names, reason in ((damaged, "a format that contradicts itself"), (untimed, "no time")):
        if names:
            losses.append(f"{path.name}: messages with {reason} have been left out: {listed(names, MOST)}")
    losses += _dropped(path, found)
    return found, tuple(losses)


def _layout(kind: Any) -> np.dtype[Any] | None:
    """The columns of a message as a record; None where letters, columns and length of the format do not fit each other."""
    from pymavlink.DFReader import FORMAT_TO_STRUCT

    columns = list(kind.columns)
    if len(set(columns)) < len(columns) or len(columns) != len(kind.format) or "" in columns:
        return None
    kinds: list[Any] = []
    for letter in kind.format:
        code = FORMAT_TO_STRUCT[letter][0]
        kinds.append(("<i2", (32,)) if letter == "a" else f"S{code[:-1]}" if code.endswith("s") else f"<{code}")
    layout = np.dtype(
        [(name, *kind) if isinstance(kind, tuple) else (name, kind) for name, kind in zip(columns, kinds, strict=True)]
    )
    return layout if columns and layout.itemsize + 3 == kind.len else None


def _dropped(path: Path, types: list[_Type]) -> Iterator[str]:
    """What the logger says that it has dropped: the last count in its statistics (``DSF.Dp``)."""
    for kind in types:
        if (
            kind.format.name != "DSF"
            or "Dp" not in (kind.records.dtype.names or ())
            or kind.records.dtype["Dp"].kind not in "iu"
        ):
            continue
        if dropped := int(kind.records["Dp"].max()):
            yield f"{path.name}: the logger dropped {dropped} messages (DSF.Dp)"


def _instances(kind: _Type) -> Iterator[tuple[str, npt.NDArray[np.intp]]]:
    """Name of each stream of a type, and its rows."""
    name, column = kind.format.name, kind.format.instance_field
    if column is None or column not in (kind.records.dtype.names or ()) or kind.records.dtype[column].shape:
        yield name, np.arange(len(kind.records))
        return
    values, inverse = np.unique(kind.records[column], return_inverse=True)
    for place, value in enumerate(values):
        text = value.decode("utf-8", errors="replace").rstrip("\0") if isinstance(value, bytes) else str(value)
        yield f"{name}[{text}]", np.flatnonzero(inverse == place)


def _stream(
    path: Path, name: str, kind: _Type, rows: npt.NDArray[np.intp], losses: tuple[str, ...], options: ReadOptions
) -> Stream:
    """The numbers of one type or instance, with multipliers and units as the log states them."""
    from pymavlink.DFReader import FORMAT_TO_STRUCT

    time, *others = kind.records.dtype.names or ()
    timed = kind.records[time][rows] <= LARGEST_NS // _TIMES[time]
    records = kind.records[rows[timed]]
    if late := int(np.count_nonzero(~timed)):
        losses = (*losses, f"{path.name}: {name}: {late} messages without a valid time have been left out")
    columns: dict[str, npt.NDArray[np.float64]] = {}
    units: dict[str, str] = {}
    unknown = []
    wanted = None if options.fields is None else options.fields.get(name)
    fields: list[str] = []
    for letter, key in zip(kind.format.format[1:], others, strict=True):
        if records.dtype[key].kind == "S":
            continue
        with np.errstate(invalid="ignore"):  # a signalling NaN
            values = records[key].astype(np.float64)
        factor = FORMAT_TO_STRUCT[letter][1]
        if factor is not None:
            values /= round(1.0 / factor)  # exact, other than a product with 0.01
        own = {key: values} if values.ndim == 1 else {f"{key}[{i}]": values[:, i] for i in range(values.shape[1])}
        stated = _UNITS.get(kind.format.get_unit(key), kind.format.get_unit(key))
        unit = _known_unit(stated)
        fields += own
        for field, column in own.items():
            if wanted is None or field in wanted:
                columns[field] = column
                if unit:
                    units[field] = unit
        if stated and not unit and (wanted is None or wanted & own.keys()):
            unknown.append(f"{key} [{stated}]")
    note = (f"{path.name}: {name}: units that are not known have been left out: {listed(unknown, MOST)}",) if unknown else ()
    stamps = records[time].astype(np.int64) * _TIMES[time]
    return Stream(name, path, {"boot": stamps}, columns, units, (*losses, *note), tuple(fields))


def _known_unit(text: str) -> str:
    """The unit, or nothing where it is none."""
    try:
        si_factor(text)
    except InputError:
        return ""
    return text
