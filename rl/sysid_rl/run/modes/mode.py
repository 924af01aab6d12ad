"""The goal of a mode in a cycle, and smooth joint-space moves."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from sysid_rl.run.limits import Limits

Array = npt.NDArray[np.float64]

#: Moves between joints use this share of the limits.
SHARE = 0.7


def _unknown_point() -> Array:
    return np.full(3, np.nan)


@dataclass(frozen=True)
class Goal:
    """The goal of one cycle: the first of commands, joints, aim that is given.

    Args:
        phase: for console and log.
        target: of the end effector at the end of this cycle, (3,) [m].
        aim: target that the policy observes: the same, or one further ahead.
        joints: setpoints (A,).
        commands: valve commands (A,), open loop.
        stop: reason to end the run; ``done``: the task is finished.
    """

    phase: str
    target: Array = field(default_factory=_unknown_point)
    aim: Array = field(default_factory=_unknown_point)
    joints: Array | None = None
    commands: Array | None = None
    stop: str = ""
    done: bool = False


def done(phase: str) -> Goal:
    """The task is finished."""
    return Goal(phase, stop=f"{phase} is done", done=True)


class Mode(Protocol):
    """A task.

    Attributes:
        name: as in recipes.
        moves: valves are enabled.
        writes: commands are sent; if not, another controller or a person drives the machine.
        computes: setpoints are computed.
    """

    name: str
    moves: bool
    writes: bool
    computes: bool

    def begin(self, joints: Array, ee: Array) -> None:
        """Begin the task with the machine at rest at ``joints`` (A,), its end effector at ``ee`` (3,)."""
        ...

    def goal(self, k: int, joints: Array, ee: Array) -> Goal:
        """The goal of cycle ``k`` since the beginning (held cycles do not count)."""
        ...


def _quintic(s: Array | float) -> Array | float:
    """From 0 at 0 to 1 at 1, with zero speed and acceleration at both ends."""
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s)


class Move:
    """A straight move in joint space, jerk-limited (quintic), all axes synchronised.

    Args:
        limits: :data:`SHARE` of them is used.
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
        """Joints (A,) ``k`` cycles after the beginning; the end after it."""
        s = min(max(k / self.steps, 0.0), 1.0)
        return np.asarray(self.begin + (self.end - self.begin) * _quintic(s))

    def sample(self, count: int) -> tuple[Array, Array]:
        """Joints and speeds at ``count`` equally spaced times, (count, A) each."""
        s = np.linspace(0.0, 1.0, count)[:, None]
        way = self.end - self.begin
        return self.begin + way * _quintic(s), way * 30.0 * (s * (1.0 - s)) ** 2 / self._seconds


class Approach:
    """A move to the start of a task, and a settling time.

    Args:
        to: joints (A,).
        limits, dt: of the machine.
        settle_s: settling time [s].
        aside: what an axis moves at least, forth and back where its way is shorter, so that it has answered before the task,
            (A,).
    """

    def __init__(self, to: Array, limits: Limits, dt: float, settle_s: float = 0.5, aside: Array | None = None) -> None:
        self.to, self._limits, self._dt, self._settle = np.array(to), limits, dt, round(settle_s / dt)
        self._aside = np.zeros(len(self.to)) if aside is None else aside
        self._moves: tuple[Move, ...] = ()

    def begin(self, joints: Array) -> None:
        near = np.abs(self.to - joints) < np.abs(self._aside)
        stations = [joints, self.to + self._aside * near, self.to] if near.any() else [joints, self.to]
        self._moves = tuple(Move(one, other, self._limits, self._dt) for one, other in itertools.pairwise(stations))

    @property
    def steps(self) -> int:
        """Its number of cycles."""
        return sum(move.steps for move in self._moves) + self._settle

    def goal(self, k: int) -> Goal:
        """Cycle ``k`` of it."""
        *first, last = self._moves
        for move in first:
            if k < move.steps:
                return Goal("approach", joints=move.at(k + 1))
            k -= move.steps
        return Goal("approach", joints=last.at(k + 1))
