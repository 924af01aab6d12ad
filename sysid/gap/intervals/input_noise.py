"""Effect of noise in the measured input of a stage on its fit: parameters are shifted and scattered, and no residual shows it.

Backlash is estimated too wide, since the noise of its input crosses it; noise of the tip sustains a swing. The stage is run on
the estimate of its input (:mod:`sysid.gap.prepare.measured_input`; of a force, on its smoothed motion). Noise is added
repeatedly, and the parameters that then fit best are compared with those that generated the output (indirect inference:
Gouriéroux, Monfort & Renault, J. Applied Econometrics 8 (1993)). The noise that remains in the estimate is not corrected.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import signal as filters

from sysid.datasets.recording import Recording
from sysid.gap.intervals.criterion import Criterion, Curvature
from sysid.gap.likelihood.discrepancy.shapes import filled
from sysid.signals import split_signal

Array = npt.NDArray[np.float64]

#: Copies of the recordings with fresh noise, and rounds that determine the shift.
DRAWS, ROUNDS = 12, 3
#: A round whose steps are below this share of a standard error is the last.
CONVERGED = 1.0
#: Cut-offs of the smoothing [Hz], of which the lowest is used whose residual is at most this multiple of the noise.
CUTOFFS, NOISE_RATIO = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0, 14.0, 20.0), 1.02


@dataclass(frozen=True)
class InputNoise:
    """Effect of the noise of the input on a fit.

    Args:
        shift: of each parameter (k,); ``deviation``: its standard deviation.
        covariance: scatter of the parameters (k, k).
        share: of the variance of the residuals.
    """

    shift: Array
    deviation: Array
    covariance: Array
    share: float


def input_noise(
    criterion: Criterion, curvature: Curvature, values: Array, noise: Mapping[str, float], seed: int
) -> InputNoise | None:
    """Effect on a fit at ``values`` (k,); None where the stage has no measured input with noise."""
    problem = criterion.data.problem
    if problem.kind.commanded:
        return None
    inputs = {s: level for s, level in noise.items() if s not in problem.signals and split_signal(s)[1] != "command"}
    estimated = problem.estimated if problem.by_estimates is not None else lambda recording: smoothed(recording, inputs)
    smooth = [estimated(recording) for recording in criterion.data.recordings]

    def copies(draw: int) -> list[Recording]:
        """The same in every round; generated again to save memory."""
        rng = np.random.default_rng([seed, 7, draw])
        return [_noisy(recording, inputs, rng) for recording in smooth]

    shift, steps, errors = np.zeros(len(values)), np.zeros((DRAWS, len(values))), np.empty(0)
    true = values
    for _ in range(ROUNDS):
        made = criterion.predicted(true, smooth)
        lanes = np.clip(true + shift, criterion.low, criterion.high)
        errors = np.stack([criterion.between(made, criterion.predicted(lanes, copy)) for copy in map(copies, range(DRAWS))])
        steps = -((criterion.weights(errors) * errors) @ curvature.slopes) @ curvature.inverse
        shift = shift + steps.mean(axis=0)
        true = np.clip(values - shift, criterion.low, criterion.high)
        if (np.abs(steps.mean(axis=0)) < CONVERGED * curvature.deviations).all():
            break
    share = float(np.mean(errors**2)) / max(float(np.mean(curvature.errors**2)), 1e-12)
    scatter = np.atleast_2d(np.cov(steps.T))
    return InputNoise(shift, np.sqrt(np.diag(scatter) / DRAWS), scatter, min(share, 1.0))


def smoothed(recording: Recording, inputs: Mapping[str, float]) -> Recording:
    """The recording with its input signals low-passed forward and backward, missing rows as they were."""
    table = recording.table.copy()
    for name, level in inputs.items():
        if name in recording.signals:
            table[name] = _smooth(recording.values(name), level, recording.rate_hz)
    return replace(recording, table=table)


def _smooth(values: Array, level: float, rate_hz: float) -> Array:
    there = ~np.isnan(values)
    if level <= 0.0 or int(there.sum()) < 50:
        return values
    path = filled(values)
    for cutoff in CUTOFFS:
        if cutoff >= 0.4 * rate_hz:
            break
        low_pass = filters.butter(2, cutoff, fs=rate_hz, output="sos")
        smooth = filters.sosfiltfilt(low_pass, path)
        if np.std((smooth - values)[there]) <= NOISE_RATIO * level:
            return np.where(there, smooth, np.nan)
    return values


def _noisy(recording: Recording, inputs: Mapping[str, float], rng: np.random.Generator) -> Recording:
    table = recording.table.copy()
    for name, level in inputs.items():
        if name in recording.signals:
            table[name] = recording.values(name) + rng.normal(0.0, level, len(table))
    return replace(recording, table=table)
