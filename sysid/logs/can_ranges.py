"""Raw values of a CAN signal that are no measurement: "not available" and "error", or outside of the range of the database.

J1939 reserves the upper end of every unsigned parameter. In whole bytes (8 to 32 bits) the most significant one decides: up to
0xFA a value, 0xFB to 0xFD an indicator or reserved, 0xFE an error, 0xFF not available. In two bits 0b10 is an error and 0b11
not available; in any other number of bits all ones are not available. Signed and floating-point signals are no parameters of
J1939. In other databases all bits one are "not available" where the database states a range that excludes them. Any other value
outside of a stated range is kept and counted: such ranges are often wrong.
Source: SAE J1939-71, "Transmitted signal ranges" and "Transmitted values for discrete parameters".
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sysid.logs.can_frames import Frames
from sysid.logs.can_signals import Array, is_plain, raw_values

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal

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
