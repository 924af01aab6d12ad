"""The calibration routine: moves to random poses one after the other and holds each."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from simulated_bench.compiled import compiled
from simulated_bench.cylinder import drive_of, position_of
from simulated_bench.recipe import AXES, BenchRecipe

Array = npt.NDArray[np.float64]

#: Columns of the routine's state: pose being taken, 0 = driving or the moment of arrival [s].
POSE, ARRIVED = range(2)

#: Least command, its excess over a wider overlap, and the gain of the approach [1/s].
MIN_LEVER = 0.26
BEYOND_OVERLAP = 0.06
APPROACH = 2.5
#: An axis has arrived within this share of its range; the pose need not be exact, only still.
TOLERANCE = 0.004


def draw_targets(recipe: BenchRecipe, count: int, rng: np.random.Generator) -> Array:
    """Drive positions of random poses, uniform over the joint ranges less ``inset`` at either end, (count, axes)."""
    targets = np.empty((count, len(AXES)))
    for column, name in enumerate(AXES):
        axis = recipe.axis(name)
        low, high = axis.limits
        inset = recipe.routine.inset * (high - low)
        joints = rng.uniform(low + inset, high - inset, count)
        drive = drive_of(axis)
        targets[:, column] = [position_of(joint, drive) for joint in joints]
    return targets


@compiled
def approach_command(position: float, target: float, low: float, high: float, speed: float, overlap: float) -> float:
    """Command that moves a drive to ``target``, beyond the ``overlap`` of its valve; zero on arrival."""
    error = target - position
    if abs(error) < TOLERANCE * (high - low):
        return 0.0
    size = min(max(MIN_LEVER, overlap + BEYOND_OVERLAP) + APPROACH * abs(error) / speed, 1.0)
    return size if error > 0.0 else -size
