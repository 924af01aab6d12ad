"""Excitation signal of a motion: duration of each stroke, initial position, commands, and their simulation with the plant."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.gap.experiment.feasible_set import FeasibleSet
from sysid.gap.experiment.motions import MotionPattern, StrokeGroup
from sysid.machine import TabulatedLinkage
from sysid.plant import Model, free_run
from sysid.plant.model import START_WINDOW
from sysid.signals import POINTS, axis_signal, split_signal

Array = npt.NDArray[np.float64]

#: Rest before the first and after the last stroke [s].
BEFORE, AFTER = 1.0, 1.0
#: Number of corrections of strokes with a prescribed end position, by the simulated motion.
CORRECTIONS = 5
#: Largest latency of a drive [s].
MAX_LATENCY = 1.0


@dataclass(frozen=True)
class Segment:
    """Segment of a signal: a stroke whose speed rises from ``begin`` [s] over ``edge``, to zero at ``begin + hold + edge``.

    ``group`` is the index of its stroke group; ``to`` [m or rad] is the prescribed end relative to the start of the motion.
    """

    axis: int
    group: int
    begin: float
    level: float
    edge: float
    hold: float
    to: float | None

    @property
    def end(self) -> float:
        return self.begin + self.hold + self.edge


@dataclass(frozen=True)
class ExcitationSignal:
    """Speed profiles of all axes, and the initial position.

    Args:
        speeds: share of full speed, (n, A).
        start: initial value of each driven signal (A,) [m or rad].
    """

    motion: MotionPattern
    axes: tuple[int, ...]
    rate_hz: float
    speeds: Array
    start: Array

    @property
    def seconds(self) -> float:
        return len(self.speeds) / self.rate_hz


def design_excitation(
    model: Model,
    feasible_sets: Sequence[FeasibleSet],
    motion: MotionPattern,
    axes: tuple[int, ...],
    seconds: float,
    rate_hz: float,
    seed: int,
) -> ExcitationSignal | None:
    """As many strokes as fit into ``seconds``, corrected so that they end at their prescribed positions in ``model``.

    Returns:
        None where the time is too short for one cycle of strokes, or the range too small for the motion.
    """
    segments, pauses = _segments(feasible_sets, motion, axes, seconds, seed)
    if not segments:
        return None
    count = round((_end(segments, pauses) + AFTER) * rate_hz)
    speeds, start = (
        _speeds(segments, len(feasible_sets), count, rate_hz),
        np.array([feasible.home for feasible in feasible_sets]),
    )
    excitation = ExcitationSignal(motion, axes, rate_hz, speeds, start)
    for correction in range(CORRECTIONS + 1):
        displacement = _displacement(model, feasible_sets, excitation)
        place = _start(feasible_sets, displacement)
        if place is None:
            return None
        excitation = replace(excitation, start=place)
        if correction == CORRECTIONS or all(feasible_sets[axis].follows_path for axis in axes):
            break
        segments = _scheduled(_with_corrected_ends(segments, excitation.speeds, displacement, feasible_sets, rate_hz), pauses)
        count = round((_end(segments, pauses) + AFTER) * rate_hz)
        excitation = replace(excitation, speeds=_speeds(segments, len(feasible_sets), count, rate_hz))
    return excitation


def simulate_recording(
    model: Model,
    commands: pd.DataFrame,
    start: Mapping[str, float],
    rate_hz: float,
    measured: frozenset[str] | None = None,
    name: str = "dry-run",
) -> Recording:
    """The recording of the commands on a machine equal to ``model``, without noise.

    A force axis follows its path; its command is the force that ``model`` needs for it.

    Args:
        commands: as in :class:`~sysid.gap.experiment.experiment.Experiment`.
        start: signal → initial value.
        measured: signals of the recording; by default all that the plant predicts.
    """
    inputs = _inputs(commands, start, rate_hz, name)
    run = free_run(model, inputs)
    columns: dict[str, Array] = {s: commands[s].to_numpy() for s in map(str, commands.columns) if not s.endswith(".joint")}
    forced = [axis for axis in model.machine.axes if axis.actuation == "force"]
    for signal in map(str, run.columns[1:]):
        # A point is simulated from the joints of the free run, which does not keep a force axis on its path.
        if not (forced and split_signal(signal)[0] in POINTS):
            columns[signal] = run[signal].to_numpy()
    for axis in forced:
        path = commands[axis_signal(axis.name, "joint")].to_numpy()
        columns[axis.driven] = path
        columns[axis_signal(axis.name, "command")] = _force(model, axis.name, path, rate_hz)
    kept = [s for s in columns if s == "time" or s.endswith(".command") or measured is None or s in measured]
    return replace(inputs, table=pd.DataFrame({signal: columns[signal] for signal in kept}))


def commands_of(model: Model, feasible_sets: Sequence[FeasibleSet], excitation: ExcitationSignal) -> pd.DataFrame:
    """Commands of an experiment file: ``time``, the command of every axis, the path of every force axis."""
    table: dict[str, Array] = {"time": np.arange(len(excitation.speeds)) / excitation.rate_hz}
    for i, feasible in enumerate(feasible_sets):
        table[axis_signal(feasible.axis.name, "command")] = _command(model, feasible, excitation, i)
    for i, feasible in enumerate(feasible_sets):
        if feasible.axis.actuation == "force":
            table[axis_signal(feasible.axis.name, "joint")] = _path(feasible, excitation, i)
    return pd.DataFrame(table)


def start_of(
    feasible_sets: Sequence[FeasibleSet], excitation: ExcitationSignal, linkages: Mapping[str, TabulatedLinkage]
) -> dict[str, float]:
    """Signal → initial value: the driven signals, and the joints of cylinders where a linkage is known."""
    start = {}
    for feasible, value in zip(feasible_sets, excitation.start, strict=True):
        start[feasible.axis.driven] = float(value)
        if feasible.axis.drives == "cylinder" and feasible.axis.name in linkages:
            start[axis_signal(feasible.axis.name, "joint")] = float(linkages[feasible.axis.name].joint(np.array([value]))[0])
    return start


def _segments(
    feasible_sets: Sequence[FeasibleSet], motion: MotionPattern, axes: tuple[int, ...], seconds: float, seed: int
) -> tuple[list[Segment], list[float]]:
    """Segments of all cycles that fit, with their times; the pause after each stroke group."""
    cycles = motion.cycles(axes, np.random.default_rng([seed, *axes]))
    segments: list[Segment] = []
    pauses: list[float] = []
    place = dict.fromkeys(axes, 0.0)
    end = BEFORE
    while True:
        cycle: list[Segment] = []
        groups = next(cycles)
        for number, group in enumerate(groups, start=len(pauses)):
            cycle += _stroke_group(feasible_sets, group, place, number)
        after = [group.pause for group in groups]
        cycle = _scheduled(cycle, after, end)
        end = _end(cycle, after)
        if end + AFTER > seconds:
            return segments, pauses
        segments += cycle
        pauses += after


def _stroke_group(
    feasible_sets: Sequence[FeasibleSet], group: StrokeGroup, place: dict[int, float], number: int
) -> list[Segment]:
    segments = []
    for stroke in group.strokes:
        feasible = feasible_sets[stroke.axis]
        speed = abs(stroke.level) * feasible.max_speed
        sign = np.sign(stroke.level)
        if stroke.to is None:
            hold = min(stroke.seconds - stroke.edge, stroke.reach * feasible.span / speed)
        else:
            way = stroke.to * feasible.span - place[stroke.axis]
            sign, hold = np.sign(way) if way else sign, abs(way) / speed
        edge = max(stroke.edge, speed / feasible.max_acceleration)
        if not np.isfinite(feasible.max_acceleration):  # a valve is limited by its range only
            edge = max(min(edge, hold), 1e-3)
        hold = max(hold, edge)
        place[stroke.axis] += float(sign) * speed * hold
        to = None if stroke.to is None else stroke.to * feasible.span
        segments.append(Segment(stroke.axis, number, 0.0, float(sign) * abs(stroke.level), edge, hold, to))
    return segments


def _scheduled(segments: Sequence[Segment], pauses: Sequence[float], begin: float = BEFORE) -> list[Segment]:
    """The same segments, each stroke group after the longest stroke and the pause of the previous group."""
    timed: list[Segment] = []
    for (_, group), pause in zip(itertools.groupby(segments, key=lambda segment: segment.group), pauses, strict=True):
        part = [replace(segment, begin=begin) for segment in group]
        timed += part
        begin = max(segment.end for segment in part) + pause
    return timed


def _end(segments: Sequence[Segment], pauses: Sequence[float]) -> float:
    """End of the pause after the last stroke group [s]."""
    return max(segment.end for segment in segments if segment.group == segments[-1].group) + pauses[-1]


def _speeds(segments: Sequence[Segment], axes: int, count: int, rate_hz: float) -> Array:
    time = np.arange(count) / rate_hz
    speeds = np.zeros((count, axes))
    for segment in segments:
        first, last = int(segment.begin * rate_hz), int(np.ceil(segment.end * rate_hz)) + 1
        t = time[first:last]
        shape = np.minimum((t - segment.begin) / segment.edge, (segment.end - t) / segment.edge)
        speeds[first:last, segment.axis] += segment.level * np.clip(shape, 0.0, 1.0)
    return np.clip(speeds, -1.0, 1.0)


def _displacement(model: Model, feasible_sets: Sequence[FeasibleSet], excitation: ExcitationSignal) -> Array:
    """Displacement of each driven signal from its initial value, (n, A)."""
    run = pd.DataFrame()
    if not all(feasible.follows_path for feasible in feasible_sets):
        start = {feasible.axis.driven: float(value) for feasible, value in zip(feasible_sets, excitation.start, strict=True)}
        run = free_run(model, _inputs(commands_of(model, feasible_sets, excitation), start, excitation.rate_hz, "displacement"))
    displacement = np.empty(excitation.speeds.shape)
    for i, feasible in enumerate(feasible_sets):
        driven = _path(feasible, excitation, i) if feasible.follows_path else run[feasible.axis.driven].to_numpy()
        displacement[:, i] = driven - driven[0]
    return displacement


def _start(feasible_sets: Sequence[FeasibleSet], displacement: Array) -> Array | None:
    """Initial position nearest to home for which the motion stays in range; None where there is none."""
    start = np.empty(len(feasible_sets))
    for i, feasible in enumerate(feasible_sets):
        low, high = feasible.low - float(displacement[:, i].min()), feasible.high - float(displacement[:, i].max())
        if low > high:
            return None
        start[i] = np.clip(feasible.home, low, high)
    return start


def _latency(speed: Array, displacement: Array, rate_hz: float) -> float:
    """Latency of the motion after the command [s]: lag of the largest cross-correlation of the two speeds."""
    response = np.gradient(displacement)
    lags = np.arange(0, min(round(MAX_LATENCY * rate_hz), len(speed) - 1))
    correlation = [float(speed[: len(speed) - lag] @ response[lag:]) for lag in lags]
    return float(lags[int(np.argmax(correlation))] / rate_hz)


def _with_corrected_ends(
    segments: Sequence[Segment], speeds: Array, displacement: Array, feasible_sets: Sequence[FeasibleSet], rate_hz: float
) -> list[Segment]:
    """Segments of valves with a prescribed end, lengthened or shortened by the error of the simulated end position.

    Each has to reverse the strokes since the previous segment with a prescribed end, but not the error of that segment: all
    segments are corrected at once, and the previous error is corrected there.
    """
    corrected = {}
    for axis in sorted({segment.axis for segment in segments if not feasible_sets[segment.axis].follows_path}):
        own = [(k, segment) for k, segment in enumerate(segments) if segment.axis == axis]
        # With the latency of the drive, the response to a stroke ends when the response to the next one begins.
        latency = _latency(speeds[:, axis], displacement[:, axis], rate_hz)
        ends = [min(segment.end + 0.5, later.begin) for (_, segment), (_, later) in itertools.pairwise(own)] + [
            own[-1][1].end + 0.5
        ]
        places = [float(displacement[min(round((t + latency) * rate_hz), len(displacement) - 1), axis]) for t in ends]
        due, began = 0.0, 0.0
        for (k, segment), ended in zip(own, places, strict=True):
            done = ended - began
            if segment.to is None:
                due += done
            else:
                wanted = segment.to - due
                if abs(done) > 0.1 * abs(wanted) and wanted * done > 0.0:
                    hold = segment.hold * float(np.clip(wanted / done, 0.5, 2.0))
                    corrected[k] = replace(segment, hold=hold, edge=min(segment.edge, hold))
                due = segment.to
            began = ended
    return [corrected.get(k, segment) for k, segment in enumerate(segments)]


def _path(feasible: FeasibleSet, excitation: ExcitationSignal, at: int) -> Array:
    """Path of an axis: the integral of its speed (n,), by the trapezoidal rule."""
    speed = excitation.speeds[:, at] * feasible.max_speed
    steps = 0.5 * (speed[1:] + speed[:-1]) / excitation.rate_hz
    return np.asarray(excitation.start[at] + np.concatenate([[0.0], np.cumsum(steps)]))


def _command(model: Model, feasible: FeasibleSet, excitation: ExcitationSignal, at: int) -> Array:
    if not feasible.follows_path:
        return excitation.speeds[:, at]
    path = _path(feasible, excitation, at)
    return path if feasible.axis.follows_positions else _force(model, feasible.axis.name, path, excitation.rate_hz)


def _force(model: Model, axis: str, path: Array, rate_hz: float) -> Array:
    """Force needed to follow the path, (n,) [N or N·m]."""
    speed = np.gradient(path, 1.0 / rate_hz)
    return model.inverse(model.theta, axis, path, speed, np.gradient(speed, 1.0 / rate_hz), 1.0 / rate_hz)


def _inputs(commands: pd.DataFrame, start: Mapping[str, float], rate_hz: float, name: str) -> Recording:
    """Commands, and the driven signals during the start window, from which a free run starts."""
    first = commands["time"].to_numpy() < START_WINDOW
    begun = {signal: np.where(first, value, np.nan) for signal, value in start.items()}
    return Recording(name, commands.assign(**begun), rate_hz)
