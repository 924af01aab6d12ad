"""Noise floor: RMSE of the true model in the same run, with sensor noise and errors of the initial state propagated."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.gap.problem import Problem

Array = npt.NDArray[np.float64]
Predict = Callable[[Recording], pd.DataFrame]

#: Noisy copies of the recordings over which the propagation is averaged.
DRAWS = 3


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
    every, users = dict[int, Recording](), dict[int, list[int]]()
    for k, (_, _, recordings) in enumerate(stages):
        for recording in recordings:
            every[id(recording)] = recording
            users.setdefault(id(recording), []).append(k)
    for key, recording in every.items():
        here = users[key]
        clean = {k: _error(*stages[k][:2], recording) for k in here}
        for draw in range(DRAWS):
            noisy = with_noise(recording, noise, np.random.default_rng([seed, draw]))
            for k in here:
                difference = _error(*stages[k][:2], noisy) - clean[k]
                there = ~np.isnan(difference).any(axis=1)
                totals[k] += (difference[there] ** 2).sum(axis=0)
                counts[k] += int(there.sum())
    return [np.asarray(np.sqrt(total / max(count, 1))) for total, count in zip(totals, counts, strict=True)]


def _error(problem: Problem, theta: Array, recording: Recording) -> Array:
    return np.asarray(problem.measured(recording) - problem.predict(theta[None], recording)[0])


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
        for draw in range(DRAWS):
            noisy = predict(_half_a_row_later(with_noise(recording, noise, np.random.default_rng([seed, draw])), forces))
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


def floor_spread(
    predict: Predict, recordings: Sequence[Recording], noise: Mapping[str, float], seed: int, draws: int = 16
) -> dict[str, float]:
    """Standard deviation by signal of the RMSE of the true model in one run over all recordings, about :func:`run_floors`."""
    totals: dict[str, Array] = {}
    counts: dict[str, int] = {}
    for recording in recordings:
        clean = predict(recording)
        for draw in range(draws):
            noisy = with_noise(recording, noise, np.random.default_rng([seed, 1, draw]))
            run = predict(noisy)
            for signal in map(str, clean.columns):
                if signal == "time":
                    continue
                moved = run[signal].to_numpy() - clean[signal].to_numpy()
                noise_added = noisy.values(signal) - recording.values(signal)
                error = np.where(np.isnan(noise_added), moved, moved - noise_added)
                error = error[~np.isnan(error)]
                totals.setdefault(signal, np.zeros(draws))[draw] += float(np.sum(error**2))
                counts[signal] = counts.get(signal, 0) + (len(error) if draw == 0 else 0)
    return {s: float(np.std(np.sqrt(totals[s] / max(counts[s], 1)), ddof=1)) for s in totals}


def _half_a_row_later(recording: Recording, signals: Sequence[str]) -> Recording:
    """A copy in which some signals are halfway to the row before."""
    late = {signal: recording.values(signal) for signal in signals if signal in recording.signals}
    if not late:
        return recording
    halfway = {signal: 0.5 * (values + np.concatenate([values[:1], values[:-1]])) for signal, values in late.items()}
    return replace(recording, table=recording.table.assign(**halfway))


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
