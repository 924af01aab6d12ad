"""Noise of each measured signal, and the noise floor that it leaves of the outputs of a stage or of a whole run.

Noise is that of the data sheet in the machine description, else from the data: the larger of the white noise
(:func:`sysid.datasets.quality.noise.white_noise`) and the error of rounding to the steps of the sensor. An estimate is accepted
if it is a plausible share of the range of motion; where the motion is too fast for the rate, or only static poses contain the
signal, the best bound is used.

A noise floor is the RMSE of the true model in the same run, with sensor noise and errors of the initial state propagated. An
estimate of the noise may contain more than noise (vibration, jitter of stamps), and then hides effects. The floor of a force is
therefore at most what its recordings leave: the residual of a regression on friction, inertia and every smooth function of the
discrepancy contains the noise and what these functions lack.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.checks.roles import is_pose_set
from sysid.datasets.quality.noise import is_still, noise_bound, white_noise
from sysid.datasets.recording import Dataset, Recording
from sysid.gap.arm.forces import ROWS_PER_COLUMN, fitted, friction_columns
from sysid.gap.likelihood.discrepancy.drives import force_columns
from sysid.gap.prepare.resolution import reading_step, rounding
from sysid.gap.problem import Problem
from sysid.gap.statement import FloorSource
from sysid.gap.thresholds import TENTH
from sysid.machine import Machine
from sysid.plant import Model
from sysid.plant.force import force_inputs
from sysid.plant.link_torque import link_torque
from sysid.signals import axis_signal, split_signal

Array = npt.NDArray[np.float64]
Predict = Callable[[Recording], pd.DataFrame]

#: Largest plausible noise, as a share of the range of motion (larger values are motion); least range of motion, as a share of
#: that of the axis (a smaller range may be noise).
PLAUSIBLE, UNMOVED = 0.01, 0.02
#: Largest plausible noise of a speed, which is noisier than a position, as a share of its range.
PLAUSIBLE_SPEED = 0.1
#: Assumed noise as a share of the range: at static poses without repeats, and of a signal without scatter (a simulation, or an
#: axis at rest).
OF_POSES, OF_NO_SCATTER = 1e-3, 1e-6
#: Scatter of values that are the same to the last digit, as a share of their size.
LAST_DIGIT = 10.0 * float(np.finfo(np.float64).eps)
#: Static poses are repeats if all other signals agree to this share of their range; least number of repeats for an estimate.
SAME_POSE, REPEATS = 1e-3, 5
#: Noisy copies of the recordings over which the propagation is averaged, and from which its spread is estimated.
DRAWS, SPREAD_DRAWS = 3, 16
#: Residual that is rounding [share of the error]: the columns contain all of it, where the logged force is constant.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Noise:
    """Standard deviation of the noise of a signal [SI], and how it is known."""

    level: float
    source: FloorSource


def noise_levels(dataset: Dataset) -> dict[str, float]:
    """Signal → standard deviation of its noise, see :func:`noise_of_signals`."""
    return {signal: noise.level for signal, noise in noise_of_signals(dataset).items()}


def noise_of_signals(dataset: Dataset) -> dict[str, Noise]:
    """The noise of every measured signal; a command has none unless the data sheet says so (a force).

    Without a data sheet: what ingest found in the sensor's own samples, else in the recordings' tables.
    """
    sheet = dataset.machine.noise
    signals = sorted({s for r in dataset.recordings for s in r.signals})
    measured = [s for s in signals if s in sheet or split_signal(s)[1] != "command"]
    return {s: Noise(sheet[s], "stated") if s in sheet else _from_data(dataset, s) for s in measured}


def _from_data(dataset: Dataset, signal: str) -> Noise:
    recordings = [r for r in dataset.recordings if signal in r.signals]
    moving = [r for r in recordings if r.kind == "motion"]
    span = max((_range(r.values(signal)) for r in recordings), default=0.0)
    limits = _limits(dataset.machine, signal)
    plausible = (PLAUSIBLE_SPEED if split_signal(signal)[1] == "speed" else PLAUSIBLE) * span
    most = plausible if span > UNMOVED * limits or limits == 0.0 else math.inf
    found = _of_samples(dataset, signal, moving or recordings, most if moving else plausible)
    if found is None:
        resting = is_pose_set(dataset) and split_signal(signal)[1] == "joint"
        found = _of_tables(moving, signal, most) if moving else _of_poses(recordings, signal, span, resting)
    step = rounding(reading_step([r.values(signal) for r in moving]))
    if found.level < step:
        found = Noise(step, "above_bandwidth")
    return replace(found, level=max(found.level, OF_NO_SCATTER * max(span, limits), 1e-12))


def _of_samples(dataset: Dataset, signal: str, recordings: list[Recording], most: float) -> Noise | None:
    """Plausible estimates by ingest from the samples of the sensor; median of the recordings."""
    quality = dataset.quality.get("recordings", {})
    found = [quality.get(r.name, {}).get("signals", {}).get(signal, {}).get("noise") for r in recordings]
    levels = [v for v in found if v is not None and math.isfinite(v) and 0.0 < v <= most]
    return Noise(float(np.median(levels)), "above_bandwidth") if levels else None


def _of_tables(moving: list[Recording], signal: str, most: float) -> Noise:
    """White noise in tables of motion, else its bound, at most a plausible share of the range.

    A motion that is too fast for the rate and stands still most of the time, to the last digit, bounds nothing by its median:
    what is plausible is left.
    """
    parts = [(r.values(signal), r.rate_hz) for r in moving if not is_still(r.values(signal))]
    whites = [white_noise(values, rate) for values, rate in parts]
    if levels := [level for level in whites if level <= most]:
        return Noise(float(np.median(levels)), "above_bandwidth")
    open_ = most if math.isfinite(most) else 0.0
    bounds = [(bound, float(np.nanmax(np.abs(values)))) for values, _ in parts if math.isfinite(bound := noise_bound(values))]
    levels = [bound if bound > LAST_DIGIT * size else open_ for bound, size in bounds]
    return Noise(min(float(np.median(levels)), most) if levels else 0.0, "unknown")


def _of_poses(recordings: list[Recording], signal: str, span: float, resting: bool) -> Noise:
    """Scatter among static poses that are repeats in all other signals; without repeats an assumed share of the range.

    ``resting``: a joint of which only poses are known; the scatter of its sensor at rest is left to that of the tip, as an
    assumed one would hide every effect of a wrist.
    """
    differences = [np.empty(0)]
    for recording in recordings:
        others = [name for name in recording.signals if name != signal and split_signal(name)[1] != "command"]
        if len(recording) < 2 or not others:
            continue
        table = np.column_stack([recording.values(name) for name in others])
        ranges = np.nanmax(table, axis=0, initial=-np.inf) - np.nanmin(table, axis=0, initial=np.inf)
        first, second = np.triu_indices(len(recording), 1)
        same = (np.abs(table[first] - table[second]) <= SAME_POSE * ranges).all(axis=1)
        values = recording.values(signal)
        differences.append((values[first] - values[second])[same])
    found = np.concatenate(differences)
    found = found[~np.isnan(found)]
    if len(found) >= REPEATS:
        return Noise(float(np.sqrt(np.mean(found**2) / 2.0)), "rest")
    return Noise(0.0 if resting else OF_POSES * span, "unknown")


def _range(values: Array) -> float:
    known = values[~np.isnan(values)]
    return float(np.ptp(known)) if len(known) else 0.0


def _limits(machine: Machine, signal: str) -> float:
    """Range of the axis of a signal [SI]; zero if unknown, for points and for speeds."""
    owner, quantity = split_signal(signal)
    if owner not in machine.axis_names or quantity == "speed":
        return 0.0
    axis = machine.axis(owner)
    ends = axis.limits if signal == axis_signal(owner, "joint") else axis.range
    return float(ends[1] - ends[0]) if ends is not None and np.isfinite(ends).all() else 0.0


def problem_floor(
    problem: Problem, theta: Array, recordings: Sequence[Recording], noise: Mapping[str, float], seed: int
) -> Array:
    """RMSE of the stage's outputs if ``theta`` were true, (d,): see :func:`problem_floors`."""
    return problem_floors([(problem, theta, recordings)], noise, seed)[0]


