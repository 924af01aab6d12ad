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
    """RMSE of the stage's outputs if ``theta`` were true, (d,).

    Residual on copies with additional noise on every measured signal, less the residual on the recordings: the effect of noise
    in output, inputs and initial state, through the filters of the stage.
    """
    totals, count = np.zeros(len(problem.signals)), 0
    for recording in recordings:
        clean = problem.measured(recording) - problem.predict(theta[None], recording)[0]
        for draw in range(DRAWS):
            noisy = with_noise(recording, noise, np.random.default_rng([seed, draw]))
            difference = problem.measured(noisy) - problem.predict(theta[None], noisy)[0] - clean
            there = ~np.isnan(difference).any(axis=1)
            totals += (difference[there] ** 2).sum(axis=0)
            count += int(there.sum())
    return np.asarray(np.sqrt(totals / max(count, 1)))


def run_floor(predict: Predict, recordings: Sequence[Recording], noise: Mapping[str, float], seed: int) -> dict[str, float]:
    """The noise floor of every signal of a whole run (free or stage by stage)."""
    totals: dict[str, float] = {}
    counts: dict[str, int] = {}
    for recording in recordings:
        clean = predict(recording)
        for draw in range(DRAWS):
            noisy = predict(with_noise(recording, noise, np.random.default_rng([seed, draw])))
            for signal in clean.columns:
                difference = noisy[signal].to_numpy() - clean[signal].to_numpy()
                difference = difference[~np.isnan(difference)]
                totals[signal] = totals.get(signal, 0.0) + float(np.sum(difference**2))
                counts[signal] = counts.get(signal, 0) + len(difference)
    return {s: float(np.sqrt(noise.get(s, 0.0) ** 2 + totals[s] / max(counts[s], 1))) for s in totals if s != "time"}


def floor_spread(
    predict: Predict, recordings: Sequence[Recording], noise: Mapping[str, float], seed: int, draws: int = 16
) -> dict[str, float]:
    """Standard deviation by signal of the RMSE of the true model in one run over all recordings, about :func:`run_floor`."""
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
