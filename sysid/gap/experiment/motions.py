"""The feasible set of each axis, and the motions that are tested within it.

A motion is an endless sequence of strokes, of which an experiment uses as many as its time allows. Motions are those of
:class:`sysid.effects.Need` and of robot identification (Swevers, Ganseman, Tükel, De Schutter, Van Brussel, IEEE Trans.
Robotics and Automation 13 (1997): exciting trajectories are chosen from a family that keeps to the limits by construction):
here trapezoidal speed profiles that return to the initial position.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
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
#: Time in which a sharp stroke reaches its speed [s].
SHARP = 0.02


# -- feasible set ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class FeasibleSet:
    """Feasible motion and commands of one axis, from the limits of the machine and from recordings.

    Args:
        low, high: range of the driven signal [m or rad], less the margin.
        home: median position of the recordings, within the range.
        max_speed: speed of the driven signal at full level [m/s or rad/s].
        max_acceleration: from the recordings [m/s² or rad/s²]; infinite where it is no limit (valves, servos).
        command: lowest and highest command: −1 … 1 of a valve, the range of a servo, the largest recorded force.
        joint: range of the joint that a cylinder moves [rad], less the margin; None where it is not known.
    """

    axis: Axis
    low: float
    high: float
    home: float
    max_speed: float
    max_acceleration: float
    command: tuple[float, float]
    joint: tuple[float, float] | None

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
    low, high = _less_margin(low, high, margin)
    joint = None
    if axis.drives == "cylinder" and axis.name in plant.linkages and axis.limits is not None:
        joint = _less_margin(*axis.limits, margin)
        strokes = np.linspace(low, high, 512)
        angles = plant.linkages[axis.name].joint(strokes)
        inside = strokes[(angles >= joint[0]) & (angles <= joint[1])]
        if not len(inside):
            return None
        low, high = float(inside.min()), float(inside.max())
    if not low < high:
        return None
    home = float(np.clip(np.median(visited), low, high)) if len(visited) else 0.5 * (low + high)
    if axis.actuation == "velocity":
        return FeasibleSet(axis, low, high, home, axis.gain, np.inf, (-1.0, 1.0), joint)
    speed, acceleration = _usual_motion(axis, recordings)
    if axis.follows_positions:
        max_speed = max(speed, 1e-9, MIN_SERVO_SPEED * (high - low))
        return FeasibleSet(axis, low, high, home, max_speed, np.inf, (low, high), joint)
    largest = float(np.max(np.abs(_values(recordings, axis_signal(axis.name, "command"))), initial=0.0))
    # The friction force is largest at the highest speed, the inertial force at a reversal; a trapezoid contains both.
    max_speed, max_acceleration = max(0.8 * speed, 1e-9), max(0.5 * acceleration, 1e-9)
    return FeasibleSet(axis, low, high, home, max_speed, max_acceleration, (-largest, largest), joint)


def limits_of(feasible_sets: Sequence[FeasibleSet]) -> Limits:
    """Signal → (lowest, highest) for the commands, the driven signals and the joints."""
    limits: dict[str, tuple[float, float]] = {}
    for feasible in feasible_sets:
        axis = feasible.axis
        limits[axis_signal(axis.name, "command")] = feasible.command
        limits[axis.driven] = (feasible.low, feasible.high)
        if feasible.joint is not None:
            limits[axis_signal(axis.name, "joint")] = feasible.joint
    return limits


def _values(recordings: Sequence[Recording], signal: str) -> Array:
    values: Array = np.concatenate([np.empty(0), *(recording.values(signal) for recording in recordings)])
    return values[~np.isnan(values)]


def _less_margin(low: float, high: float, margin: float) -> tuple[float, float]:
    slack = margin * (high - low)
    return low + slack, high - slack


def _usual_motion(axis: Axis, recordings: Sequence[Recording]) -> tuple[float, float]:
    """(speed, acceleration) of the driven signal, else of the command: 99th percentiles in the recordings, over 50 ms."""
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
    return float(np.percentile(np.concatenate(speeds), 99)), float(np.percentile(np.concatenate(rises), 99))


# -- motions --------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Stroke:
    """A trapezoid of speed of one axis.

    Args:
        axis: index of the axis.
        level: speed as a share of full speed, signed.
        seconds: longest duration, both edges included; shorter where the stroke would exceed ``reach``.
        edge: rise and fall time [s].
        reach: longest displacement as a share of the range of the axis.
        to: prescribed end, as a share of the range from the start of the motion; None: no prescribed end.
    """

    axis: int
    level: float
    seconds: float
    edge: float
    reach: float
    to: float | None = None


@dataclass(frozen=True)
class StrokeGroup:
    """Strokes that begin simultaneously, and the pause after the longest of them [s]."""

    strokes: tuple[Stroke, ...]
    pause: float


#: (moving axes, random generator) → endless sequence of cycles of stroke groups; a cycle returns to the initial position.
Cycles = Callable[[Sequence[int], np.random.Generator], Iterator[tuple[StrokeGroup, ...]]]
#: (number of the pair, random generator) → level, seconds and edge of the strokes of a pair.
Shape = Callable[[int, np.random.Generator], tuple[float, float, float]]


@dataclass(frozen=True)
class MotionPattern:
    """One kind of motion; ``several``: moves all axes, else one axis at a time."""

    name: str
    about: str
    cycles: Cycles
    several: bool = False


def _there_and_back(shape: Shape, reach: float, pause: float = 0.0) -> Cycles:
    """Pairs of strokes out and back."""

    def cycles(axes: Sequence[int], rng: np.random.Generator) -> Iterator[tuple[StrokeGroup, ...]]:
        for k in itertools.count():
            for axis in axes:
                level, seconds, edge = shape(k, rng)
                out = Stroke(axis, level, seconds, edge, reach)
                back = Stroke(axis, -level, seconds, edge, reach, 0.0)
                yield StrokeGroup((out,), pause), StrokeGroup((back,), pause)

    return cycles


def _levels(*levels: float, seconds: float, edge: float, reach: float, pause: float = 0.0) -> Cycles:
    """Pairs of strokes at each level in turn, in one direction and then in the other."""

    def shape(k: int, rng: np.random.Generator) -> tuple[float, float, float]:
        turn, at = divmod(k, len(levels))
        return levels[at] if turn % 2 == 0 else -levels[at], seconds, edge

    return _there_and_back(shape, reach, pause)


def _sweep(k: int, rng: np.random.Generator) -> tuple[float, float, float]:
    """Half waves of increasing frequency from 0.3 to 4 Hz, over twelve pairs."""
    half = 0.5 / (0.3 * (4.0 / 0.3) ** ((k % 12) / 11.0))
    return 0.6, half, 0.5 * half


def _tap(k: int, rng: np.random.Generator) -> tuple[float, float, float]:
    return float(rng.choice([-1.0, 1.0]) * rng.uniform(0.35, 0.9)), float(rng.uniform(0.1, 0.5)), SHARP


def _together(axes: Sequence[int], rng: np.random.Generator) -> Iterator[tuple[StrokeGroup, ...]]:
    """Each axis alone, then all at once, at full speed."""
    while True:
        for moving in (*((axis,) for axis in axes), tuple(axes)):
            levels = rng.choice([-1.0, 1.0], len(moving)) * rng.uniform(0.7, 1.0, len(moving))
            pairs = list(zip(moving, map(float, levels), strict=True))
            out = tuple(Stroke(axis, level, 2.0, 0.1, 0.3) for axis, level in pairs)
            back = tuple(Stroke(axis, -level, 2.0, 0.1, 0.3, 0.0) for axis, level in pairs)
            yield StrokeGroup(out, 0.4), StrokeGroup(back, 0.4)


def _poses(axes: Sequence[int], rng: np.random.Generator) -> Iterator[tuple[StrokeGroup, ...]]:
    """Random poses over nine tenths of the range, all axes moving at once, with 1 s at rest at each."""
    place = dict.fromkeys(axes, 0.0)
    while True:
        strokes = []
        for axis in axes:
            to = float(rng.uniform(-0.45, 0.45))
            way = to - place[axis]
            strokes.append(Stroke(axis, 0.7 if way > 0.0 else -0.7, 60.0, 0.2, abs(way), to))
            place[axis] = to
        yield (StrokeGroup(tuple(strokes), 1.2),)


#: Motions that are tested, described as instructions for an operator.
MOTIONS: tuple[MotionPattern, ...] = (
    MotionPattern("reversals", "slow reversals of {axes}", _levels(0.25, 0.4, 0.6, seconds=1.2, edge=0.3, reach=0.12)),
    MotionPattern(
        "stairs",
        "pulses of {axes} that rise from 3 to 42 %, both ways",
        _levels(*(0.03 * n for n in range(1, 15)), seconds=0.6, edge=SHARP, reach=0.12, pause=0.2),
    ),
    MotionPattern(
        "steps",
        "sharp starts and stops of {axes} at 30, 60 and 100 %, both ways",
        _levels(0.3, 0.6, 1.0, seconds=1.0, edge=SHARP, reach=0.25, pause=0.5),
    ),
    MotionPattern("taps", "short sharp taps of {axes} at random", _there_and_back(_tap, reach=0.2, pause=0.15)),
    MotionPattern(
        "ramps",
        "slow ramps of {axes} through zero, up to 30, 60 and 100 %",
        _levels(0.3, 0.6, 1.0, seconds=3.0, edge=1.5, reach=0.3),
    ),
    MotionPattern(
        "creeping",
        "{axes} creeping at 1 to 15 %, both ways",
        _levels(0.02, 0.08, 0.01, 0.15, 0.04, seconds=4.0, edge=0.4, reach=0.15, pause=0.2),
    ),
    MotionPattern("sweep", "{axes} to and fro with increasing frequency, 0.3 to 4 Hz", _there_and_back(_sweep, reach=0.2)),
    MotionPattern(
        "strokes",
        "{axes} over most of the range at 50, 80 and 100 %",
        _levels(0.5, 0.8, 1.0, seconds=60.0, edge=0.1, reach=0.8, pause=0.4),
    ),
    MotionPattern(
        "rest",
        "{axes} driven out and left at rest for 12 s, repeatedly",
        _levels(0.6, seconds=60.0, edge=0.2, reach=0.4, pause=12.0),
    ),
    MotionPattern(
        "swing",
        "{axes} moved briskly, stopped, and left at rest for 5 s",
        _levels(1.0, 0.7, seconds=0.8, edge=SHARP, reach=0.25, pause=5.0),
    ),
    MotionPattern("together", "{axes} at large commands, each alone and all at once", _together, several=True),
    MotionPattern("poses", "random poses of {axes}, 1 s at rest at each", _poses, several=True),
)
