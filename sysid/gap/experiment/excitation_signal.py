"""From a motion to commands: how long each stroke lasts, where to start, and what the plant does with it."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.gap.experiment.feasible_set import Room
from sysid.gap.experiment.motions import Motion, Turn
from sysid.machine import TabulatedLinkage
from sysid.plant import Model, free_run
from sysid.plant.model import START_WINDOW
from sysid.signals import POINTS, axis_signal, split_signal

Array = npt.NDArray[np.float64]

#: Rest before the first and after the last stroke [s].
BEFORE, AFTER = 1.0, 1.0
#: How often strokes that have to end somewhere are corrected by what the plant did.
CORRECTIONS = 5
#: No drive answers later than this [s].
LATEST = 1.0


@dataclass(frozen=True)
class Leg:
    """A stroke with its time: the speed of ``axis`` rises from ``begin`` [s] over ``edge``, is zero at ``begin + hold + edge``.

    ``to`` [m or rad]: where it has to end, from where the motion began; None: wherever.
    """

    axis: int
    turn: int
    begin: float
    level: float
    edge: float
    hold: float
    to: float | None

    @property
    def end(self) -> float:
        return self.begin + self.hold + self.edge


@dataclass(frozen=True)
class Script:
    """Commands and where they start.

    Args:
        speeds: share of full speed, (n, A).
        start: of what each command drives (A,) [m or rad].
    """

    motion: Motion
    axes: tuple[int, ...]
    rate_hz: float
    speeds: Array
    start: Array

    @property
    def seconds(self) -> float:
        return len(self.speeds) / self.rate_hz


def script_of(
    model: Model, rooms: Sequence[Room], motion: Motion, axes: tuple[int, ...], seconds: float, rate_hz: float, seed: int
) -> Script | None:
    """As many strokes as fit into ``seconds``, corrected so that what has to come back does in ``model``.

    Returns:
        None where there is no time for a single group of strokes, or no room for the motion.
    """
    legs, pauses = _legs(rooms, motion, axes, seconds, seed)
    if not legs:
        return None
    count = round((_end(legs, pauses) + AFTER) * rate_hz)
    speeds, start = _speeds(legs, len(rooms), count, rate_hz), np.array([room.home for room in rooms])
    script = Script(motion, axes, rate_hz, speeds, start)
    for correction in range(CORRECTIONS + 1):
        moved = _moved(model, rooms, script)
        place = _start(rooms, moved)
        if place is None:
            return None
        script = replace(script, start=place)
        if correction == CORRECTIONS or all(rooms[axis].follows for axis in axes):
            break
        legs = _timed(_corrected(legs, script.speeds, moved, rooms, rate_hz), pauses)
        count = round((_end(legs, pauses) + AFTER) * rate_hz)
        script = replace(script, speeds=_speeds(legs, len(rooms), count, rate_hz))
    return script


def perform(
    model: Model,
    commands: pd.DataFrame,
    start: Mapping[str, float],
    rate_hz: float,
    measured: frozenset[str] | None = None,
    name: str = "rehearsal",
) -> Recording:
    """The recording that a machine like ``model`` would make of the commands, without noise.

    A force axis is on its path; its command is the force that ``model`` takes for it.

    Args:
        commands: as in :class:`~sysid.gap.experiment.experiment.Experiment`.
        start: signal → value at the start.
        measured: signals that the recording has; all that the plant predicts by default.
    """
    inputs = _inputs(commands, start, rate_hz, name)
    run = free_run(model, inputs)
    columns: dict[str, Array] = {s: commands[s].to_numpy() for s in map(str, commands.columns) if not s.endswith(".joint")}
    forced = [axis for axis in model.machine.axes if axis.actuation == "force"]
    for signal in map(str, run.columns[1:]):
        # A point is simulated from the joints of the free run, which a force alone does not keep on its path.
        if not (forced and split_signal(signal)[0] in POINTS):
            columns[signal] = run[signal].to_numpy()
    for axis in forced:
        path = commands[axis_signal(axis.name, "joint")].to_numpy()
        columns[axis.driven] = path
        columns[axis_signal(axis.name, "command")] = _force(model, axis.name, path, rate_hz)
    kept = [s for s in columns if s == "time" or s.endswith(".command") or measured is None or s in measured]
    return replace(inputs, table=pd.DataFrame({signal: columns[signal] for signal in kept}))


def commands_of(model: Model, rooms: Sequence[Room], script: Script) -> pd.DataFrame:
    """What an experiment file holds: ``time``, every axis's command, the path of every force axis."""
    table: dict[str, Array] = {"time": np.arange(len(script.speeds)) / script.rate_hz}
    for i, room in enumerate(rooms):
        table[axis_signal(room.axis.name, "command")] = _command(model, room, script, i)
    for i, room in enumerate(rooms):
        if room.axis.actuation == "force":
            table[axis_signal(room.axis.name, "joint")] = _path(room, script, i)
    return pd.DataFrame(table)


