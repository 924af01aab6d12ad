"""Command → motion networks: history of command and speed, and the position → the next speed of the driven signal.

Source: the actuator network of Hwangbo et al., "Learning agile and dynamic motor skills for legged robots", Science Robotics 4
(2019), which predicts a torque; here it is the motion of an axis of any actuation. Networks are trained on the one-step error.
Candidates are selected, and evaluated, by free runs on other recordings, since a simulation feeds back its own predictions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset, Recording, Role
from sysid.errors import ExcitationError
from sysid.machine.description import Axis
from sysid.networks.forward import is_angle
from sysid.networks.member import Checkpoints, EnsembleMember, LearningCurve, TrainedMember
from sysid.networks.mlp import Mlp
from sysid.networks.motion_inputs import MotionBounds, MotionStretch, Window, horizon_errors, roll, whole_run, window_of
from sysid.networks.recipe import MotionRecipe, NetworkRecipe
from sysid.networks.split import RowRange, evenly_spaced, measures, segments
from sysid.networks.training import train
from sysid.progress import Progress
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Least number of rows of each role.
MIN_ROWS = 100
#: Bounds of a free run: this factor of the fastest training speed, and this share of the training range beyond its ends.
MAX_SPEED_FACTOR, RANGE_MARGIN = 1.2, 0.02
#: Free runs to a horizon start this many seconds apart.
START_INTERVAL_S = 0.25


@dataclass(frozen=True)
class InputCandidate:
    """A candidate set of inputs.

    Args:
        speeds: whether it contains past speeds.
        one_step: RMSE of the speed one step ahead on the select recordings, mean of the members [SI/s].
        free_run: horizon, or ``whole`` recordings → RMSE of the position [SI].
        kept: whether it was selected.
    """

    speeds: bool
    one_step: float
    free_run: Mapping[str, float]
    kept: bool = False

    @property
    def score(self) -> float:
        """Geometric mean of the free-run errors, so that every horizon has the same weight."""
        return float(np.exp(np.mean(np.log(np.maximum(list(self.free_run.values()), 1e-300)))))


@dataclass(frozen=True)
class MotionNetwork:
    """One axis.

    Args:
        axis, command, driven: its name and signals.
        unit: SI unit of the driven signal.
        window: its inputs.
        members: inputs of the window → mean speed over the next step [SI/s]; predictions are averaged.
        bounds: of every free run.
        commands: range of the training commands.
        learning_curves: of the members.
        candidates: all candidate inputs.
    """

    axis: str
    command: str
    driven: str
    unit: str
    window: Window
    members: tuple[Mlp, ...]
    bounds: MotionBounds
    commands: tuple[float, float]
    learning_curves: tuple[LearningCurve, ...]
    candidates: tuple[InputCandidate, ...] = ()

    def speed(self, inputs: Array) -> Array:
        """Inputs (n, d) of the window → mean speed over the next step (n,)."""
        total = self.members[0].predict(inputs)[:, 0]
        for member in self.members[1:]:
            total += member.predict(inputs)[:, 0]
        return np.asarray(total / len(self.members))

    def motion(self, recording: Recording) -> MotionStretch:
        """The signals of a recording for this network."""
        stride = self.window.stride(recording.rate_hz)
        return MotionStretch.of(recording.values(self.command), recording.values(self.driven), stride)

    def free_run(self, recording: Recording) -> Array:
        """The driven signal on the recording's rows (n,): one free run from the first row with a complete history.

        After a gap of the command it restarts from the measurement.
        """
        return whole_run(self.speed, self.window, self.bounds, self.motion(recording))

    def ahead(self, recording: Recording, seconds: float) -> Array:
        """Prediction of each row from ``seconds`` before it, (n,): free runs that start at every step; NaN where none ends."""
        out = np.full(len(recording), np.nan)
        motion, apart = [self.motion(recording)], self.window.step
        for ends, predicted, _ in horizon_errors(self.speed, self.window, self.bounds, motion, seconds, apart):
            out[ends] = predicted
        return out

    def roll(self, commands: Array, positions: Array) -> Array:
        """Free runs in parallel: commands of the history and of the next steps (b, depth + steps), positions of the history
        (b, depth + 1) → positions from the start on (b, steps + 1)."""
        return roll(self.speed, self.window, self.bounds, commands, positions)

    def stream(self, position: float) -> MotionStream:
        """The network at rest at ``position``, to be moved step by step."""
        return MotionStream(self, position)


class MotionStream:
    """A :class:`MotionNetwork` with its state: a :meth:`step` every ``window.step`` seconds, without torch."""

    def __init__(self, network: MotionNetwork, position: float) -> None:
        self.network = network
        window = network.window
        # At rest the past commands are zero, those of a servo its position.
        self._commands = np.full((1, window.commands[-1] + 1), position if window.follows else 0.0)
        self._positions = np.full((1, window.edges[-1] + 1), float(position))
        self._seen, self._edges = -1 - np.array(window.commands), -1 - np.array(window.edges)

    @property
    def position(self) -> float:
        return float(self._positions[0, -1])

    def step(self, command: float) -> float:
        """The command of the next step → position after it [SI]."""
        network, window = self.network, self.network.window
        self._commands[0, :-1] = self._commands[0, 1:]
        self._commands[0, -1] = command
        inputs = window.features(self._commands[:, self._seen], self._positions[:, self._edges])
        predicted = np.clip(network.speed(inputs)[0], *network.bounds.speeds)
        position = float(np.clip(self.position + window.step * predicted, *network.bounds.positions))
        self._positions[0, :-1] = self._positions[0, 1:]
        self._positions[0, -1] = position
        return position


def fit_motion(
    dataset: Dataset, recipe: NetworkRecipe, progress: Progress | None = None, checkpoints: Checkpoints | None = None
) -> dict[str, MotionNetwork]:
    """One network for every axis whose command and motion were recorded together; all candidates are trained together.

    The steps of the ``select`` recordings decide early stopping, and their free runs which candidate is selected. ``held_out``
    rows are not read.

    Returns:
        Axis → network, in kinematic order.

    Raises:
        ExcitationError: no axis has both signals; too few rows; a command or position that does not vary.
        SettingsError: times in the recipe that do not increase, a recording at another rate, or training diverges.
    """
    axes = [dataset.machine.axis(name) for name in motion_axes(dataset)]
    if not axes:
        expected = "at least one axis whose command and driven signal were recorded together"
        raise ExcitationError(f"dataset {dataset.reference}", "no axis with <axis>.command and its motion", expected)
    settings = recipe.motion
    plans: dict[tuple[str, bool], tuple[Window, list[EnsembleMember]]] = {}
    for axis in axes:
        for speeds in (True, False) if settings.speeds else (False,):
            window = window_for(axis, settings, dataset.machine.rate_hz, speeds)
            x, y = motion_rows(dataset, axis, window, "fit", settings.samples)
            x_select, y_select = motion_rows(dataset, axis, window, "select", settings.samples)
            names = window.names(axis_signal(axis.name, "command"), axis.driven)
            title = f"{axis.name} motion {'with' if speeds else 'without'} speeds"
            plans[axis.name, speeds] = (
                window,
                [
                    EnsembleMember(f"{title} {number}", x, y, x_select, y_select, names, (f"speed of {axis.driven}",))
                    for number in range(settings.members)
                ],
            )
    members = [member for _, several in plans.values() for member in several]
    results = train(members, settings.hidden, settings.training, recipe.seed, progress, checkpoints)
    trained = iter(results)
    found: dict[str, list[tuple[Window, Array, tuple[TrainedMember, ...]]]] = {axis.name: [] for axis in axes}
    for (name, _), (window, several) in plans.items():
        found[name].append((window, several[0].outputs, tuple(next(trained) for _ in several)))
    return {axis.name: _selected(dataset, axis, settings, found[axis.name]) for axis in axes}


def motion_axes(dataset: Dataset) -> tuple[str, ...]:
    """Axes with a motion recording of the command and the driven signal."""
    signals = {axis.name: (axis_signal(axis.name, "command"), axis.driven) for axis in dataset.machine.axes}
    return tuple(name for name, both in signals.items() if measures(dataset, both, "motion"))


def window_for(axis: Axis, recipe: MotionRecipe, rate_hz: float, speeds: bool = True) -> Window:
    """The inputs of a network of this axis."""
    past = recipe.speeds if speeds else ()
    return window_of(recipe.step, recipe.history, past, rate_hz, recipe.position, axis.actuation == "position")


def motions(dataset: Dataset, axis: Axis, window: Window, role: Role) -> tuple[tuple[Recording, MotionStretch], ...]:
    """The parts of ``role`` with their recordings; samples outside a part are NaN."""
    signals = (axis_signal(axis.name, "command"), axis.driven)
    found = []
    for part in segments(dataset, role, signals):
        command, position = (_within(part, signal) for signal in signals)
        found.append((part.recording, MotionStretch.of(command, position, window.stride(part.recording.rate_hz))))
    return tuple(found)


def _within(part: RowRange, signal: str) -> Array:
    whole = np.full(len(part.recording), np.nan)
    whole[part.start : part.stop] = part.recording.values(signal)[part.start : part.stop]
    return whole


def motion_rows(dataset: Dataset, axis: Axis, window: Window, role: Role, samples: int) -> tuple[Array, Array]:
    """Inputs (n, d) and speeds (n, 1) of one step ahead, at most ``samples`` of them, evenly spaced.

    Raises:
        ExcitationError: fewer than :data:`MIN_ROWS`.
    """
    parts = [motion.rows(window, motion.starts(window)) for _, motion in motions(dataset, axis, window, role)]
    x, y = (np.concatenate(values) for values in zip(*parts, strict=True))
    if len(x) < MIN_ROWS:
        span = (window.depth + 1) * window.step
        found = f"{len(x)} {role} rows with {span:g} s of command and motion without a gap"
        remedy = "Record more motion, or shorten motion.history."
        raise ExcitationError(f"dataset {dataset.reference}: axis {axis.name!r}", found, f"at least {MIN_ROWS}", remedy)
    if len(x) > samples:
        chosen = evenly_spaced(len(x), samples)
        x, y = x[chosen], y[chosen]
    return x, y


def free_run_rmse(model: MotionNetwork, dataset: Dataset, role: Role, horizons: Sequence[float]) -> dict[str, float]:
    """Horizon in seconds, and ``whole`` recordings → RMSE of the position [SI], if recordings are long enough."""
    axis = dataset.machine.axis(model.axis)
    parts = motions(dataset, axis, model.window, role)
    found: dict[str, float] = {}
    for seconds in horizons:
        ends = horizon_errors(
            model.speed, model.window, model.bounds, [motion for _, motion in parts], seconds, START_INTERVAL_S
        )
        errors = np.concatenate([predicted - truth for _, predicted, truth in ends])
        if len(errors):
            found[f"{seconds:g}"] = float(np.sqrt(np.mean(errors**2)))
    runs = [whole_run(model.speed, model.window, model.bounds, motion) - motion.position for _, motion in parts]
    errors = np.concatenate(runs)
    errors = errors[np.isfinite(errors)]
    if len(errors):
        found["whole"] = float(np.sqrt(np.mean(errors**2)))
    return found


def _selected(
    dataset: Dataset, axis: Axis, recipe: MotionRecipe, tried: Sequence[tuple[Window, Array, tuple[TrainedMember, ...]]]
) -> MotionNetwork:
    """Evaluate every candidate by free runs on the select recordings and return the best."""
    networks, candidates = [], []
    for window, speeds, results in tried:
        network = MotionNetwork(
            axis=axis.name,
            command=axis_signal(axis.name, "command"),
            driven=axis.driven,
            unit="rad" if is_angle(dataset, axis.driven) else "m",
            window=window,
            members=tuple(result.mlp for result in results),
            bounds=bounds_of(dataset, axis, window, speeds),
            commands=_range([motion.command for _, motion in motions(dataset, axis, window, "fit")]),
            learning_curves=tuple(result.curve for result in results),
        )
        networks.append(network)
        one_step = float(np.mean([result.curve.validation_rmse[0] for result in results]))
        rmse = free_run_rmse(network, dataset, "select", recipe.horizons)
        candidates.append(InputCandidate(len(window.edges) > 1, one_step, rmse))
    # If no select recording is long enough for a free run, the one-step error decides.
    runs = all(candidate.free_run for candidate in candidates)
    best = int(np.argmin([candidate.score if runs else candidate.one_step for candidate in candidates]))
    predicted = tuple(replace(candidate, kept=number == best) for number, candidate in enumerate(candidates))
    return replace(networks[best], candidates=predicted)


def bounds_of(dataset: Dataset, axis: Axis, window: Window, speeds: Array) -> MotionBounds:
    """Bounds of free runs: the end stops where the description has them, else the training range plus a margin."""
    low, high = _range([motion.position for _, motion in motions(dataset, axis, window, "fit")])
    margin = RANGE_MARGIN * (high - low)
    stops = axis.range
    positions = tuple(
        stop if np.isfinite(stop) else end for stop, end in zip(stops, (low - margin, high + margin), strict=True)
    )
    slowest, fastest = float(speeds.min()), float(speeds.max())
    return MotionBounds(
        (MAX_SPEED_FACTOR * min(slowest, 0.0), MAX_SPEED_FACTOR * max(fastest, 0.0)), (positions[0], positions[1])
    )


def _range(parts: Sequence[Array]) -> tuple[float, float]:
    joined = np.concatenate(parts)
    return float(np.nanmin(joined)), float(np.nanmax(joined))
