"""The operator: joystick strokes drawn beforehand, steered at run time by looking where the machine is.

A stroke has a smooth start and end and a level between. Before each stroke the operator looks whether there is room for it and
else pushes the other way; close to an end stop he lets go of the lever.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from simulated_bench.compiled import compiled
from simulated_bench.recipe import AXES, OperatorSettings

Array = npt.NDArray[np.float64]

#: Columns of a stroke table.
START, DURATION, LEVEL, EDGE = range(4)
#: Columns of the operator's state of one axis: stroke being made, its direction, how far the lever is let go.
STROKE, DIRECTION, HELD = range(3)

#: The joystick's converter: the command is a multiple of this.
COMMAND_STEP = 0.001
#: Time constant of a lever that is released near an end stop [s].
RELEASE_TIME = 0.12


def draw_strokes(settings: OperatorSettings, seconds: float, rng: np.random.Generator) -> Array:
    """All strokes of a recording, (axes, m, 4) with columns START, DURATION, LEVEL, EDGE [s, s, command, s].

    Rows beyond the last stroke of an axis start at infinity.
    """
    pauses = _draw_pauses(settings, seconds, rng)
    per_axis = [_strokes_of_axis(name == "slew", settings, seconds, pauses, rng) for name in AXES]
    table = np.full((len(AXES), max(len(strokes) for strokes in per_axis) + 1, 4), np.inf)
    for row, strokes in zip(table, per_axis, strict=True):
        row[: len(strokes)] = np.reshape(strokes, (-1, 4))
    return table


def _draw_pauses(settings: OperatorSettings, seconds: float, rng: np.random.Generator) -> list[tuple[float, float]]:
    """Pauses of all axes, (start, end) [s], the last one at the end of the recording."""
    pauses = []
    time = settings.parked
    while True:
        time += settings.pause_every * rng.uniform(0.7, 1.3)
        length = rng.uniform(*settings.pause)
        if time + length > seconds - 3.0:
            break
        pauses.append((time, time + length))
        time += length
    return [*pauses, (seconds - 1.0, math.inf)]


def _strokes_of_axis(
    is_slew: bool, settings: OperatorSettings, seconds: float, pauses: list[tuple[float, float]], rng: np.random.Generator
) -> list[tuple[float, float, float, float]]:
    strokes: list[tuple[float, float, float, float]] = []
    time = settings.parked + rng.uniform(0.0, 1.5)
    while time < seconds:
        slow = rng.random() < settings.slow_share
        # Slewing goes back and forth, often slowly; the other axes move in one direction at a time.
        repeats = int(rng.integers(3, 6)) if is_slew and rng.random() < 0.7 else int(rng.integers(1, 3))
        sign = 1.0 if rng.random() < 0.5 else -1.0
        for _ in range(repeats):
            level = rng.uniform(0.08, 0.35) if slow else rng.uniform(0.35, 1.0)
            duration = rng.uniform(1.0, 2.4) if slow else rng.uniform(0.7, 2.0 if repeats > 2 else 3.6)
            edge = min(rng.uniform(0.1, 0.6), 0.45 * duration)
            time = _after_pauses(time, duration, pauses)
            if time + duration > seconds:
                return strokes
            strokes.append((time, duration, sign * level, edge))
            time += duration + (0.0 if rng.random() < 0.4 else rng.uniform(0.05, 0.5))
            sign = -sign
        time += rng.exponential(0.6)
    return strokes


def _after_pauses(time: float, duration: float, pauses: list[tuple[float, float]]) -> float:
    """The first time from ``time`` on at which a stroke of ``duration`` does not overlap a pause."""
    for start, end in pauses:
        if time < end and time + duration > start:
            time = end
    return time


@compiled
def stroke_command(
    time: float,
    cycle: float,
    strokes: Array,
    state: Array,
    position: float,
    low: float,
    high: float,
    speed: float,
    margin: float,
) -> float:
    """The lever of one axis at ``time``, given where the drive is.

    Args:
        strokes: this axis' rows of :func:`draw_strokes`.
        state: STROKE, DIRECTION, HELD; changed in place.
        low, high: end stops of the drive; ``speed`` its speed at command 1.
        margin: share of the range that the operator keeps clear at either end.
    """
    k = int(state[STROKE])
    while time >= strokes[k, START] + strokes[k, DURATION]:
        k += 1
        state[STROKE] = k
        state[DIRECTION] = 0.0
    if time < strokes[k, START]:
        return 0.0
    clear = margin * (high - low)
    level = abs(strokes[k, LEVEL])
    if state[DIRECTION] == 0.0:
        sign = 1.0 if strokes[k, LEVEL] > 0.0 else -1.0
        travel = level * speed * (strokes[k, DURATION] - strokes[k, EDGE])
        room = high - clear - position if sign > 0.0 else position - low - clear
        other = position - low - clear if sign > 0.0 else high - clear - position
        state[DIRECTION] = -sign if room < travel and other > room else sign
        state[HELD] = 1.0
    direction = state[DIRECTION]
    stopping = clear + 0.25 * level * speed
    if (direction > 0.0 and position > high - stopping) or (direction < 0.0 and position < low + stopping):
        state[HELD] *= math.exp(-cycle / RELEASE_TIME)
    into = time - strokes[k, START]
    left = strokes[k, DURATION] - into
    ramp = min(min(into, left) / strokes[k, EDGE], 1.0)
    shape = 0.5 - 0.5 * math.cos(math.pi * ramp)
    return float(round(direction * level * shape * state[HELD] / COMMAND_STEP) * COMMAND_STEP)