def start_of(rooms: Sequence[Room], script: Script, linkages: Mapping[str, TabulatedLinkage]) -> dict[str, float]:
    """Signal → value at the start: what the commands drive, and the joints behind cylinders where a linkage is known."""
    start = {}
    for room, value in zip(rooms, script.start, strict=True):
        start[room.axis.driven] = float(value)
        if room.axis.drives == "cylinder" and room.axis.name in linkages:
            start[axis_signal(room.axis.name, "joint")] = float(linkages[room.axis.name].joint(np.array([value]))[0])
    return start


def _legs(
    rooms: Sequence[Room], motion: Motion, axes: tuple[int, ...], seconds: float, seed: int
) -> tuple[list[Leg], list[float]]:
    """Strokes of all groups that fit, with their times; the pause after each turn."""
    groups = motion.groups(axes, np.random.default_rng([seed, *axes]))
    legs: list[Leg] = []
    pauses: list[float] = []
    place = dict.fromkeys(axes, 0.0)
    end = BEFORE
    while True:
        group: list[Leg] = []
        turns = next(groups)
        for number, turn in enumerate(turns, start=len(pauses)):
            group += _turn(rooms, turn, place, number)
        after = [turn.pause for turn in turns]
        group = _timed(group, after, end)
        end = _end(group, after)
        if end + AFTER > seconds:
            return legs, pauses
        legs += group
        pauses += after


def _turn(rooms: Sequence[Room], turn: Turn, place: dict[int, float], number: int) -> list[Leg]:
    legs = []
    for stroke in turn.strokes:
        room = rooms[stroke.axis]
        speed = abs(stroke.level) * room.top
        sign = np.sign(stroke.level)
        if stroke.to is None:
            hold = min(stroke.seconds - stroke.edge, stroke.reach * room.span / speed)
        else:
            way = stroke.to * room.span - place[stroke.axis]
            sign, hold = np.sign(way) if way else sign, abs(way) / speed
        edge = max(stroke.edge, speed / room.rise)
        if not np.isfinite(room.rise):  # nothing but room limits a valve
            edge = max(min(edge, hold), 1e-3)
        hold = max(hold, edge)
        place[stroke.axis] += float(sign) * speed * hold
        to = None if stroke.to is None else stroke.to * room.span
        legs.append(Leg(stroke.axis, number, 0.0, float(sign) * abs(stroke.level), edge, hold, to))
    return legs


def _timed(legs: Sequence[Leg], pauses: Sequence[float], begin: float = BEFORE) -> list[Leg]:
    """The same strokes, each turn after the longest stroke of the one before and its pause."""
    timed: list[Leg] = []
    for (_, turn), pause in zip(itertools.groupby(legs, key=lambda leg: leg.turn), pauses, strict=True):
        part = [replace(leg, begin=begin) for leg in turn]
        timed += part
        begin = max(leg.end for leg in part) + pause
    return timed


def _end(legs: Sequence[Leg], pauses: Sequence[float]) -> float:
    """When the pause after the last turn is over."""
    return max(leg.end for leg in legs if leg.turn == legs[-1].turn) + pauses[-1]


def _speeds(legs: Sequence[Leg], axes: int, count: int, rate_hz: float) -> Array:
    time = np.arange(count) / rate_hz
    speeds = np.zeros((count, axes))
    for leg in legs:
        first, last = int(leg.begin * rate_hz), int(np.ceil(leg.end * rate_hz)) + 1
        t = time[first:last]
        shape = np.minimum((t - leg.begin) / leg.edge, (leg.end - t) / leg.edge)
        speeds[first:last, leg.axis] += leg.level * np.clip(shape, 0.0, 1.0)
    return np.clip(speeds, -1.0, 1.0)


