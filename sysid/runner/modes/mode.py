"""What a mode wants in a cycle, and smooth moves from joints to joints that most of them begin with."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from sysid.runner.limits import Limits

Array = npt.NDArray[np.float64]

#: Moves between joints use this share of the limits.
SHARE = 0.7


def _unknown_point() -> Array:
    return np.full(3, np.nan)


@dataclass(frozen=True)
class Goal:
    """One cycle: a target for the policy, or joints, or valve commands; the first of commands, joints, aim that is there.

    Args:
        phase: for people and the log.
        target: where the end effector should be after this cycle, (3,) [m].
        aim: what the policy is shown: the target, or one further ahead.
        joints: setpoints (A,).
        commands: valve commands (A,), open loop.
        stop: why the run is to end; ``done``: because the task is.
    """

    phase: str
    target: Array = field(default_factory=_unknown_point)
    aim: Array = field(default_factory=_unknown_point)
    joints: Array | None = None
    commands: Array | None = None
    stop: str = ""
    done: bool = False


def done(phase: str) -> Goal:
    """The task is."""
    return Goal(phase, stop=f"{phase} is done", done=True)


class Mode(Protocol):
    """A task.

    Attributes:
        name: as in recipes.
        moves: valves are let move.
        writes: anything is sent at all; where not, another controller or a person drives the machine.
        thinks: setpoints are computed.
    """

    name: str
    moves: bool
    writes: bool
    computes: bool

    def begin(self, joints: Array, ee: Array) -> None:
        """The task starts with the machine at rest at ``joints`` (A,), its end effector at ``ee`` (3,)."""
        ...

    def goal(self, k: int, joints: Array, ee: Array) -> Goal:
        """What is wanted in turn ``k`` since the start (turns that were held do not count)."""
        ...


def _quintic(s: Array | float) -> Array | float:
    """From 0 at 0 to 1 at 1, at rest and without acceleration at both."""
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s)


class Move:
    """From joints to joints (A,) along a straight line of joint space, jerk-limited (quintic), all axes together.

    Args:
        limits: of which :data:`SHARE` is used.
        dt: of a cycle.
    """

    def __init__(self, begin: Array, end: Array, limits: Limits, dt: float) -> None:
        self.begin, self.end = np.array(begin), np.array(end)
        way = np.abs(self.end - self.begin)
        least = (
            1.875 * way / (SHARE * limits.speed),
            np.sqrt(5.7736 * way / (SHARE * limits.acceleration)),
            np.cbrt(60.0 * way / (SHARE * limits.jerk)),
        )
        self.steps = max(1, math.ceil(float(np.max(least)) / dt)) if way.size else 1
        self._seconds = self.steps * dt

    def at(self, k: int) -> Array:
        """Joints (A,) ``k`` cycles after the beginning; the last ones beyond the end."""
        s = min(max(k / self.steps, 0.0), 1.0)
        return np.asarray(self.begin + (self.end - self.begin) * _quintic(s))

    def sample(self, count: int) -> tuple[Array, Array]:
        """Joints and their speeds at ``count`` moments from the beginning to the end, (count, A) each."""
        s = np.linspace(0.0, 1.0, count)[:, None]
        way = self.end - self.begin
        return self.begin + way * _quintic(s), way * 30.0 * (s * (1.0 - s)) ** 2 / self._seconds


class Approach:
    """A move to where a task begins, and a while for the machine to settle there.

    Args:
        to: joints (A,).
        limits, dt: of the machine.
        settle_s: how long it settles.
    """

    def __init__(self, to: Array, limits: Limits, dt: float, settle_s: float = 0.5) -> None:
        self.to, self._limits, self._dt, self._settle = np.array(to), limits, dt, round(settle_s / dt)
        self._move: Move | None = None

    def begin(self, joints: Array) -> None:
        self._move = Move(joints, self.to, self._limits, self._dt)

    @property
    def steps(self) -> int:
        """Cycles it takes."""
        assert self._move is not None
        return self._move.steps + self._settle

    def goal(self, k: int) -> Goal:
        """Cycle ``k`` of it."""
        assert self._move is not None
        return Goal("approach", joints=self._move.at(k + 1))
