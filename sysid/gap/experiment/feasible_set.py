"""How far and how fast each axis may be moved: the machine's own limits less a margin, and what recordings show of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.experiment.experiment import Limits
from sysid.machine import Axis
from sysid.plant import Plant
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Speed that a servo is asked for whose recordings hardly moved it [share of its room a second].
CRAWL = 0.02


@dataclass(frozen=True)
class Room:
    """What one axis may do.

    Args:
        low, high: of what the command drives [m or rad], margin taken off.
        home: where recordings are most, inside the two.
        top: speed of what is driven at full level [m/s or rad/s].
        rise: largest acceleration, as recordings show it [m/s² or rad/s²]; infinite where it does not limit (valves, servos).
        command: lowest and highest command.
    """

    axis: Axis
    low: float
    high: float
    home: float
    top: float
    rise: float
    command: tuple[float, float]

    @property
    def span(self) -> float:
        return self.high - self.low

    @property
    def follows(self) -> bool:
        """Whether what is prescribed is a path (servo, force under a position controller), not a speed (valve)."""
        return self.axis.actuation != "velocity"


def room_of(plant: Plant, axis: Axis, recordings: Sequence[Recording], margin: float) -> Room | None:
    """The room of one axis; None where nothing is known of where it may go.

    Args:
        margin: share of the range that is kept free at either end.
    """
    visited = _values(recordings, axis.driven)
    if axis.actuation == "position" and not len(visited):
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
    top, rise = _pace(axis, recordings)
    if axis.actuation == "position":
        top = max(top, CRAWL * (high - low))
    return Room(axis, low, high, home, top, rise, _command_limits(axis, recordings, low, high))


def limits_of(plant: Plant, rooms: Sequence[Room], margin: float) -> Limits:
    """Signal → (lowest, highest) for the commands, what they drive, and the joints behind it."""
    limits: dict[str, tuple[float, float]] = {}
    for room in rooms:
        axis = room.axis
        limits[axis_signal(axis.name, "command")] = room.command
        limits[axis.driven] = (room.low, room.high)
        if axis.drives == "cylinder" and axis.name in plant.linkages and axis.limits is not None:
            slack = margin * (axis.limits[1] - axis.limits[0])
            limits[axis_signal(axis.name, "joint")] = (axis.limits[0] + slack, axis.limits[1] - slack)
    return limits


def _values(recordings: Sequence[Recording], signal: str) -> Array:
    parts = [recording.values(signal) for recording in recordings]
    values = np.concatenate(parts) if parts else np.empty(0)
    return values[~np.isnan(values)]


def _within_joint_limits(plant: Plant, axis: Axis, low: float, high: float, margin: float) -> tuple[float, float]:
    """The part of the cylinder's room in which the joint keeps to its limits."""
    assert axis.limits is not None
    slack = margin * (axis.limits[1] - axis.limits[0])
    grid = np.linspace(low, high, 512)
    joints = plant.linkages[axis.name].joint(grid)
    inside = grid[(joints >= axis.limits[0] + slack) & (joints <= axis.limits[1] - slack)]
    return (float(inside.min()), float(inside.max())) if len(inside) else (low, low)


def _pace(axis: Axis, recordings: Sequence[Recording]) -> tuple[float, float]:
    """(top speed, acceleration): of a valve as described, else what recordings keep below 99 % of the time, over 50 ms."""
    if axis.actuation == "velocity":
        return axis.gain, np.inf
    speeds, rises = [np.zeros(1)], [np.zeros(1)]
    for recording in recordings:
        values = recording.values(axis.driven)
        if np.isnan(values).all():
            values = recording.values(axis_signal(axis.name, "command"))
        there = np.flatnonzero(~np.isnan(values))
        width = max(1, round(0.05 * recording.rate_hz))
        if len(there) > 4 * width:
            filled = np.interp(np.arange(len(values)), there, values[there])
            speed = (filled[width:] - filled[:-width]) * recording.rate_hz / width
            speeds.append(np.abs(speed))
            rises.append(np.abs(speed[width:] - speed[:-width]) * recording.rate_hz / width)
    top, rise = (float(np.percentile(np.concatenate(part), 99)) for part in (speeds, rises))
    if axis.actuation == "position":
        return max(top, 1e-9), np.inf
    # Friction is greatest where the axis is fastest, inertia where it turns: a trapezoid has both at once.
    return max(0.8 * top, 1e-9), max(0.5 * rise, 1e-9)


def _command_limits(axis: Axis, recordings: Sequence[Recording], low: float, high: float) -> tuple[float, float]:
    """A valve takes −1 … 1, a servo its room, a force what was recorded."""
    if axis.actuation == "velocity":
        return -1.0, 1.0
    if axis.actuation == "position":
        return low, high
    forces = np.abs(_values(recordings, axis_signal(axis.name, "command")))
    largest = float(forces.max()) if len(forces) else 0.0
    return -largest, largest
