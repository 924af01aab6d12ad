"""Hold the position; compute another mode without sending; record manual operation."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from sysid_rl.run.modes.mode import Goal, Mode, done

Array = npt.NDArray[np.float64]


class Hold:
    """Hold the initial joints for ``seconds`` (None: until the operator stops)."""

    name, moves, writes, computes = "hold", True, True, True

    def __init__(self, dt: float, seconds: float | None = None) -> None:
        self._last = math.inf if seconds is None else seconds / dt
        self._joints: Array | None = None

    def begin(self, joints: Array, ee: Array) -> None:
        self._joints = joints.copy()

    def goal(self, k: int, joints: Array, ee: Array) -> Goal:
        return done("hold") if k >= self._last else Goal("hold", joints=self._joints)


class Shadow:
    """Compute and record another mode; nothing is sent. A person or another controller drives the machine."""

    name, moves, writes, computes = "shadow", False, False, True

    def __init__(self, mode: Mode) -> None:
        self.mode = mode

    def begin(self, joints: Array, ee: Array) -> None:
        self.mode.begin(joints, ee)

    def goal(self, k: int, joints: Array, ee: Array) -> Goal:
        return self.mode.goal(k, joints, ee)


class Teleop:
    """Record manual operation; nothing is computed or sent."""

    name, moves, writes, computes = "teleop", False, False, False

    def begin(self, joints: Array, ee: Array) -> None:
        """Nothing begins."""

    def goal(self, k: int, joints: Array, ee: Array) -> Goal:
        return Goal("teleop")
