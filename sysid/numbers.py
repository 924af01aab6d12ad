"""The one check of numbers from files: finite, of the right sign, in the right order, and of a size that a machine can have.

Types for the fields of settings dataclasses, which :mod:`sysid.config` fills, and :func:`number` and :func:`interval` for what
is no TOML. A range is wide: it refuses what only a mistake of units, sign or typing gives.
"""

from __future__ import annotations

import functools
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


#: Anything in SI units: no length, angle, speed, force, mass or offset of a machine is beyond it.
LARGEST = 1e9

Finite = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
NonNegative = Annotated[float, Field(ge=0.0, le=LARGEST)]
#: At least 1e-12: what is divided by it stays finite.
Positive = Annotated[float, Field(ge=1e-12, le=LARGEST)]
#: A count of a converter, before it is scaled.
Raw = Annotated[float, Field(ge=-1e15, le=1e15)]
#: Samples a second.
Rate = Annotated[float, Field(ge=1e-3, le=1e6)]
#: A factor that turns one unit into another, or raw counts into a unit; its sign is free, zero is none.
Factor = Annotated[float, AfterValidator(_not_zero), Field(ge=-1e15, le=1e15)]
#: Lower end, then upper end.
Interval = Annotated[tuple[Finite, Finite], AfterValidator(_ordered)]


def number(text: Any, kind: Any, where: object) -> float:
    """The number that ``text`` says.

    Args:
        kind: one of the types above.

    Raises:
        SettingsError: text that is no number, NaN, infinity, or a number that is no ``kind``.
    """
    try:
        value: float = _adapter(kind).validate_python(text)
    except ValidationError as error:
        raise SettingsError(where, shown(text), expected_of(str(error.errors()[0]["msg"]))) from None
    return value


def interval(low: float, high: float, where: object) -> tuple[float, float]:
    """``(low, high)`` where that is their order; one of them may be infinite.

    Raises:
        SettingsError: NaN, reversed or equal.
    """
    if not low < high:
        raise SettingsError(where, f"[{low:g}, {high:g}]", "the lower end below the upper end")
    return low, high


@functools.cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind, config=ConfigDict(allow_inf_nan=False))


def expected_of(said: str) -> str:
    """What pydantic expected, as the second half of a message: ``Input should be a valid string`` → ``a valid string``."""
    said = said.removeprefix("Value error, ").removeprefix("Input should be ")
    said = f"a number {said}" if said.startswith(("greater than", "less than")) else said
    return said[:1].lower() + said[1:]
