"""What each valve makes of a command, and back: the plain numbers behind barriers, ramps and dead reckoning.

Speeds are of what the command drives [m/s or rad/s]. Nothing here follows a setpoint: that is the cylinder controller's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from sysid.control import AxisTuning

#: One, or one of each of many.
Speed = TypeVar("Speed", float, npt.NDArray[np.float64])

#: Below this share of the top speed a valve counts as shut.
SHUT = 1e-3


class AxisValve:
    """One axis.

    Args:
        tuning: of the cylinder controller.
        dt: of a step [s].
    """

    def __init__(self, tuning: AxisTuning, dt: float) -> None:
        self.up, self.down = tuning.up, tuning.down
        self.positive, self.negative = tuning.positive, tuning.negative
        self.exponent, self.limit = tuning.exponent, tuning.limit
        self.low, self.high = tuning.low, tuning.high
        self.fastest = tuning.fastest
        #: Steps from a command to its motion.
        self.dead_steps = max(1, math.ceil(tuning.lead / dt - 1e-9))
        self.rate = tuning.rate

    def speed(self, command: float) -> float:
        """Speed at ``command`` once it has come through."""
        if command > self.positive:
            return float(self.up * min(self.limit, (command - self.positive) ** self.exponent))
        if command < -self.negative:
            return float(-self.down * min(self.limit, (-command - self.negative) ** self.exponent))
        return 0.0

    def command(self, speed: float) -> float:
        """The command for ``speed``, in [-1, 1]; zero where it is hardly any."""
        top = self.up if speed > 0.0 else self.down
        if abs(speed) <= SHUT * top:
            return 0.0
        effective = min(abs(speed) / top, self.limit) ** (1.0 / self.exponent)
        found = effective + (self.positive if speed > 0.0 else self.negative)
        return math.copysign(min(found, 1.0), speed)


def braking_speed(distance: float, after: float, braking: float) -> float:
    """The highest speed from which a stop that begins ``after`` seconds from now ends within ``distance``: v·t + v²/2a = d."""
    if distance <= 0.0:
        return 0.0
    return braking * (math.sqrt(after * after + 2.0 * distance / braking) - after)


def stopping_distance(speed: Speed, after: float, braking: float) -> Speed:
    """How far a stop goes that begins ``after`` seconds from now, with the sign of ``speed``."""
    return speed * after + abs(speed) * speed / (2.0 * braking)


class DeadReckoning:
    """Where an axis must be by its commands: dead reckoning that leans on the sensor.

    Args:
        valve: of the axis.
        dt: of a step [s].
        lean: time constant of leaning on the sensor [s].
    """

    def __init__(self, valve: AxisValve, dt: float, time_constant: float) -> None:
        self.valve, self.dt, self.time_constant = valve, dt, time_constant
        self.position = math.nan
        self.pending: list[float] = [0.0] * valve.dead_steps

    def reset(self, position: float) -> None:
        """At rest at ``position``."""
        self.position, self.pending = position, [0.0] * self.valve.dead_steps

    def step(self, command: float) -> None:
        """A step with ``command`` (neutral: zero) is over."""
        self.position += self.pending[-1] * self.dt
        self.pending = [self.valve.speed(command), *self.pending[:-1]]
        self.position = min(max(self.position, self.valve.low), self.valve.high)

    def correct(self, measured: float) -> None:
        """Lean on what a sound sensor says."""
        self.position += (measured - self.position) * min(1.0, self.dt / self.time_constant)

    def pending_travel(self, sign: float) -> float:
        """How far commands already given will move it in the direction ``sign``; never less than nothing."""
        return sum(max(0.0, sign * speed) for speed in self.pending) * self.dt


def axis_valves(tuning: Sequence[AxisTuning], dt: float) -> tuple[AxisValve, ...]:
    """Of all axes."""
    return tuple(AxisValve(item, dt) for item in tuning)