def _moved(model: Model, rooms: Sequence[Room], script: Script) -> Array:
    """Way of what each command drives, from where it began, (n, A)."""
    run = pd.DataFrame()
    if not all(room.follows for room in rooms):
        start = {room.axis.driven: float(value) for room, value in zip(rooms, script.start, strict=True)}
        run = free_run(model, _inputs(commands_of(model, rooms, script), start, script.rate_hz, "moved"))
    moved = np.empty(script.speeds.shape)
    for i, room in enumerate(rooms):
        driven = _path(room, script, i) if room.follows else run[room.axis.driven].to_numpy()
        moved[:, i] = driven - driven[0]
    return moved


def _start(rooms: Sequence[Room], moved: Array) -> Array | None:
    """As near home as the travel leaves room for; None where it does not fit."""
    start = np.empty(len(rooms))
    for i, room in enumerate(rooms):
        low, high = room.low - float(moved[:, i].min()), room.high - float(moved[:, i].max())
        if low > high:
            return None
        start[i] = np.clip(room.home, low, high)
    return start


def _latency(speed: Array, moved: Array, rate_hz: float) -> float:
    """By how much the motion follows what was commanded [s]: where the two speeds are most alike."""
    answer = np.gradient(moved)
    lags = np.arange(0, min(round(LATEST * rate_hz), len(speed) - 1))
    likeness = [float(speed[: len(speed) - lag] @ answer[lag:]) for lag in lags]
    return float(lags[int(np.argmax(likeness))] / rate_hz)


def _corrected(legs: Sequence[Leg], speeds: Array, moved: Array, rooms: Sequence[Room], rate_hz: float) -> list[Leg]:
    """Strokes of valves that have to end somewhere, longer or shorter by what the plant missed it by.

    Each is to undo the strokes since the one before it that had to end somewhere, not what that one missed: all strokes change
    at once, so none may run after an error that the earlier ones will not make again.
    """
    corrected = {}
    for axis in sorted({leg.axis for leg in legs if not rooms[leg.axis].follows}):
        own = [(k, leg) for k, leg in enumerate(legs) if leg.axis == axis]
        # A drive answers late: what a stroke does is over when the answer to the next one begins.
        late = _latency(speeds[:, axis], moved[:, axis], rate_hz)
        ends = [min(leg.end + 0.5, later.begin) for (_, leg), (_, later) in itertools.pairwise(own)] + [own[-1][1].end + 0.5]
        places = [float(moved[min(round((t + late) * rate_hz), len(moved) - 1), axis]) for t in ends]
        due, began = 0.0, 0.0
        for (k, leg), ended in zip(own, places, strict=True):
            done = ended - began
            if leg.to is None:
                due += done
            else:
                wanted = leg.to - due
                if abs(done) > 0.1 * abs(wanted) and wanted * done > 0.0:
                    hold = leg.hold * float(np.clip(wanted / done, 0.5, 2.0))
                    corrected[k] = replace(leg, hold=hold, edge=min(leg.edge, hold))
                due = leg.to
            began = ended
    return [corrected.get(k, leg) for k, leg in enumerate(legs)]


def _path(room: Room, script: Script, at: int) -> Array:
    """Way of an axis that follows a path: the integral of its speed (n,), by the trapezoidal rule."""
    speed = script.speeds[:, at] * room.top
    steps = 0.5 * (speed[1:] + speed[:-1]) / script.rate_hz
    return np.asarray(script.start[at] + np.concatenate([[0.0], np.cumsum(steps)]))


def _command(model: Model, room: Room, script: Script, at: int) -> Array:
    if not room.follows:
        return script.speeds[:, at]
    path = _path(room, script, at)
    return path if room.axis.actuation == "position" else _force(model, room.axis.name, path, script.rate_hz)


def _force(model: Model, axis: str, path: Array, rate_hz: float) -> Array:
    """What it takes to follow the path, (n,) [N or N·m]."""
    speed = np.gradient(path, 1.0 / rate_hz)
    return model.inverse(model.theta, axis, path, speed, np.gradient(speed, 1.0 / rate_hz), 1.0 / rate_hz)


def _inputs(commands: pd.DataFrame, start: Mapping[str, float], rate_hz: float, name: str) -> Recording:
    """Commands, and a first moment of what they move, from which a free run starts."""
    first = commands["time"].to_numpy() < START_WINDOW
    begun = {signal: np.where(first, value, np.nan) for signal, value in start.items()}
    return Recording(name, commands.assign(**begun), rate_hz)
