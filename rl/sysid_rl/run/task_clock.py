"""The clock of a task: it stands while the task is held, and slows down where the setpoints cannot follow."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from sysid_rl.run.modes.mode import Goal, Mode

Array = npt.NDArray[np.float64]


class TaskClock:
    """Cycles of a task, also parts of them; the goal between two cycles is interpolated.

    Args:
        mode: the task.
    """

    def __init__(self, mode: Mode) -> None:
        self.mode = mode
        self.begin()

    def begin(self) -> None:
        """The task begins with its cycle 0."""
        self._at = 0.0
        self._before: tuple[int, Goal] | None = None
        self._last: tuple[int, Goal] | None = None

    def goal(self, joints: Array, ee: Array) -> Goal:
        """The goal now, at joints (A,) and end effector (3,)."""
        k = math.ceil(self._at - 1e-9)
        whole = abs(k - self._at) < 1e-9
        if self._last is None or k != self._last[0] or whole:
            if self._last is not None and k != self._last[0]:
                self._before = self._last
            self._last = k, self.mode.goal(k, joints, ee)
        goal = self._last[1]
        if whole or self._before is None or self._before[0] != k - 1:
            return goal
        return _between(self._before[1], goal, self._at - (k - 1))

    def advance(self, pace: float) -> None:
        """A cycle passes; ``pace``: speed of the clock, 0 … 1."""
        self._at += pace


def _between(before: Goal, goal: Goal, share: float) -> Goal:
    """A goal between two of the same kind; others are not interpolated."""
    if goal.stop or goal.commands is not None or (goal.joints is None) != (before.joints is None):
        return goal
    target = before.target + share * (goal.target - before.target)
    aim = before.aim + share * (goal.aim - before.aim)
    joints = None
    if goal.joints is not None and before.joints is not None:
        joints = np.asarray(before.joints + share * (goal.joints - before.joints))
    return replace(goal, target=target, aim=aim, joints=joints)