def problem_floors(
    stages: Sequence[tuple[Problem, Array, Sequence[Recording]]], noise: Mapping[str, float], seed: int
) -> list[Array]:
    """RMSE of the outputs of each stage if its parameters were true, (d,) each.

    Residual on copies with additional noise on every measured signal, less the residual on the recordings: the effect of noise
    in output, inputs and initial state, through the filters of the stage. All stages see the same copies, of which there is one
    at a time.
    """
    totals, counts = [np.zeros(len(problem.signals)) for problem, _, _ in stages], np.zeros(len(stages))
    users = dict[int, tuple[Recording, list[int]]]()
    for k, (_, _, recordings) in enumerate(stages):
        for recording in recordings:
            users.setdefault(id(recording), (recording, []))[1].append(k)
    for recording, here in users.values():
        clean = {k: stages[k][0].residual(stages[k][1], recording) for k in here}
        for noisy in _copies(recording, noise, DRAWS, seed):
            for k in here:
                difference = stages[k][0].residual(stages[k][1], noisy) - clean[k]
                there = ~np.isnan(difference).any(axis=1)
                totals[k] += (difference[there] ** 2).sum(axis=0)
                counts[k] += int(there.sum())
    return [np.asarray(np.sqrt(total / max(count, 1))) for total, count in zip(totals, counts, strict=True)]


