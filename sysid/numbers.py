"""Checks of numbers from files: finite, sign, order, and a range that any machine stays in.

Types for the fields of settings dataclasses (see :mod:`sysid.config`), and :func:`number` and :func:`interval` for other files.
The ranges are wide: only mistakes of units, sign or typing are refused.
"""

from __future__ import annotations

import functools
import math
from typing import Annotated, Any

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError

from sysid.errors import SettingsError
from sysid.foreign import shown


def _not_zero(value: float) -> float:
    if abs(value) < 1e-15:
        raise ValueError("a number other than zero")
    return value


def _ordered(ends: tuple[float, float]) -> tuple[float, float]:
    if not ends[0] < ends[1]:
        raise ValueError("lower end below upper end")
    return ends


#: Bound of every length, angle, speed, force, mass and offset, in SI units.
LARGEST = 1e9

Finite = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
NonNegative = Annotated[float, Field(ge=0.0, le=LARGEST)]
#: At least 1e-12, so that quotients stay finite.
Positive = Annotated[float, Field(ge=1e-12, le=LARGEST)]
#: Bound of what a converter counts, and of any measured value: an overflow is written as infinity, 9.9e37 (SCPI) or 3.4e38.
LARGEST_COUNT = 1e15
#: A count of a converter, before it is scaled.
Raw = Annotated[float, Field(ge=-LARGEST_COUNT, le=LARGEST_COUNT)]
#: Samples a second.
Rate = Annotated[float, Field(ge=1e-3, le=1e6)]
#: Its magnitude, from that of small bodies to that of giant planets [m/s²].
Gravity = Annotated[float, Field(ge=1e-3, le=100.0)]
#: A conversion factor between units, or from raw counts to a unit; of either sign, not zero.
Factor = Annotated[float, AfterValidator(_not_zero), Field(ge=-1e15, le=1e15)]
#: Lower end, then upper end.
Interval = Annotated[tuple[Finite, Finite], AfterValidator(_ordered)]


def number(text: Any, kind: Any, where: object) -> float:
    """``text`` as a number of type ``kind``.

    Args:
        kind: one of the types above.

    Raises:
        SettingsError: not a number, NaN, infinity, or outside ``kind``.
    """
    try:
        value: float = _adapter(kind).validate_python(text)
    except ValidationError as error:
        raise SettingsError(where, shown(text), expected_of(str(error.errors()[0]["msg"]))) from None
    return value


def interval(low: float, high: float, where: object) -> tuple[float, float]:
    """``(low, high)`` if ``low < high``; either may be infinite.

    Raises:
        SettingsError: NaN, reversed or equal.
    """
    if not low < high:
        raise SettingsError(where, f"[{low:g}, {high:g}]", "the lower end below the upper end")
    return low, high


def end_stops(low: float, high: float) -> tuple[float, float]:
    """The ends of a range, infinite where they are at or beyond :data:`LARGEST`, which stands for no end stop."""
    return -math.inf if low <= -LARGEST else low, math.inf if high >= LARGEST else high


@functools.cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind, config=ConfigDict(allow_inf_nan=False))


def expected_of(message: str) -> str:
    """The expectation in pydantic's message: ``Input should be a valid string`` → ``a valid string``."""
    message = message.removeprefix("Value error, ").removeprefix("Input should be ")
    message = f"a number {message}" if message.startswith(("greater than", "less than")) else message
    return message[:1].lower() + message[1:]
