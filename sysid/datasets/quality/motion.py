"""Motion of every axis in a recording or in a part of it: time in each direction, reversals, small and large commands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.datasets.chunked import Array, copied, known, strided
from sysid.datasets.quality.noise import noise_of
from sysid.datasets.quality.use import (
    IDLE,
    SLOPE_S,
    SLOW,
    SMALL,
    SPEED_NOISE,
    TURN,
    TURN_NOISE,
    moved_signal,
    speed_of,
    turning_rows,
)
from sysid.datasets.recording import Recording
from sysid.machine import Axis, Machine
from sysid.signals import axis_signal

#: Samples per second that are counted: speeds are slopes over 0.2 s. Counted samples of a cell, the resolution of parts.
COUNTED_HZ, CELL = 20.0, 5
#: An axis moves in a recording if it covers this share of the range that it covers in all of them, and this multiple of its
#: noise (as in :mod:`sysid.gap.excitation`).
MOVED_SHARE, MOVED_NOISE = TURN, 20.0
#: Share of the top speed above which motion counts whatever the noise.
CERTAIN_SPEED = 0.4
#: Recordings, and samples of each, from which the noise of an axis is estimated.
_NOISE_RECORDINGS, _NOISE_SAMPLES = 20, 10_000


@dataclass(frozen=True)
class AxisMotion:
    """Motion of one axis in some recordings: seconds of motion in either direction, reversals, and seconds of small and of
    large commands (of slow and fast motion, where the command is not a speed) in either direction.
    """

    forward_s: float = 0.0
    backward_s: float = 0.0
    reversals: float = 0.0
    small_forward_s: float = 0.0
    small_backward_s: float = 0.0
    large_forward_s: float = 0.0
    large_backward_s: float = 0.0


#: The same as columns of amounts.
FEATURES = tuple(AxisMotion.__dataclass_fields__)


def by_axis(amounts: Array, axes: Sequence[str]) -> dict[str, AxisMotion]:
    """Axis → the amounts (axes, features) by their names."""
    return {axis: AxisMotion(*map(float, row)) for axis, row in zip(axes, amounts, strict=True)}


@dataclass(frozen=True)
class RecordingMotion:
    """Motion of the axes in one recording, for any part of it.

    Args:
        seconds: its length.
        rows: of the recording in a cell of counts.
        sums: amounts before each cell, (cells + 1, axes, features).
    """

    seconds: float
    rows: int
    sums: Array

    def amounts(self, first: int = 0, last: int | None = None) -> Array:
        """Amounts in rows ``first`` … ``last`` of the recording, to a cell, (axes, features)."""
        end = len(self.sums) - 1
        begin = min(round(first / self.rows), end)
        stop = end if last is None else min(max(round(last / self.rows), begin), end)
        return np.asarray(self.sums[stop] - self.sums[begin])


@dataclass(frozen=True)
class MotionTable:
    """Motion of the axes that are commanded and measured.

    Args:
        axes: their names.
        recordings: name → its motion.
    """

    axes: tuple[str, ...]
    recordings: dict[str, RecordingMotion]

    def of(self, names: Sequence[str]) -> Array:
        """Amounts in several recordings together, (axes, features)."""
        total = np.zeros((len(self.axes), len(FEATURES)))
        for name in names:
            total += self.recordings[name].amounts()
        return total


def motion_table(recordings: Sequence[Recording], machine: Machine) -> MotionTable:
    """Motion of every axis of ``machine`` whose command and motion some of the recordings contain.

    Thresholds are those of the axis over all recordings, so that noise in a recording in which it rests is not motion.
    """
    moving = [recording for recording in recordings if recording.kind == "motion"]
    samples = {axis.name: [_samples(recording, axis) for recording in moving] for axis in machine.axes}
    scales = {axis.name: _scale_of(axis, moving, samples[axis.name], machine) for axis in machine.axes}
    axes = tuple(name for name, scale in scales.items() if scale is not None)
    found = {}
    for number, recording in enumerate(moving):
        stride = _stride(recording.rate_hz)
        cells = -(-len(recording) // (stride * CELL))
        amounts = np.zeros((cells + 1, len(axes), len(FEATURES)))
        for place, name in enumerate(axes):
            scale = scales[name]
            assert scale is not None
            amounts[1:, place] = scale.counted(samples[name][number], stride / recording.rate_hz, cells)
        found[recording.name] = RecordingMotion(len(recording) / recording.rate_hz, stride * CELL, np.cumsum(amounts, axis=0))
    return MotionTable(axes, found)


@dataclass(frozen=True)
class _Samples:
    """Counted samples of an axis in one recording: command, position and speed, (n,) each."""

    command: Array
    position: Array
    speed: Array


@dataclass(frozen=True)
class _Scale:
    """Thresholds of an axis.

    Args:
        valve, led: whether its command is a speed, or a position; ``idle``: speeds up to this size are no command.
        top_speed: 99th percentile of the speed; ``least_speed``: below it nothing moves.
        least_travel: travel from which the axis moves in a recording; ``least_setpoint``: the same for the command of a servo,
            which is a position: what moves without it is pushed by other axes.
        noise: standard deviation of its sensor.
    """

    valve: bool
    led: bool
    idle: float
    top_speed: float
    least_speed: float
    least_travel: float
    least_setpoint: float
    noise: float

    def counted(self, samples: _Samples, dt: float, cells: int) -> Array:
        """Amounts in each cell, (cells, features).

        Args:
            dt: time of a counted sample [s].
        """
        amounts = np.zeros((cells, len(FEATURES)))
        measured = ~np.isnan(samples.command) & ~np.isnan(samples.position)
        travel, given = travel_of(samples.position), travel_of(samples.command)
        commanded = not self.led or (given >= self.least_setpoint and given > 0.0)
        if travel < self.least_travel or travel == 0.0 or not commanded or not measured.any():
            return amounts
        speed, command = np.nan_to_num(samples.speed), np.nan_to_num(samples.command)
        active = measured & (np.abs(command) > self.idle) if self.valve else measured  # zero is a place, and a force
        sizes = command if self.valve else speed / self.top_speed
        smallest = max(self.idle, SMALL[0]) if self.valve else self.least_speed / self.top_speed
        starts = np.arange(0, len(command), CELL)
        for way, sign in enumerate((1.0, -1.0)):
            moves = active & (sign * speed > self.least_speed)
            small = active & (sign * sizes > smallest) & (sign * sizes < SMALL[1])
            large = active & (sign * sizes >= SMALL[1])
            for column, rows in zip((way, 3 + way, 5 + way), (moves, small, large), strict=True):
                amounts[:, column] = np.add.reduceat(rows, starts, dtype=np.float64) * dt
        there = np.flatnonzero(~np.isnan(samples.position))
        turned = there[turning_rows(samples.position[there], max(TURN * travel, TURN_NOISE * self.noise))]
        amounts[:, 2] = np.bincount(turned // CELL, minlength=cells)
        return amounts


def _scale_of(axis: Axis, recordings: Sequence[Recording], samples: Sequence[_Samples], machine: Machine) -> _Scale | None:
    """None where command and motion of the axis are nowhere measured together."""
    together = [s for s in samples if (~np.isnan(s.command) & ~np.isnan(s.position)).any()]
    if not together:
        return None
    sizes = np.concatenate([np.abs(known(s.command)) for s in together])
    given = sizes[sizes > 0.0]
    idle = IDLE * float(np.percentile(given, 95.0)) if len(given) else np.inf
    speeds = np.concatenate([np.abs(known(s.speed)) for s in together])
    top = float(np.quantile(speeds, 0.99)) if len(speeds) else 0.0
    span, setpoints = (
        travel_of(np.concatenate(values)) for values in zip(*((s.position, s.command) for s in together), strict=True)
    )
    noise = _noise(axis, recordings, machine)
    least = max(SLOW[0] * top, min(SPEED_NOISE * float(np.sqrt(2.0)) * noise / SLOPE_S, CERTAIN_SPEED * top))
    travels = max(MOVED_SHARE * span, MOVED_NOISE * noise), MOVED_SHARE * setpoints
    valve, led = axis.actuation == "velocity", axis.follows_positions
    return _Scale(valve, led, idle, top if top > 0.0 else 1.0, least, *travels, noise)


def travel_of(values: Array) -> float:
    """Between the lowest and the highest value of a signal (n,)."""
    inside = known(values)
    return float(np.ptp(inside)) if len(inside) else 0.0


def _noise(axis: Axis, recordings: Sequence[Recording], machine: Machine) -> float:
    """Of the data sheet, else the median of what some of the recordings show; zero where it is unknown."""
    for signal in (axis_signal(axis.name, "joint"), axis.driven):
        if signal in machine.noise:
            return machine.noise[signal]
    step = max(1, len(recordings) // _NOISE_RECORDINGS)
    levels = []
    for recording in recordings[::step]:
        values = recording.values(moved_signal(recording, axis, _stride(recording.rate_hz)))
        begin = max(0, (len(values) - _NOISE_SAMPLES) // 2)
        level = noise_of(copied(values[begin : begin + _NOISE_SAMPLES]), recording.rate_hz)
        if np.isfinite(level):
            levels.append(level)
    return float(np.median(levels)) if levels else 0.0


def _samples(recording: Recording, axis: Axis) -> _Samples:
    stride = _stride(recording.rate_hz)
    position = strided(recording.values(moved_signal(recording, axis, stride)), stride)
    command = strided(recording.values(axis_signal(axis.name, "command")), stride)
    return _Samples(command, position, speed_of(position, recording.rate_hz / stride))


def _stride(rate_hz: float) -> int:
    return max(1, round(rate_hz / COUNTED_HZ))