def run_floors(
    predict: Predict,
    runs: Sequence[tuple[Recording, pd.DataFrame]],
    noise: Mapping[str, float],
    seed: int,
    forces: Sequence[str] = (),
) -> tuple[dict[str, float], list[dict[str, float]]]:
    """The noise floor of every signal of whole runs (free or stage by stage): of all together, and of each.

    Args:
        runs: recordings with what ``predict`` makes of them.
        forces: commands of force axes. A log does not say when within a row they acted, and a free run integrates them twice:
            the floor contains the error of half a row.
    """
    sums = []
    for recording, clean in runs:
        own: dict[str, tuple[float, int]] = {}
        for copy in _copies(recording, noise, DRAWS, seed):
            noisy = predict(_half_a_row_later(copy, forces))
            for signal in clean.columns.drop("time", errors="ignore"):
                difference = noisy[signal].to_numpy() - clean[signal].to_numpy()
                difference = difference[~np.isnan(difference)]
                total, count = own.get(signal, (0.0, 0))
                own[signal] = total + float(np.sum(difference**2)), count + len(difference)
        sums.append(own)

    def floor(signal: str, parts: Sequence[tuple[float, int]]) -> float:
        total, count = (sum(column) for column in zip(*parts, strict=True))
        return float(np.sqrt(noise.get(signal, 0.0) ** 2 + total / max(count, 1)))

    signals = dict.fromkeys(signal for own in sums for signal in own)
    whole = {signal: floor(signal, [own[signal] for own in sums if signal in own]) for signal in signals}
    return whole, [{signal: floor(signal, [part]) for signal, part in own.items()} for own in sums]


def floor_spread(predict: Predict, recordings: Sequence[Recording], noise: Mapping[str, float], seed: int) -> dict[str, float]:
    """Standard deviation by signal of the RMSE of the true model in one run over all recordings, about :func:`run_floors`."""
    totals: dict[str, Array] = {}
    counts: dict[str, int] = {}
    for recording in recordings:
        clean = predict(recording)
        for draw, noisy in enumerate(_copies(recording, noise, SPREAD_DRAWS, seed, 1)):
            run = predict(noisy)
            for signal in map(str, clean.columns.drop("time", errors="ignore")):
                moved = run[signal].to_numpy() - clean[signal].to_numpy()
                noise_added = noisy.values(signal) - recording.values(signal)
                error = np.where(np.isnan(noise_added), moved, moved - noise_added)
                error = error[~np.isnan(error)]
                totals.setdefault(signal, np.zeros(SPREAD_DRAWS))[draw] += float(np.sum(error**2))
                counts[signal] = counts.get(signal, 0) + (len(error) if draw == 0 else 0)
    return {s: float(np.std(np.sqrt(totals[s] / max(counts[s], 1)), ddof=1)) for s in totals}


def _copies(recording: Recording, noise: Mapping[str, float], draws: int, *seed: int) -> Iterator[Recording]:
    for draw in range(draws):
        yield with_noise(recording, noise, np.random.default_rng([*seed, draw]))


def with_noise(recording: Recording, noise: Mapping[str, float], generator: np.random.Generator) -> Recording:
    """A copy with white noise of the given standard deviation on every measured signal.

    A reading equal to the one before keeps its error, since the error of a coarse sensor is constant at rest.
    """
    table = recording.table.copy()
    for signal in recording.signals:
        if signal in noise:
            values = recording.values(signal)
            fresh = np.cumsum(values[1:] != values[:-1])
            table[signal] = values + generator.normal(0.0, noise[signal], len(values))[np.concatenate([[0], fresh])]
    return replace(recording, table=table)


def _half_a_row_later(recording: Recording, signals: Sequence[str]) -> Recording:
    """A copy in which some signals are halfway to the row before."""
    late = {signal: recording.values(signal) for signal in signals if signal in recording.signals}
    halfway = {signal: 0.5 * (values + np.concatenate([values[:1], values[:-1]])) for signal, values in late.items()}
    return replace(recording, table=recording.table.assign(**halfway)) if late else recording


def shown_floor(model: Model, problem: Problem, recordings: Sequence[Recording], theta: Array, sigma: Array) -> Array:
    """The noise floor ``sigma`` (d,) of a stage; of a force [N or N·m], less where the recordings leave clearly less.

    Args:
        theta: vector of the plant, the links of an arm adjusted.
    """
    if problem.force_filter is None:
        return sigma
    axis = model.machine.axis(problem.target)
    smooth = force_columns(model, problem, recordings, theta)
    columns, target = list[Array](), list[Array]()
    for recording in recordings:
        inputs = force_inputs(recording, axis, problem.force_filter, problem.rows(recording))
        load = link_torque(model, theta, recording, axis.name).carried
        rigid = inputs.compared(friction_columns(inputs.speed, inputs.acceleration, load))
        moving = ~inputs.rests[inputs.rows]  # at rest the measured force stands for the model's, and leaves nothing
        columns.append(np.hstack([rigid, *(part[:, :, 0] for part in smooth(recording).values())])[moving])
        target.append(problem.residual(theta, recording)[moving, 0])
    table, force = np.concatenate(columns), np.concatenate(target)
    if len(force) < ROWS_PER_COLUMN * table.shape[1]:
        return sigma
    _, bound = fitted(table, force)
    least = ROUNDING * float(np.sqrt(np.mean(force**2)))
    return np.array([bound]) if least < bound and bound * TENTH < float(sigma[0]) else sigma
