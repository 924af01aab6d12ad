"""Valve characteristics in both directions, for command filter, ramps and dead reckoning.

Speeds are those of what the command drives [m/s or rad/s].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from sysid_rl.control import AxisTuning

Array = npt.NDArray[np.float64]
#: A number or an array.
Speed = TypeVar("Speed", float, Array)

#: Below this share of the top speed a valve counts as closed.
SHUT = 1e-3


class AxisValve:
    """The valve of one axis.

    Args:
        tuning: of the cylinder controller.
        dt: of a step [s].
    """

    def __init__(self, tuning: AxisTuning, dt: float) -> None:
        self.up, self.down = tuning.up, tuning.down
        self.positive, self.negative = tuning.positive, tuning.negative
        self.exponent, self.limit = tuning.exponent, tuning.limit
        self.low, self.high = tuning.low, tuning.high
        self.fastest, self.backlash = tuning.fastest, tuning.backlash
        #: Steps from a command to its motion.
        self.dead_steps = max(1, math.ceil(tuning.dead_time / dt - 1e-9))
        self.rate = tuning.rate

    def speed(self, command: float) -> float:
        """Speed at ``command`` after the dead time."""
        if command > self.positive:
            return float(self.up * min(self.limit, (command - self.positive) ** self.exponent))
        if command < -self.negative:
            return float(-self.down * min(self.limit, (-command - self.negative) ** self.exponent))
        return 0.0

    def command(self, speed: float) -> float:
        """The command for ``speed``, in [-1, 1]; zero below :data:`SHUT`."""
        top = self.up if speed > 0.0 else self.down
        if abs(speed) <= SHUT * top:
            return 0.0
        effective = min(abs(speed) / top, self.limit) ** (1.0 / self.exponent)
        found = effective + (self.positive if speed > 0.0 else self.negative)
        return math.copysign(min(found, 1.0), speed)


class ValveArray:
    """The valves of several axes as arrays, (A,) each.

    Args:
        valves: of the axes.
    """

    def __init__(self, valves: Sequence[AxisValve]) -> None:
        self.up, self.down, self.positive, self.negative, self.exponent, self.limit, self.fastest = (
            np.array([getattr(valve, name) for valve in valves])
            for name in ("up", "down", "positive", "negative", "exponent", "limit", "fastest")
        )

    def speeds(self, commands: Array, wider: Array | float) -> tuple[Array, Array]:
        """Speeds forwards and backwards, at least zero, at ``commands`` (A,) after the dead time.

        Args:
            wider: by what the dead-bands are wider than those of the valves; (k, 1) gives (k, A).
        """
        forwards = np.maximum(commands - np.maximum(self.positive + wider, 0.0), 0.0) ** self.exponent
        backwards = np.maximum(-commands - np.maximum(self.negative + wider, 0.0), 0.0) ** self.exponent
        return self.up * np.minimum(forwards, self.limit), self.down * np.minimum(backwards, self.limit)


def braking_speed(distance: float, after: float, braking: float) -> float:
    """Highest speed for which a stop that begins ``after`` seconds from now ends within ``distance``: v·t + v²/2a = d."""
    if distance <= 0.0:
        return 0.0
    return braking * (math.sqrt(after * after + 2.0 * distance / braking) - after)


def stopping_distance(speed: Speed, after: float, braking: float) -> Speed:
    """Distance of a stop that begins ``after`` seconds from now, with the sign of ``speed``."""
    return speed * after + abs(speed) * speed / (2.0 * braking)


class DeadReckoning:
    """Position of an axis by its commands, corrected by the sensor.

    Args:
        valve: of the axis.
        dt: of a step [s].
        time_constant: of the correction [s].
    """

    def __init__(self, valve: AxisValve, dt: float, time_constant: float) -> None:
        self.valve, self.dt, self.time_constant = valve, dt, time_constant
        self.position = math.nan
        self.pending: list[float] = [0.0] * valve.dead_steps

    def reset(self, position: float) -> None:
        """Reset to rest at ``position``."""
        self.position, self.pending = position, [0.0] * self.valve.dead_steps

    def step(self, command: float) -> None:
        """Record a step with ``command`` (neutral: zero)."""
        self.position += self.pending[-1] * self.dt
        self.pending = [self.valve.speed(command), *self.pending[:-1]]
        self.position = min(max(self.position, self.valve.low), self.valve.high)

    def correct(self, measured: float) -> None:
        """Correct by a valid measurement."""
        self.position += (measured - self.position) * min(1.0, self.dt / self.time_constant)

    def pending_travel(self, sign: float) -> float:
        """Travel in the direction ``sign`` by commands within the dead time; at least zero."""
        return sum(max(0.0, sign * speed) for speed in self.pending) * self.dt


def axis_valves(tuning: Sequence[AxisTuning], dt: float) -> tuple[AxisValve, ...]:
    """The valves of all axes."""
    return tuple(AxisValve(item, dt) for item in tuning)
