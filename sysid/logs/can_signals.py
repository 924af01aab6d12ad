"""CAN payloads → signals, all frames of a message at once, as its database (DBC) describes them; and raw values that are no
measurement: "not available" and "error", or outside of the range of the database.

A signal is a range of bits: ``value = scale · raw + offset``. Little endian (Intel) counts bits upwards from the least
significant one, big endian (Motorola) downwards from the most significant one, byte after byte. NumPy extracts signals of up to
64 bits; cantools decodes a message with a longer one frame by frame.

J1939 reserves the upper end of every unsigned parameter. In whole bytes (8 to 32 bits) the most significant one decides: up to
0xFA a value, 0xFB to 0xFD an indicator or reserved, 0xFE an error, 0xFF not available. In two bits 0b10 is an error and 0b11
not available; in any other number of bits all ones are not available. Signed and floating-point signals are no parameters of
J1939. In other databases all bits one are "not available" where the database states a range that excludes them. Any other value
outside of a stated range is kept and counted: such ranges are often wrong.

Sources: Vector, "DBC File Format Documentation" (cantools decodes the same frames in the tests); SAE J1939-71, "Transmitted
signal ranges" and "Transmitted values for discrete parameters".
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError
from sysid.logs.can_frames import Frames
from sysid.logs.limits import check_file

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal


Array = npt.NDArray[np.float64]
#: The largest databases have some megabytes; their parser takes a hundred times as much memory.
_MAX_DATABASE = 16 * 2**20
_FLOATS: dict[int, tuple[type[np.unsignedinteger], type[np.floating]]] = {
    16: (np.uint16, np.float16),
    32: (np.uint32, np.float32),
    64: (np.uint64, np.float64),
}  # fmt: skip


def load_database(path: Path) -> Database:
    """Read a DBC file.

    Raises:
        InputError: missing, empty, no DBC file, or one that contradicts itself.
    """
    import cantools
    from cantools.database.can import Database
    from cantools.database.errors import Error

    check_file(path, "a CAN database (DBC)", limit=_MAX_DATABASE)
    try:
        database = cantools.database.load_file(path, database_format="dbc", encoding="cp1252", strict=False)
    except (Error, ValueError, KeyError, IndexError, TypeError, AttributeError) as error:
        raise InputError(
            path, f"not readable as a CAN database ({error})", "a DBC file", "Export the database again."
        ) from None
    assert isinstance(database, Database)
    if not database.messages:
        raise InputError(path, "no messages", "at least one message (BO_) with signals (SG_)", "Is it a DBC file?")
    return database


def decode(message: Message, frames: Frames) -> dict[str, Array]:
    """Signal → values (n,); NaN in frames that are too short or in which the multiplexer selects another signal."""
    if message.is_container or any(not is_plain(signal) for signal in message.signals):
        return _decode_each(message, frames)
    raws = {signal.name: raw_values(signal, frames) for signal in message.signals}
    return {
        signal.name: np.where(_present(signal, message, frames, raws), _scaled(signal, raws[signal.name]), np.nan)
        for signal in message.signals
    }


def is_plain(signal: Signal) -> bool:
    """Whether NumPy extracts a signal: a float of 16, 32 or 64 bits, or an integer of up to 64."""
    return signal.length in _FLOATS if signal.conversion.is_float else 1 <= signal.length <= 64


def _span(signal: Signal) -> tuple[int, int, int]:
    """First and last byte of a signal, and the position of its least significant bit within its byte."""
    if signal.byte_order == "little_endian":
        last = signal.start + signal.length - 1
        return signal.start // 8, last // 8, signal.start % 8
    first = 8 * (signal.start // 8) + 7 - signal.start % 8
    last = first + signal.length - 1
    return first // 8, last // 8, 7 - last % 8


def raw_values(signal: Signal, frames: Frames) -> npt.NDArray[np.uint64]:
    """The bits of a signal as unsigned integers (n,); 0 where the payload is too short."""
    first, last, shift = _span(signal)
    data = frames.data
    if last >= data.shape[1]:
        return np.zeros(len(data), np.uint64)
    own = data[:, first : last + 1].astype(np.uint64)
    if signal.byte_order == "big_endian":
        own = own[:, ::-1]
    raw = np.zeros(len(data), np.uint64)
    for place in range(min(own.shape[1], 8)):
        raw |= own[:, place] << np.uint64(8 * place)
    raw >>= np.uint64(shift)
    if own.shape[1] == 9:
        raw |= own[:, 8] << np.uint64(64 - shift)
    return raw & np.uint64((1 << signal.length) - 1)


def _scaled(signal: Signal, raw: npt.NDArray[np.uint64]) -> Array:
    conversion = signal.conversion
    if conversion.is_float:
        unsigned, floating = _FLOATS[signal.length]
        with np.errstate(invalid="ignore"):  # a signalling NaN
            values = raw.astype(unsigned).view(floating).astype(np.float64)
    elif signal.is_signed:
        unused = 64 - signal.length
        values = ((raw << np.uint64(unused)).view(np.int64) >> np.int64(unused)).astype(np.float64)
    else:
        values = raw.astype(np.float64)
    return np.asarray(values * float(conversion.scale) + float(conversion.offset))


def _present(
    signal: Signal, message: Message, frames: Frames, raws: dict[str, npt.NDArray[np.uint64]]
) -> npt.NDArray[np.bool_]:
    """Mask of the frames whose payload contains ``signal``, (n,)."""
    there = np.asarray(frames.lengths > _span(signal)[1])
    switch = switch_of(signal, message)
    if switch is not None:
        selected = np.isin(raws[switch.name], np.array(signal.multiplexer_ids, np.uint64))
        there = there & selected & _present(switch, message, frames, raws)
    return there


def switch_of(signal: Signal, message: Message) -> Signal | None:
    """The multiplexer that selects ``signal``; None where every frame contains it."""
    if not signal.multiplexer_ids or signal.multiplexer_signal is None:
        return None
    return message.get_signal_by_name(signal.multiplexer_signal)


def selected(signal: Signal, message: Message, frames: Frames) -> npt.NDArray[np.bool_]:
    """Mask of the frames (n,) in which the multiplexers select ``signal``, whether the payload reaches it or not."""
    switch = switch_of(signal, message)
    if switch is None:
        return np.ones(len(frames.lengths), dtype=bool)
    there = np.asarray(frames.lengths > _span(switch)[1])
    own = np.isin(raw_values(switch, frames), np.array(signal.multiplexer_ids, np.uint64))
    return there & own & selected(switch, message, frames)


def _decode_each(message: Message, frames: Frames) -> dict[str, Array]:
    """:func:`decode` frame by frame with cantools."""
    from bitstruct import Error as BitsError
    from cantools.database.errors import DecodeError

    columns = {signal.name: np.full(len(frames.data), np.nan) for signal in message.signals}
    for row, (payload, length) in enumerate(zip(frames.data, frames.lengths, strict=True)):
        try:
            decoded = message.decode(payload[:length].tobytes(), decode_choices=False, allow_truncated=True)
        except (DecodeError, BitsError):
            continue  # a multiplexer value without signals
        assert isinstance(decoded, dict)
        for name, value in decoded.items():
            columns[name][row] = float(value)  # type: ignore[arg-type]
    return columns


#: Most significant byte of a parameter of whole bytes (first, last) → what it means.
_J1939_BYTES = {(0xFF, 0xFF): "not available", (0xFE, 0xFE): "error", (0xFB, 0xFD): "indicator or reserved"}
#: The same of a parameter of two bits.
_J1939_TWO_BITS = {(3, 3): "not available", (2, 2): "error"}
_LARGEST_J1939 = 32


def is_j1939(message: Message, database: Database) -> bool:
    """Whether a message follows SAE J1939: 29 bits, and its ``VFrameFormat``, else the database's ``ProtocolType``, says so."""
    if not message.is_extended_frame or message.protocol == "j1939":
        return message.is_extended_frame
    stated = message.dbc is not None and "VFrameFormat" in message.dbc.attributes
    protocol = database.dbc.attributes.get("ProtocolType") if database.dbc is not None else None
    return not stated and protocol is not None and str(protocol.value).upper() == "J1939"


