"""The observation on the full path and its memory, shared by environments and runner.

Joints, end effector and target are no Markov state under delay, lag and sway: the observation also has the commands of the dead
time, the speeds of the joints, and position and speed of the tool relative to the tip.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid.plant import Plant
from sysid_rl.control import response_time
from sysid_rl.train.task import ObservationSlices

Array = npt.NDArray[np.float64]


def dead_steps(plant: Plant, rate_hz: float) -> int:
    """Steps of the longest dead time of a plant, and one more."""
    return max(1, math.ceil(response_time(plant) * rate_hz) + 1)


class DrivenObservation:
    """Of ``size`` machines.

    Args:
        axes: names, in order.
        history: number of past commands.
        rate_hz: steps per second.
    """

    def __init__(self, axes: Sequence[str], history: int, rate_hz: float, size: int = 1) -> None:
        self.axes, self.history, self.rate_hz, self.size = tuple(axes), history, rate_hz, size
        self.slices = ObservationSlices.of(len(self.axes))
        #: The last commands, newest first, (n, H, A).
        self.commands = np.zeros((size, history, len(self.axes)))
        #: Speeds of the joints and of the tool below the tip, (n, A + 3).
        self.speed = np.zeros((size, len(self.axes) + 3))

    @property
    def width(self) -> int:
        return self.slices.width + (self.history + 1) * len(self.axes) + 6

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        past = tuple(f"{axis}.command[{-1 - k}]" for k in range(self.history) for axis in self.axes)
        below = tuple(f"tool.{what}{axis}" for what in ("below.", "speed.") for axis in "xyz")
        return (*self.slices.names(self.axes), *past, *(f"{axis}.speed" for axis in self.axes), *below)

    def rest(self, which: npt.NDArray[np.bool_] | None = None) -> None:
        """Put those of a mask, or all, at rest with neutral valves."""
        lanes = slice(None) if which is None else which
        self.commands[lanes], self.speed[lanes] = 0.0, 0.0

    def sent(self, commands: Array) -> None:
        """Record the sent ``commands`` (n, A)."""
        if self.history:
            self.commands[:, 1:] = self.commands[:, :-1]
            self.commands[:, 0] = commands

    def moved(self, joints: Array, before: Array, below: Array, below_before: Array) -> None:
        """Record a step from ``before`` to ``joints`` (n, A), and of the tool relative to the tip (n, 3)."""
        count = len(self.axes)
        self.speed[:, :count] = (joints - before) * self.rate_hz
        self.speed[:, count:] = (below - below_before) * self.rate_hz

    def seen(self, joints: Array, ee: Array, target: Array, below: Array) -> Array:
        """Observations (n, O)."""
        count = len(self.axes)
        past = self.commands.reshape(self.size, -1)
        parts = joints, ee, target, past, self.speed[:, :count], below, self.speed[:, count:]
        return np.concatenate(parts, axis=1)
