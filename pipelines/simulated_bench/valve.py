"""A proportional valve: from the command to the speed of the drive it feeds.

Order: delay → silt → overlap (dead-band) → saturation → first-order lag of the spool, no faster than its pilot → notches →
taper → gain → direction ratio. The spool is integrated exactly over a step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from simulated_bench.compiled import compiled
from simulated_bench.recipe import ValveSettings

Array = npt.NDArray[np.float64]

#: A spool this close to closed is at rest [command].
AT_REST = 0.005


class ValveNumbers(NamedTuple):
    """Settings of one valve for compiled code."""

    gain: float
    delay: float
    time_constant: float
    positive: float
    negative: float
    saturation: float
    ratio: float
    notch: float
    taper: float
    silt: float
    spool_speed: float


def valve_of(settings: ValveSettings) -> ValveNumbers:
    return ValveNumbers(
        settings.gain,
        settings.delay,
        settings.time_constant,
        settings.deadband_positive,
        settings.deadband_negative,
        settings.saturation,
        settings.direction_ratio,
        settings.notch,
        settings.taper,
        settings.silt,
        settings.spool_speed,
    )


@compiled
def opening(command: float, positive: float, negative: float, saturation: float) -> float:
    """Valve opening [command] left over from ``command`` by the overlap and the saturation."""
    if command > positive:
        return min(command - positive, saturation)
    if command < -negative:
        return max(command + negative, -saturation)
    return 0.0


@compiled
def delayed(commands: Array, cycle: float, time: float, step: float, delay: float) -> float:
    """Mean over [time, time + step] of the held command, ``delay`` ago.

    Args:
        commands: command of every cycle so far (n,); cycle k holds from k·cycle on, the first one also before.
        cycle: length of a cycle [s], not shorter than ``step``.
    """
    start = time - delay
    end = start + step
    first = math.floor(start / cycle)
    last = math.floor(end / cycle)
    early = commands[min(max(first, 0), len(commands) - 1)]
    if first == last:
        return float(early)
    late = commands[min(max(last, 0), len(commands) - 1)]
    share = (end - last * cycle) / step
    return float(early + (late - early) * share)


@compiled
def spool_step(position: float, target: float, step: float, time_constant: float) -> tuple[float, float]:
    """Spool position after ``step`` and its mean over the step, for a target held over the step."""
    if time_constant <= 0.0:
        return target, target
    decay = math.exp(-step / time_constant)
    after = target + (position - target) * decay
    mean = target + (position - target) * (1.0 - decay) * time_constant / step
    return after, mean


@compiled
def piloted_step(position: float, target: float, step: float, time_constant: float, fastest: float) -> tuple[float, float]:
    """:func:`spool_step` of a spool whose pilot stage limits its speed to ``fastest`` [command/s].

    Far from its target the spool moves at that speed; within ``fastest·time_constant`` it approaches exponentially.
    """
    if fastest == math.inf:
        return spool_step(position, target, step, time_constant)
    away = target - position
    ahead = abs(away) - fastest * max(time_constant, 0.0)
    if ahead <= 0.0:
        return spool_step(position, target, step, time_constant)
    sign = math.copysign(1.0, away)
    travelling = min(ahead / fastest, step)
    there = position + sign * fastest * travelling
    area = 0.5 * (position + there) * travelling
    left = step - travelling
    if left <= 0.0:
        return there, area / step
    after, mean = spool_step(there, target, left, time_constant)
    return after, (area + mean * left) / step


@compiled
def freed(command: float, spool: float, silt: float) -> float:
    """Command at the spool: zero while silt locks a spool that rests closer to its centre than ``AT_REST``."""
    return 0.0 if abs(spool) < AT_REST and abs(command) < silt else command


@compiled
def metered(opening: float, notch: float, taper: float) -> float:
    """Metering area over that of the full opening, of a land with V-notches that reach over the share ``notch`` of it.

    The width of a V grows with its depth, so the area grows with the square; beyond the notches the whole edge opens. That edge
    is ``1 − taper`` times as wide where it begins as on average, and widens evenly.
    """
    if notch <= 0.0 and taper == 0.0:
        return opening
    size = abs(opening)
    if notch > 0.0:
        size = (0.5 * size * size / notch if size < notch else size - 0.5 * notch) / (1.0 - 0.5 * notch)
    return math.copysign((1.0 - taper) * size + taper * size * size, opening)


@compiled
def drive_speed(spool: float, gain: float, ratio: float, fluctuation: float) -> float:
    """Speed of the drive [m/s or rad/s] at a spool position; ``fluctuation`` is the relative flow disturbance."""
    speed = gain * spool * (1.0 + fluctuation)
    return speed * ratio if spool < 0.0 else speed


def flow_fluctuation(settings: ValveSettings, steps: int, step: float, rng: np.random.Generator) -> Array:
    """Relative flow disturbance, first-order coloured noise, (steps,); zeros where it is switched off."""
    if settings.disturbance == 0.0:
        return np.zeros(1)
    decay = math.exp(-step / settings.disturbance_time)
    white = rng.standard_normal(steps) * settings.disturbance * math.sqrt(1.0 - decay * decay)
    white[0] = settings.disturbance * rng.standard_normal()
    return np.asarray(_coloured(white, decay))


@compiled
def _coloured(white: Array, decay: float) -> Array:
    out = np.empty_like(white)
    state = 0.0
    for k in range(len(white)):
        state = decay * state + white[k]
        out[k] = state
    return out
