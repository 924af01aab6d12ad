"""Cylinders: end stops, and the triangle of two levers that turns a displacement into a joint angle."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from simulated_bench.compiled import compiled
from simulated_bench.recipe import AxisSettings

Array = npt.NDArray[np.float64]


class Drive(NamedTuple):
    """Drive moved by a valve, with its end stops [m or rad]; ``triangle`` 0 = the joint itself is driven."""

    low: float
    high: float
    triangle: int
    a: float
    b: float
    offset: float
    retracted: float
    sense: float


def drive_of(axis: AxisSettings) -> Drive:
    cylinder = axis.cylinder
    if cylinder is None:
        return Drive(axis.limits[0], axis.limits[1], 0, 0.0, 0.0, 0.0, 0.0, 1.0)
    return Drive(0.0, cylinder.stroke, 1, cylinder.a, cylinder.b, cylinder.offset, cylinder.retracted, float(cylinder.sense))


@compiled
def within_stops(position: float, low: float, high: float) -> float:
    """The position of a drive, limited by its end stops."""
    return min(max(position, low), high)


@compiled
def joint_of(position: float, drive: Drive) -> float:
    """Joint value [rad or m] at a drive position: law of cosines for a cylinder."""
    if drive.triangle == 0:
        return position
    length = drive.retracted + position
    cosine = (drive.a * drive.a + drive.b * drive.b - length * length) / (2.0 * drive.a * drive.b)
    return drive.sense * math.acos(min(max(cosine, -1.0), 1.0)) - drive.offset


@compiled
def position_of(joint: float, drive: Drive) -> float:
    """Drive position at a joint value: the inverse of :func:`joint_of`."""
    if drive.triangle == 0:
        return joint
    cosine = math.cos(drive.sense * (joint + drive.offset))
    return math.sqrt(drive.a * drive.a + drive.b * drive.b - 2.0 * drive.a * drive.b * cosine) - drive.retracted
