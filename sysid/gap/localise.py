"""Localisation of the gap: the error of each stage, driven by its measured input, against its noise floor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.gap.problem import Problem
from sysid.gap.result import StageGap
from sysid.gap.unnamed.periodic import resonance_frequencies

Array = npt.NDArray[np.float64]


def localise(
    problems: Sequence[Problem],
    theta: Array,
    recordings: Mapping[int, Sequence[Recording]],
    floors: Mapping[int, Array],
    free: Mapping[str, float],
) -> tuple[StageGap, ...]:
    """One row for each output of each stage.

    Args:
        recordings, floors: by the problem's place in ``problems``.
        free: RMSE of the free run by signal.

    ``share`` is the excess of the output's error over its floor, in floors, relative to the sum over all outputs.
    """
    rows = []
    for k, problem in enumerate(problems):
        if problem.stage == "links":  # the same forces are outputs of the axes' own stages
            continue
        scores = stage_rmse(problem, theta, recordings[k])
        frequencies = resonance_frequencies(problem, theta, recordings[k], floors[k])
        rows += [
            (problem, signal, float(score), float(floor), float(frequency))
            for signal, score, floor, frequency in zip(problem.signals, scores, floors[k], frequencies, strict=True)
        ]
    excess = [max(score / floor - 1.0, 0.0) if floor > 0 else 0.0 for _, _, score, floor, _ in rows]
    total = sum(excess)
    return tuple(
        StageGap(
            p.stage,
            p.target,
            signal,
            score,
            free.get(signal, float("nan")),
            floor,
            part / total if total > 0 else 0.0,
            frequency,
        )
        for (p, signal, score, floor, frequency), part in zip(rows, excess, strict=True)
    )


def stage_rmse(problem: Problem, theta: Array, recordings: Sequence[Recording]) -> Array:
    """RMSE of each output of a stage over some recordings, (d,); NaN where nothing is measured."""
    joined = np.concatenate([problem.measured(r) - problem.predict(theta[None], r)[0] for r in recordings])
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sqrt(np.nansum(joined**2, axis=0) / np.sum(~np.isnan(joined), axis=0)))


def run_rmse(runs: Sequence[tuple[Recording, pd.DataFrame]]) -> dict[str, float]:
    """RMSE by signal, pooled over recordings, of predictions against the measurement."""
    totals: dict[str, float] = {}
    counts: dict[str, int] = {}
    for recording, predicted in runs:
        for signal in predicted.columns:
            if signal == "time":
                continue
            difference = recording.values(str(signal)) - predicted[signal].to_numpy(dtype=np.float64)
            difference = difference[~np.isnan(difference)]
            if len(difference):
                totals[str(signal)] = totals.get(str(signal), 0.0) + float(np.sum(difference**2))
                counts[str(signal)] = counts.get(str(signal), 0) + len(difference)
    return {signal: float(np.sqrt(totals[signal] / counts[signal])) for signal in totals}
