"""Tuning of the cylinder controller from the plant: inverse of the valve, dead time, and the gains that follow from it.

A valve axis is an integrator with a dead time θ = delay + lag (+ half a sample of hold). The gains follow from the SIMC rule
with a closed-loop time constant of θ: ``Kp = 1/(2θ)``, ``Ti = 8θ``.

Source: Skogestad, Journal of Process Control 13 (2003), §4.3; dead-band inverse: Tao & Kokotović, IEEE TAC 39 (1994).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError
from sysid.plant import Plant
from sysid.plant.layout import AT, AXIS_WIDTH

Array = npt.NDArray[np.float64]

#: Largest rate of the command [1/s] if the plant has no lower one: a dead-band is crossed within a step at 100 Hz.
RATE = 40.0
#: Below this share of the top speed the dead-band is added in proportion to the speed, to avoid chatter.
REST_SHARE = 0.01
#: Bound of the integral, as a share of the top speed.
INTEGRAL_SHARE = 0.2
#: Proportional gain of an axis without dead time [1/s].
MAX_PROPORTIONAL = 20.0


@dataclass(frozen=True)
class AxisTuning:
    """One axis, in the driven coordinate: speeds [m/s or rad/s], positions [m or rad].

    Args:
        servo: 1.0 where the command is a position and passes through; all other values are then unused.
        up, down: speed at effective command +1 and −1, magnitudes.
        exponent: effective command = sign·\\|command\\|^exponent.
        positive, negative: dead-band (command).
        limit: effective command above which speed no longer rises.
        creep: speed of the internal leakage at zero command.
        backlash: between the drive and the sensor, full width.
        dead_time: from command to motion [s].
        proportional, integral: [1/s] and [1/s²].
        feed: share of the setpoint's own speed that is fed forward, 1.0 or 0.0.
        rate: of the command [1/s].
        low, high: limits of the setpoints.
    """

    servo: float
    up: float
    down: float
    exponent: float
    positive: float
    negative: float
    limit: float
    creep: float
    backlash: float
    dead_time: float
    proportional: float
    integral: float
    feed: float
    rate: float
    low: float
    high: float

    @property
    def fastest(self) -> float:
        """The lower of the top speeds of both directions."""
        ends = (self.up, self.positive), (self.down, self.negative)
        return min(float(speed * min(self.limit, max(0.0, 1.0 - band) ** self.exponent)) for speed, band in ends)

    def row(self) -> Array:
        """The numbers in the order of the fields, for the compiled law."""
        return np.array([getattr(self, field.name) for field in fields(self)])


def tune(plant: Plant) -> tuple[AxisTuning, ...]:
    """The tuning of each axis from the effects of the plant.

    Raises:
        SettingsError: a force axis, or a cylinder without stroke.
    """
    theta = plant.vector()
    return tuple(_tuned(plant, theta, i) for i in range(len(plant.machine.axes)))


def proportional_tuning(plant: Plant) -> tuple[AxisTuning, ...]:
    """A proportional controller without inverse of the valve and feed-forward, for comparison."""
    return tuple(
        replace(
            item, up=axis.gain, down=axis.gain, exponent=1.0, positive=0.0, negative=0.0, limit=math.inf, creep=0.0,
            backlash=0.0, proportional=2.0, integral=0.0, feed=0.0,
        )
        for axis, item in zip(plant.machine.axes, tune(plant), strict=True)
    )  # fmt: skip


def response_time(plant: Plant) -> float:
    """The largest dead time of any axis, delay plus lag [s]."""
    return max(item.dead_time for item in tune(plant))


def lookahead_time(plant: Plant) -> float:
    """:func:`response_time` in whole samples, rounded up [s]: how far ahead a controller has to know its targets."""
    rate = plant.machine.rate_hz
    return math.ceil(response_time(plant) * rate - 1e-9) / rate


def _tuned(plant: Plant, theta: Array, i: int) -> AxisTuning:
    axis = plant.machine.axes[i]
    where = f"cylinder controller: axis {axis.name}"
    if axis.actuation == "force":
        raise SettingsError(where, "is moved by force", "a velocity (valve) or position axis")
    b = i * AXIS_WIDTH
    low, high = axis.range
    rate = float(theta[b + AT.command_rate_limit])
    if axis.follows_positions:
        return AxisTuning(1.0, 1, 1, 1, 0, 0, math.inf, 0, 0, 0, 0, 0, 1, math.inf, low, high)
    dead_time = float(theta[b + AT.input_delay] + theta[b + AT.first_order_lag])
    dead = dead_time + 0.5 / plant.machine.rate_hz
    up = axis.gain * float(theta[b + AT.gain_error])
    proportional = min(1.0 / (2.0 * dead), MAX_PROPORTIONAL)
    return AxisTuning(
        servo=0.0,
        up=up,
        down=up * float(theta[b + AT.asymmetric_gain]),
        exponent=float(theta[b + AT.gain_curve]),
        positive=float(theta[b + AT.valve_deadband]),
        negative=float(theta[b + AT.valve_deadband + 1]),
        limit=float(theta[b + AT.flow_saturation]),
        creep=float(theta[b + AT.internal_leakage]),
        backlash=float(theta[b + AT.backlash_drive]) if axis.drives == "joint" else 0.0,
        dead_time=dead_time,
        proportional=proportional,
        integral=proportional / (8.0 * dead),
        feed=1.0,
        rate=min(rate, RATE),
        low=low,
        high=high,
    )
