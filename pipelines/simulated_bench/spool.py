"""A spool of second order with friction and flow forces, and the four edges that it opens."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from simulated_bench.compiled import compiled

Array = npt.NDArray[np.float64]

#: Play operators of the friction, of widths evenly spaced up to the widest (Prandtl–Ishlinskii).
PLAY_OPERATORS = 5


@compiled
def with_hysteresis(command: float, plays: Array, widest: float) -> float:
    """Command behind the hysteresis: the mean of play operators of growing width, with their state ``plays``."""
    if widest <= 0.0:
        return command
    total = 0.0
    for k in range(PLAY_OPERATORS):
        half = 0.5 * widest * (k + 1) / PLAY_OPERATORS
        plays[k] = min(max(plays[k], command - half), command + half)
        total += plays[k]
    return total / PLAY_OPERATORS


@compiled
def spool_motion(
    position: float, speed: float, target: float, push: float, omega: float, damping: float, fastest: float, step: float
) -> tuple[float, float]:
    """Position and speed after ``step`` (semi-implicit); ``push`` is the flow force as a displacement [command].

    The pilot stage limits the speed of the spool to ``fastest`` [command/s].
    """
    speed += step * (omega * omega * (target - push - position) - 2.0 * damping * omega * speed)
    speed = min(max(speed, -fastest), fastest)
    position += step * speed
    if position > 1.0 or position < -1.0:
        position = min(max(position, -1.0), 1.0)
        speed = 0.0
    return position, speed


@compiled
def edges(position: float, positive: float, negative: float, meter_out_lap: float, saturation: float) -> tuple[float, float]:
    """Opening from the pump (signed by direction) and to the tank (same sign) [command]."""
    if position > positive:
        return min(position - positive, saturation), min(max(position - positive - meter_out_lap, 0.0), saturation)
    if position < -negative:
        return max(position + negative, -saturation), max(min(position + negative + meter_out_lap, 0.0), -saturation)
    return 0.0, 0.0


@compiled
def flow_force(opening: float, drop: float, supply: float, share: float) -> float:
    """Displacement of the spool by the flow force [command], proportional to opening and pressure drop."""
    return share * opening * math.fabs(drop) / supply
