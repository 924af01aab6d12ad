"""Excitation signal of a motion: duration of each stroke, initial position, commands, and their simulation with the plant."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.gap.experiment.motions import FeasibleSet, MotionPattern, StrokeGroup
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
class ExcitationSignal:
    """Speed profiles of all axes, and the initial position.

    Args:
        axes: indices of the axes that move.
        feasible_sets: of all axes.
        speeds: share of full speed, (n, A).
        start: initial value of each driven signal (A,) [m or rad].
    """

    motion: MotionPattern
    axes: tuple[int, ...]
    rate_hz: float
    feasible_sets: Sequence[FeasibleSet]
    speeds: Array
    start: Array

    @property
    def seconds(self) -> float:
        return len(self.speeds) / self.rate_hz

    def path(self, at: int) -> Array:
        """Path of the axis with index ``at``: the integral of its speed (n,) [m or rad], by the trapezoidal rule."""
        speed = self.speeds[:, at] * self.feasible_sets[at].max_speed
        steps = 0.5 * (speed[1:] + speed[:-1]) / self.rate_hz
        return np.asarray(self.start[at] + np.concatenate([[0.0], np.cumsum(steps)]))

    def commands(self, model: Model) -> pd.DataFrame:
        """Commands of an experiment file: ``time``, the command of every axis, the path of every force axis."""
        table: dict[str, Array] = {"time": np.arange(len(self.speeds)) / self.rate_hz}
        paths: dict[str, Array] = {}
        for i, feasible in enumerate(self.feasible_sets):
            axis = feasible.axis
            command = self.path(i) if feasible.follows_path else self.speeds[:, i]
            if axis.actuation == "force":
                paths[axis_signal(axis.name, "joint")] = command
                command = _force(model, axis.name, command, self.rate_hz)
            table[axis_signal(axis.name, "command")] = command
        return pd.DataFrame(table | paths)

    def start_values(self, linkages: Mapping[str, TabulatedLinkage]) -> dict[str, float]:
        """Signal → initial value: the driven signals, and the joints of cylinders where a linkage is known."""
        start = {}
        for feasible, value in zip(self.feasible_sets, self.start, strict=True):
            axis = feasible.axis
            start[axis.driven] = float(value)
            if axis.drives == "cylinder" and axis.name in linkages:
                start[axis_signal(axis.name, "joint")] = float(linkages[axis.name].joint(np.array([value]))[0])
        return start


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
    segments = _segments(feasible_sets, motion, axes, seconds, seed)
    if not segments:
        return None
    speeds = _speeds(segments, len(feasible_sets), rate_hz)
    home = np.array([feasible.home for feasible in feasible_sets])
    excitation = ExcitationSignal(motion, axes, rate_hz, feasible_sets, speeds, home)
    corrections = 0 if all(feasible_sets[axis].follows_path for axis in axes) else CORRECTIONS
    for remaining in reversed(range(corrections + 1)):
        displacement = _displacement(model, excitation)
        start = _start(feasible_sets, displacement)
        if start is None:
            return None
        if remaining:
            segments = _scheduled(_with_corrected_ends(segments, excitation, displacement))
            speeds = _speeds(segments, len(feasible_sets), rate_hz)
        excitation = replace(excitation, speeds=speeds, start=start)
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
        start: signal → initial value [m or rad].
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


def _force(model: Model, axis: str, path: Array, rate_hz: float) -> Array:
    """Force needed to follow the path, (n,) [N or N·m]."""
    speed = np.gradient(path, 1.0 / rate_hz)
    return model.inverse(model.theta, axis, path, speed, np.gradient(speed, 1.0 / rate_hz), 1.0 / rate_hz)


def _inputs(commands: pd.DataFrame, start: Mapping[str, float], rate_hz: float, name: str) -> Recording:
    """Commands, and the driven signals during the start window, from which a free run starts."""
    first = commands["time"].to_numpy() < START_WINDOW
    begun = {signal: np.where(first, value, np.nan) for signal, value in start.items()}
    return Recording(name, commands.assign(**begun), rate_hz)


# -- strokes of a motion --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Segment:
    """A stroke whose speed rises from ``begin`` [s] over ``edge``, to zero at ``begin + hold + edge``.

    Args:
        group: index of its stroke group; ``pause`` [s] after the longest stroke of the group.
        to: prescribed end relative to the start of the motion [m or rad].
    """

    axis: int
    group: int
    begin: float
    level: float
    edge: float
    hold: float
    to: float | None
    pause: float

    @property
    def end(self) -> float:
        return self.begin + self.hold + self.edge


def _segments(
    feasible_sets: Sequence[FeasibleSet], motion: MotionPattern, axes: tuple[int, ...], seconds: float, seed: int
) -> list[_Segment]:
    """Segments of all cycles that fit, with their times."""
    segments: list[_Segment] = []
    place = dict.fromkeys(axes, 0.0)
    end, number = BEFORE, itertools.count()
    for groups in motion.cycles(axes, np.random.default_rng([seed, *axes])):
        cycle = [segment for group in groups for segment in _stroke_group(feasible_sets, group, place, next(number))]
        cycle = _scheduled(cycle, end)
        end = _end(cycle)
        if end + AFTER > seconds:
            break
        segments += cycle
    return segments


def _stroke_group(
    feasible_sets: Sequence[FeasibleSet], group: StrokeGroup, place: dict[int, float], number: int
) -> list[_Segment]:
    """The segments of simultaneous strokes; ``place`` of each axis [m or rad] is advanced by them."""
    segments = []
    for stroke in group.strokes:
        feasible = feasible_sets[stroke.axis]
        speed, sign = abs(stroke.level) * feasible.max_speed, float(np.sign(stroke.level))
        to = None
        if stroke.to is None:
            hold = min(stroke.seconds - stroke.edge, stroke.reach * feasible.span / speed)
        else:
            to = stroke.to * feasible.span
            way = to - place[stroke.axis]
            sign, hold = float(np.sign(way)) if way else sign, abs(way) / speed
        edge = max(stroke.edge, speed / feasible.max_acceleration)
        if not np.isfinite(feasible.max_acceleration):  # a valve is limited by its range only
            edge = max(min(edge, hold), 1e-3)
        hold = max(hold, edge)
        place[stroke.axis] += sign * speed * hold
        segments.append(_Segment(stroke.axis, number, 0.0, sign * abs(stroke.level), edge, hold, to, group.pause))
    return segments


def _scheduled(segments: Sequence[_Segment], begin: float = BEFORE) -> list[_Segment]:
    """The same segments, each stroke group after the longest stroke and the pause of the previous group."""
    timed: list[_Segment] = []
    for _, group in itertools.groupby(segments, key=lambda segment: segment.group):
        part = [replace(segment, begin=begin) for segment in group]
        timed += part
        begin = _end(part)
    return timed


def _end(segments: Sequence[_Segment]) -> float:
    """End of the pause after the last stroke group [s]."""
    return max(segment.end + segment.pause for segment in segments)


def _speeds(segments: Sequence[_Segment], axes: int, rate_hz: float) -> Array:
    """Speed of each axis as a share of full speed, (n, A)."""
    time = np.arange(round((_end(segments) + AFTER) * rate_hz)) / rate_hz
    speeds = np.zeros((len(time), axes))
    for segment in segments:
        first, last = int(segment.begin * rate_hz), int(np.ceil(segment.end * rate_hz)) + 1
        t = time[first:last]
        shape = np.minimum((t - segment.begin) / segment.edge, (segment.end - t) / segment.edge)
        speeds[first:last, segment.axis] += segment.level * np.clip(shape, 0.0, 1.0)
    return np.clip(speeds, -1.0, 1.0)


# -- corrections by the simulated motion ----------------------------------------------------------------------------------


def _displacement(model: Model, excitation: ExcitationSignal) -> Array:
    """Displacement of each driven signal from its initial value, (n, A)."""
    run = pd.DataFrame()
    if not all(feasible.follows_path for feasible in excitation.feasible_sets):
        inputs = _inputs(excitation.commands(model), excitation.start_values({}), excitation.rate_hz, "displacement")
        run = free_run(model, inputs)
    displacement = np.empty(excitation.speeds.shape)
    for i, feasible in enumerate(excitation.feasible_sets):
        driven = excitation.path(i) if feasible.follows_path else run[feasible.axis.driven].to_numpy()
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


def _with_corrected_ends(segments: Sequence[_Segment], excitation: ExcitationSignal, displacement: Array) -> list[_Segment]:
    """Segments of valves with a prescribed end, lengthened or shortened by the error of the simulated end position.

    Each has to reverse the strokes since the previous segment with a prescribed end, but not the error of that segment: all
    segments are corrected at once, and the previous error is corrected there.
    """
    rate_hz, corrected = excitation.rate_hz, {}
    for axis in excitation.axes:
        own = [(k, segment) for k, segment in enumerate(segments) if segment.axis == axis]
        if excitation.feasible_sets[axis].follows_path or not own:
            continue
        # With the latency of the drive, the response to a stroke ends when the response to the next one begins.
        latency = _latency(excitation.speeds[:, axis], displacement[:, axis], rate_hz)
        next_begins = [*(later.begin for _, later in own[1:]), np.inf]
        due, began = 0.0, 0.0
        for (k, segment), next_begin in zip(own, next_begins, strict=True):
            end = min(segment.end + 0.5, next_begin)
            ended = float(displacement[min(round((end + latency) * rate_hz), len(displacement) - 1), axis])
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


def _latency(speed: Array, displacement: Array, rate_hz: float) -> float:
    """Latency of the motion after the command [s]: lag of the largest cross-correlation of the two speeds."""
    response = np.gradient(displacement)
    lags = np.arange(0, min(round(MAX_LATENCY * rate_hz), len(speed) - 1))
    correlation = [float(speed[: len(speed) - lag] @ response[lag:]) for lag in lags]
    return float(lags[int(np.argmax(correlation))] / rate_hz)
