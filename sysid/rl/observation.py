"""What a policy of the full path sees, and the memory it takes: one code for environments and for the runner.

Ten numbers are no Markov state under delay, lag and sway: the observation goes on with the commands of the dead time, the
speeds of the joints, and place and speed of the tool below the tip.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid.rl.task import ObservationSlices

Array = npt.NDArray[np.float64]


class DrivenObservation:
    """Of ``size`` machines side by side.

    Args:
        axes: names, in order.
        history: how many past commands are seen.
        rate_hz: steps a second.
    """

    def __init__(self, axes: Sequence[str], history: int, rate_hz: float, size: int = 1) -> None:
        self.axes, self.history, self.rate_hz, self.size = tuple(axes), history, rate_hz, size
        self.parts = ObservationSlices.of(len(self.axes))
        #: The last commands, newest first, (n, H, A).
        self.commands = np.zeros((size, history, len(self.axes)))
        #: Speeds of the joints and of the tool below the tip, (n, A + 3).
        self.speed = np.zeros((size, len(self.axes) + 3))

    @property
    def width(self) -> int:
        return self.parts.width + (self.history + 1) * len(self.axes) + 6

    @property
    def names(self) -> tuple[str, ...]:
        """What the columns are."""
        past = tuple(f"{axis}.command[{-1 - k}]" for k in range(self.history) for axis in self.axes)
        below = tuple(f"tool.{what}{axis}" for what in ("below.", "speed.") for axis in "xyz")
        return (*self.parts.names(self.axes), *past, *(f"{axis}.speed" for axis in self.axes), *below)

    def rest(self, which: npt.NDArray[np.bool_] | None = None) -> None:
        """Those of a mask, or all, are at rest with neutral valves."""
        lanes = slice(None) if which is None else which
        self.commands[lanes], self.speed[lanes] = 0.0, 0.0

    def sent(self, commands: Array) -> None:
        """``commands`` (n, A) were sent."""
        if self.history:
            self.commands[:, 1:] = self.commands[:, :-1]
            self.commands[:, 0] = commands

    def moved(self, joints: Array, before: Array, below: Array, below_before: Array) -> None:
        """A step led from ``before`` to ``joints`` (n, A), the tool below the tip from ``below_before`` to ``below`` (n, 3)."""
        count = len(self.axes)
        self.speed[:, :count] = (joints - before) * self.rate_hz
        self.speed[:, count:] = (below - below_before) * self.rate_hz

    def seen(self, joints: Array, ee: Array, target: Array, below: Array) -> Array:
        """Observations (n, O)."""
        count = len(self.axes)
        past = self.commands.reshape(self.size, -1)
        parts = joints, ee, target, past, self.speed[:, :count], below, self.speed[:, count:]
        return np.concatenate(parts, axis=1)
