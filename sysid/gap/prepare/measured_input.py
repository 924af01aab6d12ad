"""The measured input of a stage, estimated from its samples and from the commands (errors in variables).

A stage behind the drives is driven by measured signals. Backlash acts by the extremes of its input, and the noise of a sensor
makes these larger: driven by the samples of a sensor with a noise of a third of the width, it was estimated 60 to 90 %
too wide.
The input is therefore estimated as

    x_k = prediction_k + level_k + noise_k,        level_{k+1} = level_k + a random step that grows with the motion

smoothed over the whole recording (:mod:`sysid.gap.drift`). The prediction is the free run of the simulation under test from the
commands, or none, whichever makes the samples likelier: what the simulation lacks is in the level, and a simulation that is far
off predicts nothing.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.gap.drift import DriftStrength, estimate_drift, smooth_level
from sysid.gap.problem import Problem

Array = npt.NDArray[np.float64]

#: Time over which the speed of a signal is averaged where nothing predicts it [s].
SPEED_OVER = 0.3
#: Least number of samples from which the strength of a level is estimated.
LEAST_SAMPLES = 50


@dataclass
class MeasuredInput:
    """Recording → the same recording with estimated input signals; missing samples stay missing, static poses as they are.

    Args:
        noise: standard deviation by signal; signals without one stay as they are.
        run: free run of the simulation under test; None where it is a user's simulator.

    The strength of a level is estimated once by recording name, so that copies with added noise are treated alike.
    """

    signals: tuple[str, ...]
    noise: Mapping[str, float]
    run: Callable[[Recording], pd.DataFrame] | None = None
    _strengths: dict[tuple[str, str], tuple[bool, DriftStrength]] = field(default_factory=dict)
    _known: dict[int, tuple[weakref.ref[Recording], Recording]] = field(default_factory=dict)

    def __call__(self, recording: Recording) -> Recording:
        known = self._known.get(id(recording))
        if known is None or known[0]() is not recording:
            key = id(recording)
            known = weakref.ref(recording, lambda _: self._known.pop(key, None)), self._estimated(recording)
            self._known[key] = known
        return known[1]

    def _estimated(self, recording: Recording) -> Recording:
        names = [name for name in self.signals if name in recording.signals and self.noise.get(name, 0.0) > 0.0]
        if recording.kind != "motion" or not names:
            return recording
        predicted = self.run(recording) if self.run is not None else pd.DataFrame()
        found = {}
        for name in names:
            prediction = predicted[name].to_numpy() if name in predicted else None
            found[name] = self._signal(recording, name, prediction)
        return replace(recording, table=recording.table.assign(**found))

    def _signal(self, recording: Recording, name: str, prediction: Array | None) -> Array:
        values, noise = recording.values(name), self.noise[name]
        if int((~np.isnan(values)).sum()) < LEAST_SAMPLES:
            return values
        alone = _without_prediction(values, recording.rate_hz)
        parts = {False: alone}
        if prediction is not None and not np.isnan(prediction).any():
            parts[True] = prediction, _of_mean_one(np.abs(np.gradient(prediction)))
        key = recording.name, name
        if key not in self._strengths:
            fits = {k: estimate_drift([(values - base) / noise], [activity]) for k, (base, activity) in parts.items()}
            best = max(fits, key=lambda k: fits[k][1])
            self._strengths[key] = best, fits[best][0]
        by_prediction, strength = self._strengths[key]
        base, activity = parts.get(by_prediction, alone)
        return np.asarray(base + noise * smooth_level((values - base) / noise, activity, strength))


def _without_prediction(values: Array, rate_hz: float) -> tuple[Array, Array]:
    """A constant in place of a prediction, and the square of the speed: steps of a path in motion grow with the speed."""
    there = np.flatnonzero(~np.isnan(values))
    path = np.interp(np.arange(len(values)), there, values[there])
    width = max(1, round(SPEED_OVER * rate_hz))
    padded = np.pad(path, (width // 2, width - 1 - width // 2), mode="edge")
    speed = np.gradient(np.convolve(padded, np.full(width, 1.0 / width), mode="valid"))
    return np.full(len(values), values[there[0]]), _of_mean_one(speed**2)


def _of_mean_one(activity: Array) -> Array:
    mean = float(activity.mean())
    return activity / mean if mean > 0.0 else np.ones(len(activity))


def with_measured_input(
    problem: Problem, noise: Mapping[str, float], run: Callable[[Recording], pd.DataFrame] | None
) -> Problem:
    """The problem driven by the estimates of its measured inputs; itself where it has none."""
    if not problem.inputs:
        return problem
    estimated = MeasuredInput(problem.inputs, noise, run)
    predict = lambda thetas, recording: problem.predict(thetas, estimated(recording))  # noqa: E731
    return replace(problem, predict=predict, estimated=estimated, by_estimates=problem)
