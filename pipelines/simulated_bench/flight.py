"""The program ``flight``: a controller follows random paths, for logs of closed-loop operation.

The path of each axis goes from goal to goal with the speed of half a cosine, at a share of the drive's full speed. The
controller has speed feed-forward, position feedback and compensation of the valve overlap.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from simulated_bench.compiled import compiled
from simulated_bench.cylinder import drive_of, position_of
from simulated_bench.operator import COMMAND_STEP
from simulated_bench.recipe import AXES, BenchRecipe

Array = npt.NDArray[np.float64]

#: Gain of the position controller [1/s], and the share of the overlap that it compensates.
POSITION_GAIN = 3.0
OVERLAP_SHARE = 0.9
#: A demand below this share of full speed is zero, so that a resting drive does not chatter across its overlap.
MIN_COMMAND = 0.02


def draw_flight(recipe: BenchRecipe, seconds: float, rng: np.random.Generator) -> Array:
    """Setpoint of every drive in every controller cycle, and one beyond, (axes, cycles + 1) [m or rad]."""
    cycle = 1.0 / recipe.controller.rate
    cycles = round(seconds / cycle) + 1
    paths = np.empty((len(AXES), cycles))
    for path, name in zip(paths, AXES, strict=True):
        axis = recipe.axis(name)
        drive = drive_of(axis)
        clear = 2.0 * recipe.operator.margin * (drive.high - drive.low)
        at = position_of(axis.park, drive)
        k = min(round(recipe.operator.parked / cycle), cycles)
        path[:k] = at
        while k < cycles:
            goal = float(rng.uniform(drive.low + clear, drive.high - clear))
            fastest = float(rng.uniform(0.2, 0.7)) * axis.valve.gain
            ticks = max(round(0.5 * math.pi * abs(goal - at) / fastest / cycle), 1)
            rest = round(float(rng.uniform(0.2, 1.5)) / cycle)
            shape = 0.5 - 0.5 * np.cos(np.pi * np.minimum(np.arange(1, ticks + rest + 1) / ticks, 1.0))
            part = (at + (goal - at) * shape)[: cycles - k]
            path[k : k + len(part)] = part
            at, k = goal, k + len(part)
    return paths


@compiled
def flight_command(
    position: float, setpoint: float, next_setpoint: float, cycle: float, speed: float, positive: float, negative: float
) -> float:
    """Command for a drive at ``position`` with the ``setpoint`` of this cycle and that of the next.

    Args:
        speed: of the drive at command 1; ``positive``, ``negative``: overlap of its valve [command].
    """
    demand = ((next_setpoint - setpoint) / cycle + POSITION_GAIN * (setpoint - position)) / speed
    if abs(demand) < MIN_COMMAND:
        return 0.0
    command = demand + OVERLAP_SHARE * positive if demand > 0.0 else demand - OVERLAP_SHARE * negative
    return float(round(min(max(command, -1.0), 1.0) / COMMAND_STEP) * COMMAND_STEP)
