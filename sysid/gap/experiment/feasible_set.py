"""Feasible set of each axis: range, speed and acceleration, from the machine's limits less a margin and from recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.experiment.experiment import Limits
from sysid.gap.likelihood.discrepancy.shapes import filled
from sysid.machine import Axis
from sysid.plant import Plant
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Least speed used for a servo that hardly moved in the recordings [share of its range per second].
MIN_SERVO_SPEED = 0.02


@dataclass(frozen=True)
class FeasibleSet:
    """Feasible motion and commands of one axis.

    Args:
        low, high: range of the driven signal [m or rad], less the margin.
        home: median position of the recordings, within the range.
        max_speed: speed of the driven signal at full level [m/s or rad/s].
        max_acceleration: from the recordings [m/s² or rad/s²]; infinite where it is no limit (valves, servos).
        command: lowest and highest command.
    """

    axis: Axis
    low: float
    high: float
    home: float
    max_speed: float
    max_acceleration: float
    command: tuple[float, float]

    @property
    def span(self) -> float:
        return self.high - self.low

    @property
    def follows_path(self) -> bool:
        """Whether a path is prescribed (servo, force axis with a position controller) rather than a speed (valve)."""
        return self.axis.actuation != "velocity"


def feasible_set_of(plant: Plant, axis: Axis, recordings: Sequence[Recording], margin: float) -> FeasibleSet | None:
    """The feasible set of one axis; None where its range is unknown.

    Args:
        margin: share of the range that is kept free at either end.
    """
    visited = _values(recordings, axis.driven)
    if axis.follows_positions and not len(visited):
        visited = _values(recordings, axis_signal(axis.name, "command"))
    low, high = axis.range
    if not np.isfinite([low, high]).all():
        if not len(visited):
            return None
        low, high = max(low, float(visited.min())), min(high, float(visited.max()))
    low, high = low + margin * (high - low), high - margin * (high - low)
    if axis.drives == "cylinder" and axis.name in plant.linkages and axis.limits is not None:
        low, high = _within_joint_limits(plant, axis, low, high, margin)
    if not low < high:
        return None
    home = float(np.clip(np.median(visited), low, high)) if len(visited) else 0.5 * (low + high)
    max_speed, max_acceleration = _speed_limits(axis, recordings)
    if axis.follows_positions:
        max_speed = max(max_speed, MIN_SERVO_SPEED * (high - low))
    return FeasibleSet(axis, low, high, home, max_speed, max_acceleration, _command_limits(axis, recordings, low, high))


def limits_of(plant: Plant, feasible_sets: Sequence[FeasibleSet], margin: float) -> Limits:
    """Signal → (lowest, highest) for the commands, the driven signals and the joints."""
    limits: dict[str, tuple[float, float]] = {}
    for feasible in feasible_sets:
        axis = feasible.axis
        limits[axis_signal(axis.name, "command")] = feasible.command
        limits[axis.driven] = (feasible.low, feasible.high)
        if axis.drives == "cylinder" and axis.name in plant.linkages and axis.limits is not None:
            slack = margin * (axis.limits[1] - axis.limits[0])
            limits[axis_signal(axis.name, "joint")] = (axis.limits[0] + slack, axis.limits[1] - slack)
    return limits


def _values(recordings: Sequence[Recording], signal: str) -> Array:
    parts = [recording.values(signal) for recording in recordings]
    values = np.concatenate(parts) if parts else np.empty(0)
    return values[~np.isnan(values)]


def _within_joint_limits(plant: Plant, axis: Axis, low: float, high: float, margin: float) -> tuple[float, float]:
    """The part of the cylinder range in which the joint stays within its limits."""
    assert axis.limits is not None
    slack = margin * (axis.limits[1] - axis.limits[0])
    grid = np.linspace(low, high, 512)
    joints = plant.linkages[axis.name].joint(grid)
    inside = grid[(joints >= axis.limits[0] + slack) & (joints <= axis.limits[1] - slack)]
    return (float(inside.min()), float(inside.max())) if len(inside) else (low, low)


def _speed_limits(axis: Axis, recordings: Sequence[Recording]) -> tuple[float, float]:
    """(speed, acceleration): of a valve from its description, else the 99th percentile in the recordings, over 50 ms."""
    if axis.actuation == "velocity":
        return axis.gain, np.inf
    speeds, rises = [np.zeros(1)], [np.zeros(1)]
    for recording in recordings:
        values = recording.values(axis.driven)
        if np.isnan(values).all():
            values = recording.values(axis_signal(axis.name, "command"))
        width = max(1, round(0.05 * recording.rate_hz))
        if int((~np.isnan(values)).sum()) > 4 * width:
            path = filled(values)
            speed = (path[width:] - path[:-width]) * recording.rate_hz / width
            speeds.append(np.abs(speed))
            rises.append(np.abs(speed[width:] - speed[:-width]) * recording.rate_hz / width)
    max_speed, max_acceleration = (float(np.percentile(np.concatenate(part), 99)) for part in (speeds, rises))
    if axis.follows_positions:
        return max(max_speed, 1e-9), np.inf
    # The friction force is largest at the highest speed, the inertial force at a reversal; a trapezoid contains both.
    return max(0.8 * max_speed, 1e-9), max(0.5 * max_acceleration, 1e-9)


def _command_limits(axis: Axis, recordings: Sequence[Recording], low: float, high: float) -> tuple[float, float]:
    """Valve: −1 … 1; servo: its range; force axis: the largest recorded force."""
    if axis.actuation == "velocity":
        return -1.0, 1.0
    if axis.follows_positions:
        return low, high
    forces = np.abs(_values(recordings, axis_signal(axis.name, "command")))
    largest = float(forces.max()) if len(forces) else 0.0
    return -largest, largest
