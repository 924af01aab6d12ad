"""The list of mistakes in units: factors by quantity.

A factor is by how much the value as read is too large. ``mm`` read as ``m`` is too large by 1000.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class UnitMistake:
    """A unit that was taken for another.

    Args:
        factor: value as read / true value.
        is_, read_as: the unit that the numbers have, and the one that was assumed.
        rarity: how unlikely it is beside the other mistakes in the list [nats].
    """

    factor: float
    is_: str
    read_as: str
    rarity: float = 0.0

    @property
    def inverse(self) -> UnitMistake:
        return UnitMistake(1.0 / self.factor, self.read_as, self.is_, self.rarity + 0.5)


def _both(*mistakes: UnitMistake) -> tuple[UnitMistake, ...]:
    return (*mistakes, *(mistake.inverse for mistake in mistakes))


DEGREES = 180.0 / math.pi

LENGTH = _both(
    UnitMistake(1000.0, "mm", "m"),
    UnitMistake(100.0, "cm", "m"),
    UnitMistake(10.0, "mm", "cm"),
    UnitMistake(1e6, "µm", "m", 2.0),
    UnitMistake(39.37, "inch", "m", 2.0),
)
ANGLE = _both(
    UnitMistake(DEGREES, "degrees", "rad"),
    UnitMistake(2.0 * math.pi, "rad", "turns", 1.0),
    UnitMistake(1000.0, "mrad", "rad", 1.0),
    UnitMistake(4096.0 / (2.0 * math.pi), "encoder counts (4096 a turn)", "rad", 2.0),
)
#: Speeds, as in ``gain``: per minute as well as in another unit.
ROTATION_SPEED = (*ANGLE, *_both(UnitMistake(60.0 / (2.0 * math.pi), "rpm", "rad/s", 1.0)))
LINEAR_SPEED = (*LENGTH, *_both(UnitMistake(60.0, "m/min", "m/s", 2.0)))
#: A command between −1 and 1, in the units of converters, buses and operators; full scale as the factor.
COMMAND = (
    UnitMistake(100.0, "per cent", "a fraction"),
    UnitMistake(0.01, "a fraction", "per cent", 0.5),
    UnitMistake(1000.0, "per mille", "a fraction", 1.0),
    UnitMistake(0.001, "a fraction", "per mille", 1.5),
    UnitMistake(10.0, "volts (full scale 10 V)", "a fraction", 1.5),
    UnitMistake(127.0, "counts of 8 bits", "a fraction", 1.5),
    UnitMistake(255.0, "counts (full scale 255)", "a fraction", 1.5),
    UnitMistake(1023.0, "counts (full scale 1023)", "a fraction", 2.0),
    UnitMistake(2047.0, "counts of 12 bits", "a fraction", 1.5),
    UnitMistake(4095.0, "counts (full scale 4095)", "a fraction", 1.5),
    UnitMistake(32767.0, "counts of 16 bits", "a fraction", 1.5),
)
FORCE = _both(
    UnitMistake(1000.0, "N", "kN"),
    UnitMistake(100.0, "N·cm", "N·m", 1.0),
    UnitMistake(9.80665, "N", "kgf", 1.0),
)
INERTIA = (
    UnitMistake(0.001, "t", "kg"),
    UnitMistake(1000.0, "g", "kg"),
    UnitMistake(1e4, "kg·cm²", "kg·m²", 1.0),
    UnitMistake(1e6, "kg·mm²", "kg·m²", 1.5),
    UnitMistake(1e7, "g·cm²", "kg·m²", 1.5),
)
TIME = _both(
    UnitMistake(1e3, "ms", "s"),
    UnitMistake(1e6, "µs", "s"),
    UnitMistake(1e9, "ns", "s"),
    UnitMistake(60.0, "s", "min", 2.0),
)


def nearest_mistake(ratio: float, mistakes: tuple[UnitMistake, ...]) -> UnitMistake:
    """The mistake whose factor is closest to ``ratio`` > 0, in the logarithm."""
    return min(mistakes, key=lambda mistake: abs(math.log(ratio / mistake.factor)) + 0.2 * mistake.rarity)
