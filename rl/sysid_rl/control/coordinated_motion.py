"""Coordinated motion from rest to rest: all axes move in proportion, so that they start and arrive together.

The path is straight in the driven coordinates d (cylinders, or joints): ``d(t) = d₀ + s(t)·(d₁ − d₀)``, s from 0 to 1 with a
trapezoidal (or triangular) rate, the fastest within::

    |ḋ_i| ≤ speed_i        |d̈_i| ≤ acceleration_i        Σ |ḋ_i|/gain_i ≤ flow

The last one is the flow of a shared pump: axes that move in proportion are slowed by one factor, so that the path stays
straight, and the setpoint remains one that the machine can follow.

Source: synchronised point-to-point motion, Siciliano et al., Robotics (2009), §4.2; trapezoidal velocity profile there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.effects import pump_flow_limit
from sysid.plant import Plant
from sysid_rl.control.tuning import AxisTuning

Array = npt.NDArray[np.float64]

#: Share of top speeds and flow that a motion uses; the rest is for corrections by the controller.
SHARE = 0.95
#: Time from rest to top speed [s], as the default of the runner's limits.
RISE_S = 0.2


@dataclass(frozen=True)
class MotionLimits:
    """Limits of the driven coordinates, (A,) each.

    Args:
        speed: [m/s or rad/s].
        acceleration: [m/s² or rad/s²].
        gain: speed at full command, the unit of the flow [m/s or rad/s].
        flow: of the pump, the greatest sum of |speed|/gain.
    """

    speed: Array
    acceleration: Array
    gain: Array
    flow: float = math.inf


def motion_limits(plant: Plant, tuning: Sequence[AxisTuning], *, share: float = SHARE, with_pump: bool = True) -> MotionLimits:
    """``share`` of the top speeds of all axes and of the pump's flow, if the plant has ``pump_flow_limit``.

    Args:
        with_pump: False: as if each axis had a pump of its own.
    """
    speed = share * np.array([item.fastest for item in tuning])
    gain = np.array([axis.gain for axis in plant.machine.axes])
    pump = plant.effect(pump_flow_limit.EFFECT.name, "machine") if with_pump else None
    flow = math.inf if pump is None else share * float(np.atleast_1d(pump.parameters["limit"])[0])
    return MotionLimits(speed, speed / RISE_S, gain, flow)


@dataclass(frozen=True)
class CoordinatedMotion:
    """One motion.

    Args:
        begin, end: driven coordinates, (A,) [m or rad].
        rate, acceleration: greatest ṡ [1/s] and s̈ [1/s²].
    """

    begin: Array
    end: Array
    rate: float
    acceleration: float

    @property
    def rise(self) -> float:
        """Time until the greatest rate is reached [s]."""
        return min(self.rate / self.acceleration, math.sqrt(1.0 / self.acceleration)) if math.isfinite(self.rate) else 0.0

    @property
    def duration(self) -> float:
        """[s]; zero if nothing moves."""
        return self.rise + 1.0 / (self.acceleration * self.rise) if self.rise > 0.0 else 0.0

    def at(self, seconds: float) -> Array:
        """Driven coordinates (A,) ``seconds`` after the start; the end after it."""
        if seconds >= self.duration:
            return self.end.copy()
        t, top = max(seconds, 0.0), self.acceleration * self.rise
        left = self.duration - t
        if t < self.rise:
            share = 0.5 * self.acceleration * t * t
        elif left < self.rise:
            share = 1.0 - 0.5 * self.acceleration * left * left
        else:
            share = top * (t - 0.5 * self.rise)
        return np.asarray(self.begin + share * (self.end - self.begin))


def coordinated_motion(begin: npt.ArrayLike, end: npt.ArrayLike, limits: MotionLimits) -> CoordinatedMotion:
    """The fastest coordinated motion from ``begin`` to ``end``, (A,) each, within ``limits``."""
    first, last = np.asarray(begin, dtype=np.float64), np.asarray(end, dtype=np.float64)
    way = np.abs(last - first)
    if not way.any():
        return CoordinatedMotion(first, last, math.inf, math.inf)
    moving = way > 0.0
    rate = min(float((limits.speed[moving] / way[moving]).min()), limits.flow / float(np.sum(way / limits.gain)))
    return CoordinatedMotion(first, last, rate, float((limits.acceleration[moving] / way[moving]).min()))
