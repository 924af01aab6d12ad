"""How well a hanging tool follows its target and comes to rest, from a tracking run.

The target of a run is that of the boom tip. The target of the tool is the place where it hangs at rest below it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError
from sysid_rl.control.pendulum import Pendulum
from sysid_rl.train.tracking import TrackingResult

Array = npt.NDArray[np.float64]

#: A point counts as settled within this distance of its target [m]: the accuracy that the paper reports in simulation.
TOLERANCE = 0.01


@dataclass(frozen=True)
class ToolFigures:
    """Of one run.

    Args:
        rmse, worst: error of the tool while the target moves, (3,) [m]; NaN where it rests all the time.
        arrival: from the stop of the target until the boom tip stays within the tolerance [s], for at least a period of the
            pendulum before the run ends; infinite if never.
        settling: the same of the tool.
        swing: greatest horizontal distance between tool and tip, from a period of the pendulum after the arrival on, since
            before that the string still carries the deceleration [m]; NaN without arrival.
    """

    rmse: Array
    worst: Array
    arrival: float
    settling: float
    swing: float


def tool_figures(run: TrackingResult, pendulum: Pendulum, tolerance: float = TOLERANCE) -> ToolFigures:
    """The figures of a run whose target comes to rest; a target that jumps in the first step rests from the beginning.

    Args:
        pendulum: the hanging tool of the machine.

    Raises:
        InputError: a run without tool, or a target that does not rest at the end.
    """
    if not np.isfinite(run.tool).all():
        raise InputError("tool figures", "a run without a tool", "the full path")
    changes = np.flatnonzero(np.any(np.diff(run.target, axis=0) != 0.0, axis=1))
    stop = int(changes[-1]) + 1 if len(changes) else 0
    if stop > len(run.target) - 2:
        raise InputError("tool figures", "a target that moves until the end", "rest after it")
    error = run.tool - (run.target - [0.0, 0.0, pendulum.length])
    moving = error[:stop] if stop else np.full((1, 3), np.nan)
    dt = run.time[1] - run.time[0]
    period = round(pendulum.period / dt)
    arrived = _settled(np.linalg.norm(run.ee - run.target, axis=1), stop, tolerance, period)
    settled = _settled(np.linalg.norm(error, axis=1), stop, tolerance, period)
    sway = np.linalg.norm((run.tool - run.ee)[:, :2], axis=1)
    return ToolFigures(
        rmse=np.sqrt(np.mean(moving**2, axis=0)),
        worst=np.abs(moving).max(axis=0),
        arrival=math.inf if arrived is None else arrived * dt,
        settling=math.inf if settled is None else settled * dt,
        swing=math.nan if arrived is None else float(sway[stop + arrived + period :].max()),
    )


def _settled(distance: Array, stop: int, tolerance: float, least: int) -> int | None:
    """Samples after ``stop`` from which on ``distance`` stays within the tolerance; None if that is fewer than ``least`` + 1
    samples before the end."""
    outside = np.flatnonzero(distance[stop:] > tolerance)
    first = int(outside[-1]) + 1 if len(outside) else 0
    return first if stop + first + least < len(distance) else None
