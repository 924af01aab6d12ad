"""Residual model of a stage that no effect explains: a bounded network, accepted only if it lowers the held-out error.

It is trained on the fit recordings with early stopping on the selection recordings, where it has to lower the error before the
one evaluation on the held-out recordings. It is called ``unnamed_residual``, is not listed among the effects, and identifies no
cause.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset, Recording
from sysid.errors import SettingsError
from sysid.gap.case import Case, Stage
from sysid.gap.disagreement import stage_rmse
from sysid.gap.drift import robust_scale
from sysid.gap.floor import problem_floor
from sysid.gap.likelihood.discrepancy.shapes import filled
from sysid.gap.problem import Problem, problems_of
from sysid.gap.proof import ProofOutcome
from sysid.gap.result import ResidualModelResult, Unnamed
from sysid.gap.unnamed.residual_series import gain_p_value
from sysid.networks.recurrent import RecordingWindow, RecurrentSettings, interval_means, train_recurrent
from sysid.plant import Model, Plant, compile_plant, gravity_load
from sysid.plant.force import force_inputs
from sysid.plant.residual import STAGES, WARNING, Residual, input_names
from sysid.progress import Progress, part, silent

Array = npt.NDArray[np.float64]

#: Columns of the inputs (:func:`sysid.plant.residual.input_names`), from the end.
POSITION, SPEED = -5, -4
#: Time between two evaluations of the network [s]: short against a stroke, long against a sample.
INTERVAL, FORCE_INTERVAL = 0.05, 0.02
#: Bound of its output, in robust standard deviations of the residual.
BOUND = 3.0
#: Bound of its output as a share of the speed, and least speed, relative to the maximum, at which the share is estimated.
MAX_SPEED_SHARE, MIN_SPEED = 0.9, 0.1
#: Time over which errors of speed are averaged [s], so that sensor noise does not determine the bound.
SPEED_WINDOW = 0.2
#: Largest ratio of the error on the selection recordings with and without the network, and largest p-value of that gain.
MAX_SELECTION_RATIO, MAX_P_VALUE = 0.9, 0.05
#: Time constant with which the position input during training follows the measured position [s].
SMOOTH = 0.25


@dataclass(frozen=True)
class _ResidualRecording:
    """A recording at its sample rate: inputs of the network (n, F) and residual (n,).

    Args:
        speed: speed of which the network of a velocity axis outputs a share (n,); None elsewhere.
        stride: samples between two evaluations of the network, ``interval`` seconds.
    """

    inputs: Array
    left: Array
    speed: Array | None
    stride: int
    interval: float

    def windows(self) -> RecordingWindow:
        count = (len(self.left) - 1) // self.stride
        at = np.arange(count) * self.stride
        inputs = self.inputs[at].copy()
        inputs[0, SPEED] = 0.0
        inputs[1:, SPEED] = np.diff(inputs[:, POSITION]) / self.interval
        if self.speed is not None:
            return RecordingWindow(inputs, self.left[at], interval_means(self.speed[: count * self.stride], self.stride))
        return RecordingWindow(inputs, interval_means(self.left[1 : 1 + count * self.stride], self.stride), np.ones(count))


def fit_residual_models(
    case: Case,
    stages: Sequence[Stage],
    outcome: ProofOutcome,
    settings: RecurrentSettings | None = None,
    progress: Progress = silent,
) -> ProofOutcome:
    """The outcome with a residual network for each stage with unnamed structure, where one lowers the held-out error.

    Raises:
        SettingsError: the simulation under test is not a plant.
    """
    if case.adapter is not None:
        raise SettingsError(
            f"simulator {case.adapter.name}", "cannot hold a residual network", "a plant", "Add it inside the simulator itself."
        )
    repaired, found = outcome.repaired, list[ResidualModelResult]()
    # A stage may be listed twice: for effects without a name, and for the remaining residual.
    by_stage = {(item.stage, item.target): item for item in outcome.unnamed}
    for k, item in enumerate(by_stage.values()):
        (stage,) = [s for s in stages if (s.problem.stage, s.problem.target) == (item.stage, item.target)]
        if item.stage not in STAGES:
            text = f"the {stage.label} cannot hold one: only {', '.join(STAGES)} stages can"
            found.append(
                ResidualModelResult(item.stage, item.target, "", float("nan"), float("nan"), float("nan"), False, text)
            )
            continue
        stage_progress = part(progress, k / len(by_stage), (k + 1) / len(by_stage))
        stage_progress(0.0, f"{stage.label}: residual network")
        result, repaired = _fit_stage(case, stage, item, repaired, settings or RecurrentSettings(), stage_progress)
        found.append(result)
    notes = [] if outcome.unnamed else ["no stage has an unnamed residual that a residual network could describe"]
    return replace(outcome, repaired=repaired, carried=found, notes=[*outcome.notes, *notes])


def _fit_stage(
    case: Case, stage: Stage, left: Unnamed, repaired: Plant, settings: RecurrentSettings, progress: Progress
) -> tuple[ResidualModelResult, Plant]:
    """Train the network of one stage and compare the plants with and without it."""
    period = left.period if left.period_unit != "s" else 0.0  # over the position of its axis
    name, target, split = stage.problem.stage, stage.problem.target, stage.split
    plain = repaired.without_residual(name, target)
    problem, model = _problem(plain, case.dataset, name, target)
    (signal,) = problem.signals
    parts = {r.name: _residual_recording(problem, model, r, period) for r in split.seen}
    fit, select = ([parts[r.name].windows() for r in rs] for rs in (split.fit, split.select))
    interval = _interval(name, case.dataset.machine.rate_hz)
    bound = _bound([parts[r.name].windows() for r in split.seen], problem.integrates, interval)
    held_out = float(stage_rmse(problem, model.theta, split.held_out)[0])
    floor = float(problem_floor(problem, model.theta, split.held_out, case.noise, case.seed)[0])

    def refused(why: str, after: float = float("nan")) -> tuple[ResidualModelResult, Plant]:
        return ResidualModelResult(
            name, target, signal, held_out, after, floor, False, f"{stage.label}: {why}", bound
        ), repaired

    if not bound > 0.0:
        return refused("there is no residual to train on")
    trained = train_recurrent(fit, select, bound, interval, problem.integrates, settings, case.seed, progress)
    origin: dict[str, Any] = {
        "dataset": case.dataset.reference,
        "dataset_digest": case.dataset.digest,
        "plant": case.plant.reference or "nominal",
        "fit": [r.name for r in split.fit],
        "select": [r.name for r in split.select],
        "seed": case.seed,
        "epochs": trained.epochs,
        "inputs": [n for n, s in zip(input_names(plain.machine, target), trained.weights["scale"], strict=True) if s != 0.0],
    }
    item = Residual(name, target, bound, interval, **trained.weights, origin=origin, period=period)  # type: ignore[arg-type]
    extended = plain.with_residual(item)
    better, loaded = _problem(extended, case.dataset, name, target)
    before, after = (float(stage_rmse(p, m.theta, split.select)[0]) for p, m in ((problem, model), (better, loaded)))
    p_value = _p_value(problem, model.theta, better, loaded.theta, split.select, case.seed)
    if not after < MAX_SELECTION_RATIO * before or p_value > MAX_P_VALUE:
        return refused(
            f"a residual network does not predict recordings left out of the fit ({signal} {before:.3g} → {after:.3g} "
            f"on the selection recordings, p = {p_value:.2f})"
        )
    now = float(stage_rmse(better, loaded.theta, split.held_out)[0])
    if not now < 0.98 * held_out:
        return refused(f"a residual network did not help on held-out recordings ({signal} {held_out:.3g} → {now:.3g})", now)
    text = f"{stage.label}: {WARNING}; held-out {signal} {held_out:.3g} → {now:.3g}"
    floor = float(problem_floor(better, loaded.theta, split.held_out, case.noise, case.seed)[0])
    inputs = tuple(origin["inputs"])
    return ResidualModelResult(name, target, signal, held_out, now, floor, True, text, bound, inputs), extended


def _problem(plant: Plant, dataset: Dataset, stage: str, target: str) -> tuple[Problem, Model]:
    model = compile_plant(plant)
    (problem,) = [p for p in problems_of(model, dataset) if (p.stage, p.target) == (stage, target)]
    return problem, model


def _interval(stage: str, rate_hz: float) -> float:
    """A whole number of samples."""
    wanted = FORCE_INTERVAL if stage == "force" else INTERVAL
    return max(1, round(wanted * rate_hz)) / rate_hz


def _residual_recording(problem: Problem, model: Model, recording: Recording, period: float) -> _ResidualRecording:
    """Inputs of the network, and its target (or the integral of the target)."""
    axis = model.machine.axis(problem.target)
    i, rate = model.axis_index(axis.name), recording.rate_hz
    interval = _interval(problem.stage, rate)
    stride = round(interval * rate)
    commands, speed = model.commands_by_step(recording, i), None
    load = gravity_load(model.machine, recording)[:, i]
    if not all(len(model.held(recording, name)[1]) for name in model.machine.axis_names):
        load = np.zeros(len(recording))  # the pose of a free run is unknown; a constant zero disables the input
    if problem.stage == "force":
        inputs = force_inputs(recording, axis, problem.force_filter)
        left = np.full(len(recording), np.nan)
        left[inputs.rows] = inputs.force - inputs.model_force(model, model.theta[None], axis.name)[0]
        left = _nearest(left, 2 * stride)
        position, commands, load = inputs.position, np.zeros_like(commands), np.zeros(len(recording))
    else:
        predicted = problem.predict(model.theta[None], recording)[0][:, 0]
        left = problem.measured(recording)[:, 0] - predicted
        if problem.stage == "command":
            position = filled(predicted) + _smooth(filled(left), SMOOTH * rate)
            speed = np.append(np.diff(filled(predicted)), 0.0) * rate if problem.integrates else None
        else:
            position, commands = filled(recording.values(axis.driven)), np.zeros_like(commands)
    angle = 2.0 * np.pi * position / period if period > 0.0 else np.zeros(len(position))
    ripple = (np.sin(angle), np.cos(angle))
    return _ResidualRecording(
        np.column_stack([commands, position, np.zeros(len(load)), load, *ripple]), left, speed, stride, interval
    )


def _bound(parts: Sequence[RecordingWindow], integrates: bool, interval: float) -> float:
    """:data:`BOUND` robust standard deviations of the residual; of its share of the speed where the stage integrates."""
    if not integrates:
        joined = np.concatenate([part.residual for part in parts])
        joined = joined[np.isfinite(joined)]
        return BOUND * robust_scale(joined) if len(joined) else 0.0
    lag, shares = max(1, round(SPEED_WINDOW / interval)), []
    for windows in parts:
        moved = interval * np.convolve(windows.size, np.ones(lag), mode="valid")[: len(windows.residual) - lag]
        rest = windows.residual[lag:] - windows.residual[:-lag]
        moving = np.isfinite(rest) & (np.abs(moved) > MIN_SPEED * np.abs(moved).max(initial=0.0))
        shares.append(rest[moving] / moved[moving])
    joined = np.concatenate(shares)
    return min(BOUND * robust_scale(joined), MAX_SPEED_SHARE) if len(joined) else 0.0


def _p_value(before: Problem, theta: Array, after: Problem, other: Array, recordings: Sequence[Recording], seed: int) -> float:
    """p-value of the gain on these recordings: squared errors over half seconds, of rates where the stage integrates."""
    gains = []
    for recording in recordings:
        measured = before.measured(recording)[:, 0]
        width = max(1, round(0.5 * before.rate(recording)))
        squares = []
        for problem, values in ((before, theta), (after, other)):
            error = measured - problem.predict(values[None], recording)[0][:, 0]
            error = error[: len(error) // width * width].reshape(-1, width)
            means = np.nanmean(np.where(np.isfinite(error).any(axis=1, keepdims=True), error, 0.0), axis=1)
            squares.append((np.diff(means) if problem.integrates else means) ** 2)
        gains.append(squares[0] - squares[1])
    return gain_p_value(np.concatenate(gains), seed)


def _smooth(values: Array, width: float) -> Array:
    from scipy.ndimage import gaussian_filter1d

    return np.asarray(gaussian_filter1d(values, 0.5 * width, mode="nearest"))


def _nearest(values: Array, reach: int) -> Array:
    """Values interpolated within ``reach`` samples of a finite entry, NaN elsewhere."""
    from scipy.ndimage import distance_transform_edt

    away = np.asarray(distance_transform_edt(~np.isfinite(values)))
    return np.where(away <= reach, filled(values), np.nan)