def measured(
    message: Message, j1939: bool, frames: Frames, columns: dict[str, Array]
) -> tuple[dict[str, Array], dict[str, tuple[str, ...]]]:
    """The decoded ``columns`` (n,) of a message, NaN where a raw value is no measurement, and signal → what was counted."""
    result, found = dict(columns), {}
    for signal in message.signals:
        if not is_plain(signal):
            continue
        values = columns[signal.name]
        counts: dict[str, int] = {}
        if not signal.is_signed and not signal.conversion.is_float:
            missing = np.zeros(len(values), dtype=bool)
            for meaning, mask in _special(signal, j1939, frames, values).items():
                own = mask & np.isfinite(values)
                counts[meaning] = int(np.count_nonzero(own))
                missing |= own
            values = result[signal.name] = np.where(missing, np.nan, values)
        texts = [_text(counts, j1939)] if any(counts.values()) else []
        outside = int(np.count_nonzero(_outside(signal, values)))
        if outside:
            of = f"the range {signal.minimum:g} to {signal.maximum:g} that the database states"
            texts.append(f"{outside} value{'s' if outside > 1 else ''} outside of {of}: kept")
        if texts:
            found[signal.name] = tuple(texts)
    return result, found


def _text(counts: dict[str, int], j1939: bool) -> str:
    """``3 samples 'not available', 1 'error' (SAE J1939-71): missing``."""
    parts = [f"{count} {meaning!r}" for meaning, count in counts.items() if count]
    number, _, rest = ", ".join(parts).partition(" ")
    source = "SAE J1939-71" if j1939 else "all bits one, outside of the range that the database states"
    return f"{number} sample{'' if number == '1' else 's'} {rest} ({source}): missing"


def _special(signal: Signal, j1939: bool, frames: Frames, values: Array) -> dict[str, npt.NDArray[np.bool_]]:
    """Meaning → mask of the frames (n,) in which an unsigned signal has no value."""
    raw = raw_values(signal, frames)
    if j1939 and (signal.length == 2 or (signal.length % 8 == 0 and signal.length <= _LARGEST_J1939)):
        classes = _J1939_TWO_BITS if signal.length == 2 else _J1939_BYTES
        top = raw >> np.uint64(max(signal.length - 8, 0))
        return {meaning: (top >= low) & (top <= high) for (low, high), meaning in classes.items()}
    ones = raw == np.uint64((1 << signal.length) - 1)
    if signal.length < 2:
        return {}
    return {"not available": ones if j1939 else ones & _outside(signal, values)}


def _outside(signal: Signal, values: Array) -> npt.NDArray[np.bool_]:
    """Mask of the values beyond the stated range by more than half a step: ranges are rounded. None where it states none."""
    if signal.minimum is None or signal.maximum is None or not signal.minimum < signal.maximum:
        return np.zeros(len(values), dtype=bool)
    rounding = 0.5 * abs(float(signal.conversion.scale)) if not signal.conversion.is_float else 0.0
    with np.errstate(invalid="ignore"):
        return np.asarray((values < float(signal.minimum) - rounding) | (values > float(signal.maximum) + rounding))
