"""Error of a position axis at rest: sag under load and a bias of its sensor are alike where the load is not known.

At the end of each hold of the setpoint the error measured − predicted hardly depends on dead time and lag:

    e_j = s·d_j + c + Σ_k a_k·φ_k(q_j) + noise,

where the prediction has no bias, scale error or compliance, with the direction d_j = ±1 from which the hold was reached (dry
friction and backlash leave an error of this sign), and functions φ of the posture. The error is significant where the constant
and the functions of posture together reduce the squares (F-test; Draper and Smith, Applied Regression Analysis, 1998, §6.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy import stats

from sysid.datasets.recording import Recording
from sysid.gap.problem import Problem
from sysid.machine import Machine
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: The setpoint is held at least this long [s], and the error is the mean over the end of the hold [s].
HOLD, END = 0.5, 0.1
#: A setpoint that changes by less than this share of its range is held.
STILL = 1e-3
#: Least number of holds for each coefficient.
HOLDS_PER_COEFFICIENT = 3
#: Level of the F-tests.
LEVEL = 0.01
#: An error at rest matters from this multiple of the sensor noise (root mean square over the holds).
OVER_NOISE = 2.0


@dataclass(frozen=True)
class StaticError:
    """Error of a position axis at rest.

    Args:
        rms: of its part without the direction of approach, over the holds [rad or m].
        by_posture: whether it depends on the posture, significantly.
        holds: number of holds.
    """

    rms: float
    by_posture: bool
    holds: int


def static_error(
    problem: Problem, machine: Machine, theta: Array, recordings: Sequence[Recording], noise: float
) -> StaticError | None:
    """The error at rest of a position axis that is significant and larger than the noise; None otherwise.

    Args:
        problem: its command stage.
        theta: parameters without a static error, (N,).
        noise: standard deviation of the sensor [rad or m].
    """
    found = [_holds(problem, machine, theta, recording) for recording in recordings]
    error, direction, posture = (np.concatenate(parts) for parts in zip(*found, strict=True)) if found else (np.empty(0),) * 3
    count = len(error)
    if count < 2 * HOLDS_PER_COEFFICIENT:
        return None
    friction = direction[:, None] if np.ptp(direction) > 0.0 else np.empty((count, 0))
    constant = np.column_stack([friction, np.ones(count)])
    functions = _functions(posture)
    whole = constant
    if count >= HOLDS_PER_COEFFICIENT * (constant.shape[1] + functions.shape[1]):
        whole = np.column_stack([constant, functions])
    if min(_probability(error, friction, whole), _probability(error, friction, constant)) > LEVEL:
        return None
    weights = np.linalg.lstsq(whole, error, rcond=None)[0]
    rms = float(np.sqrt(np.mean((whole[:, friction.shape[1] :] @ weights[friction.shape[1] :]) ** 2)))
    if rms < OVER_NOISE * noise:
        return None
    return StaticError(rms, whole is not constant and _probability(error, constant, whole) < LEVEL, count)


def _holds(problem: Problem, machine: Machine, theta: Array, recording: Recording) -> tuple[Array, Array, Array]:
    """Error at the end of each hold (m,), direction from which it was reached (m,), and posture (m, A), of one recording."""
    command = recording.values(axis_signal(problem.target, "command"))
    left = (problem.measured(recording) - problem.predict(theta[None], recording)[0])[:, 0]
    joints = np.column_stack([recording.values(axis_signal(name, "joint")) for name in machine.axis_names])
    span = float(np.nanmax(command) - np.nanmin(command)) if np.isfinite(command).any() else 0.0
    moved = np.flatnonzero(~(np.abs(np.diff(command)) <= STILL * span)) + 1  # a missing setpoint ends a hold as well
    least, end = round(HOLD * recording.rate_hz), max(1, round(END * recording.rate_hz))
    errors, directions, postures = [], [], []
    for first, last in pairwise([*moved, len(command)]):
        if last - first < least or np.isnan(command[first - 1 : last]).any():
            continue
        error = left[last - end : last]
        posture = joints[last - end : last]
        if np.isnan(error).any():
            continue
        errors.append(float(error.mean()))
        directions.append(float(np.sign(command[first] - command[first - 1])))
        postures.append(np.nan_to_num(posture).mean(axis=0))
    return np.array(errors), np.array(directions), np.reshape(postures, (len(errors), len(machine.axes)))


def _functions(posture: Array) -> Array:
    """Functions of the posture (m, A): linear and quadratic in each joint that moves, centred and scaled."""
    span = np.ptp(posture, axis=0)
    there = posture[:, span > 0.0]
    scaled = (there - there.mean(axis=0)) / np.where(span > 0.0, span, 1.0)[span > 0.0]
    return np.column_stack([scaled, scaled**2])


def _probability(error: Array, less: Array, more: Array) -> float:
    """Probability of such a fall of the squares if the further columns of ``more`` had no influence (F-test)."""
    squares = [float(np.sum((error - table @ np.linalg.lstsq(table, error, rcond=None)[0]) ** 2)) for table in (less, more)]
    rank = [int(np.linalg.matrix_rank(table)) if table.shape[1] else 0 for table in (less, more)]
    further, free = rank[1] - rank[0], len(error) - rank[1]
    if further <= 0 or free <= 0:
        return 1.0
    if squares[1] <= 0.0:
        return 0.0 if squares[0] > 0.0 else 1.0
    return float(stats.f.sf((squares[0] - squares[1]) / further / (squares[1] / free), further, free))
