"""Residual model of a stage that no effect explains: a bounded network, accepted only if it lowers the held-out error.

It is trained on the fit recordings with early stopping on the selection recordings, where it has to lower the error before the
one evaluation on the held-out recordings. It is called ``unnamed_residual``, is not listed among the effects, and identifies no
cause.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt, gaussian_filter1d

from sysid.datasets.chunked import earlier
from sysid.datasets.recording import Dataset, Recording
from sysid.errors import SettingsError
from sysid.gap.disagreement import run_rmse, stage_rmse
from sysid.gap.drift import robust_scale
from sysid.gap.likelihood.discrepancy.shapes import filled
from sysid.gap.prepare.case import Case, Stage
from sysid.gap.prepare.noise import problem_floor
from sysid.gap.problem import Problem, problems_of
from sysid.gap.proof import ProofOutcome
from sysid.gap.result import ResidualModelResult, Unnamed
from sysid.gap.thresholds import TENTH
from sysid.gap.unnamed.residual_series import LEAST_BLOCKS, gain_p_value
from sysid.names import listed
from sysid.networks.recurrent import RecordingWindow, RecurrentSettings, interval_means, train_recurrent
from sysid.plant import Model, Plant, compile_plant, gravity_load
from sysid.plant.force import force_inputs
from sysid.plant.residual import STAGES, WARNING, Residual, input_names
from sysid.progress import Progress, part, silent

Array = npt.NDArray[np.float64]

#: Time between two evaluations of the network [s]: short against a stroke, long against a sample.
INTERVAL, FORCE_INTERVAL = 0.05, 0.02
#: Bound of its output, in robust standard deviations of the residual.
BOUND = 3.0
#: Bound of its output as a share of the speed, and least speed, relative to the maximum, at which the share is estimated.
MAX_SPEED_SHARE, MIN_SPEED = 0.9, 0.1
#: Time over which errors of speed are averaged [s], so that sensor noise does not determine the bound.
SPEED_WINDOW = 0.2
#: Length of the blocks by which a network is tested [s].
BLOCK_S = 0.5
#: Largest ratio of the error with the network to that without it, on the selection and on the held-out recordings, and largest
#: p-value of the gain on the selection recordings.
MAX_SELECTION_RATIO, MAX_HELD_OUT_RATIO, MAX_P_VALUE = 0.9, 0.98, 0.05
#: Time constant with which the position input during training follows the measured position [s].
SMOOTH = 0.25


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
            found.append(ResidualModelResult(item.stage, item.target, "", math.nan, math.nan, math.nan, False, text))
            continue
        stage_progress = part(progress, k / len(by_stage), (k + 1) / len(by_stage))
        stage_progress(0.0, f"{stage.label}: residual network")
        result, repaired = _fit_stage(case, stage, item, repaired, settings, stage_progress)
        found.append(result)
    notes = [] if outcome.unnamed else ["no stage has an unnamed residual that a residual network could describe"]
    return replace(outcome, repaired=repaired, carried=found, notes=[*outcome.notes, *notes])


def _fit_stage(
    case: Case, stage: Stage, left: Unnamed, repaired: Plant, settings: RecurrentSettings | None, progress: Progress
) -> tuple[ResidualModelResult, Plant]:
    """Train the network of one stage and compare the plants with and without it."""
    name, target, split = stage.problem.stage, stage.problem.target, stage.split
    period = left.period if left.period_unit != "s" else 0.0  # over the position of its axis
    plain = repaired.without_residual(name, target)
    problem, model = _problem(plain, case.dataset, name, target)
    (signal,) = problem.signals
    interval = _interval(problem, case.dataset.machine.rate_hz)
    fit, select = ([_window(problem, model, r, period) for r in recordings] for recordings in (split.fit, split.select))
    bound = _bound([*fit, *select], problem.kind.integrates, interval)
    before = _error(problem, model, split.held_out)
    floor = float(problem_floor(problem, model.theta, split.held_out, case.noise, case.seed)[0])
    without = ResidualModelResult(name, target, signal, before, math.nan, floor, False, "", bound)

    def refused(why: str, after: float = math.nan) -> tuple[ResidualModelResult, Plant]:
        return replace(without, after=after, text=f"{stage.label}: {why}"), repaired

    if not bound > 0.0:
        return refused("there is no residual to train on")
    seconds, least = sum(len(problem.rows(r)) / problem.rate(r) for r in split.select), (LEAST_BLOCKS + 1) * BLOCK_S
    if seconds < least:
        return refused(f"no residual network: {seconds:.1f} s of selection recordings, and {least:g} s are needed to test one")
    trained = train_recurrent(fit, select, bound, interval, problem.kind.integrates, settings, case.seed, progress)
    inputs = [n for n, scale in zip(input_names(plain.machine, target), trained.weights["scale"], strict=True) if scale != 0.0]
    origin = {
        "dataset": case.dataset.reference,
        "dataset_digest": case.dataset.digest,
        "plant": case.plant.reference or "nominal",
        "fit": [r.name for r in split.fit],
        "select": [r.name for r in split.select],
        "seed": case.seed,
        "epochs": trained.epochs,
        "inputs": inputs,
    }
    item = Residual(name, target, bound, interval, **trained.weights, origin=origin, period=period)  # type: ignore[arg-type]
    extended = plain.with_residual(item)
    better, loaded = _problem(extended, case.dataset, name, target)
    seen, lower = _error(problem, model, split.select), _error(better, loaded, split.select)
    p_value = _p_value(problem, model.theta, better, loaded.theta, split.select, case.seed)
    if not lower < MAX_SELECTION_RATIO * seen or p_value > MAX_P_VALUE:
        return refused(
            f"a residual network does not predict recordings left out of the fit ({signal} {seen:.3g} → {lower:.3g} "
            f"on the selection recordings, p = {p_value:.2f})"
        )
    after = _error(better, loaded, split.held_out)
    if not after < MAX_HELD_OUT_RATIO * before:
        return refused(f"a residual network did not help on held-out recordings ({signal} {before:.3g} → {after:.3g})", after)
    # A force that fits better may move further off: the free run integrates its errors.
    alone, beside = (run_rmse([(r, case.runner(plant)(r)) for r in split.held_out]) for plant in (plain, extended))
    if worse := [f"{key} {alone[key]:.3g} → {beside[key]:.3g}" for key in alone if beside[key] > TENTH * alone[key]]:
        return refused(f"a residual network makes the free run of held-out recordings worse ({listed(worse)})", after)
    text = f"{stage.label}: {WARNING}; held-out {signal} {before:.3g} → {after:.3g}"
    floor = float(problem_floor(better, loaded.theta, split.held_out, case.noise, case.seed)[0])
    return replace(without, after=after, noise_floor=floor, accepted=True, text=text, inputs=tuple(inputs)), extended


def _problem(plant: Plant, dataset: Dataset, stage: str, target: str) -> tuple[Problem, Model]:
    model = compile_plant(plant)
    (problem,) = [p for p in problems_of(model, dataset) if (p.stage, p.target) == (stage, target)]
    return problem, model


def _error(problem: Problem, model: Model, recordings: Sequence[Recording]) -> float:
    """RMSE of the only output."""
    return float(stage_rmse(problem, model.theta, recordings)[0])


def _interval(problem: Problem, rate_hz: float) -> float:
    """A whole number of samples."""
    wanted = FORCE_INTERVAL if problem.force_filter is not None else INTERVAL
    return max(1, round(wanted * rate_hz)) / rate_hz


def _window(problem: Problem, model: Model, recording: Recording, period: float) -> RecordingWindow:
    """Inputs of the network at each of its evaluations, and its target (or the integral of the target)."""
    axis, rate = model.machine.axis(problem.target), recording.rate_hz
    i, interval = model.axis_index(axis.name), _interval(problem, rate)
    stride = round(interval * rate)
    commands, speed = model.commands_by_step(recording, i), None
    load = gravity_load(model.machine, recording)[:, i]
    if not all(len(model.held(recording, name)[1]) for name in model.machine.axis_names):
        load = np.zeros(len(recording))  # the pose of a free run is unknown; a constant zero disables the input
    if problem.force_filter is not None:
        inputs = force_inputs(recording, axis, problem.force_filter)
        left = np.full(len(recording), np.nan)
        left[inputs.rows] = inputs.force - inputs.model_force(model, model.theta[None], axis.name)[0]
        near = distance_transform_edt(~np.isfinite(left)) <= 2 * stride  # of a row of the comparison
        left = np.where(near, filled(left), np.nan)
        position, commands, load = inputs.position, np.zeros_like(commands), np.zeros(len(recording))
    else:
        predicted = problem.predict(model.theta[None], recording)[0][:, 0]
        left = problem.measured(recording)[:, 0] - predicted
        if axis.driven in problem.signals:
            position = filled(predicted) + gaussian_filter1d(filled(left), 0.5 * SMOOTH * rate, mode="nearest")
            speed = np.append(np.diff(filled(predicted)), 0.0) * rate if problem.kind.integrates else None
        else:
            position, commands = filled(recording.values(axis.driven)), np.zeros_like(commands)
    at = np.arange((len(left) - 1) // stride) * stride
    count, place = len(at), position[at]
    angle = 2.0 * np.pi * place / period if period > 0.0 else np.zeros(count)
    moved = np.diff(place, prepend=place[:1]) / interval
    rows = np.column_stack([commands[at], place, moved, load[at], np.sin(angle), np.cos(angle)])
    if speed is not None:  # the network outputs a share of it
        return RecordingWindow(rows, left[at], interval_means(speed[: count * stride], stride))
    return RecordingWindow(rows, interval_means(left[1 : 1 + count * stride], stride), np.ones(count))


def _bound(parts: Sequence[RecordingWindow], integrates: bool, interval: float) -> float:
    """:data:`BOUND` robust standard deviations of the residual; of its share of the speed where the stage integrates."""
    if not integrates:
        joined = np.concatenate([part.residual for part in parts])
        joined = joined[np.isfinite(joined)]
        return BOUND * robust_scale(joined) if len(joined) else 0.0
    lag, shares = max(1, round(SPEED_WINDOW / interval)), []
    for window in parts:
        moved = interval * np.convolve(window.size, np.ones(lag), mode="valid")[: len(earlier(window.residual, lag))]
        rest = window.residual[lag:] - window.residual[:-lag]
        moving = np.isfinite(rest) & (np.abs(moved) > MIN_SPEED * np.abs(moved).max(initial=0.0))
        shares.append(rest[moving] / moved[moving])
    joined = np.concatenate(shares)
    return min(BOUND * robust_scale(joined), MAX_SPEED_SHARE) if len(joined) else 0.0


def _p_value(before: Problem, theta: Array, after: Problem, other: Array, recordings: Sequence[Recording], seed: int) -> float:
    """p-value of the gain on these recordings: squared errors of blocks, of rates where the stage integrates."""
    gains = []
    for recording in recordings:
        width = max(1, round(BLOCK_S * before.rate(recording)))
        squares = []
        for problem, values in ((before, theta), (after, other)):
            error = problem.residual(values, recording)[:, 0]
            error = error[: len(error) // width * width].reshape(-1, width)
            means = np.nanmean(np.where(np.isfinite(error).any(axis=1, keepdims=True), error, 0.0), axis=1)
            squares.append((np.diff(means) if problem.kind.integrates else means) ** 2)
        gains.append(squares[0] - squares[1])
    return gain_p_value(np.concatenate(gains), seed)
