"""What noise in the measured input of a stage does to its fit: it shifts and scatters parameters, and no residual shows it.

A play seems wider than it is, since its input's noise crosses it; a swing is kept alive by the noise of the tip. The stage is
run on its input smoothed as far as the sensor's noise allows; to that, noise is added again and again, and the parameters that
then fit best are compared with those that made the output (indirect inference: Gouriéroux, Monfort & Renault, J. Applied
Econometrics 8 (1993)). One effect of the noise stays in: what is left of it in the smoothed input.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import signal as filters

from sysid.datasets.recording import Recording
from sysid.gap.intervals.criterion import Criterion
from sysid.gap.intervals.curvature import Curvature
from sysid.signals import split_signal

Array = npt.NDArray[np.float64]

#: Copies of the recordings with fresh noise, and rounds in which the shifted values are found.
DRAWS, ROUNDS = 12, 3
#: A round that moves everything by less than this share of a standard error is the last.
SLIGHT = 1.0
#: Cut-offs of the smoothing [Hz]; the lowest that leaves no more than the noise (and this share) is taken.
CUTOFFS, ALLOWED = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0, 14.0, 20.0), 1.02


@dataclass(frozen=True)
class InputNoise:
    """Effect of the input's noise on a fit.

    Args:
        shift: what it adds to each parameter (k,); ``unsure``: standard deviation of that.
        covariance: its scatter (k, k).
        share: its part of the variance of the residuals.
    """

    shift: Array
    unsure: Array
    covariance: Array
    share: float


def input_noise(
    criterion: Criterion, curvature: Curvature, values: Array, noise: Mapping[str, float], seed: int
) -> InputNoise | None:
    """Of a fit at ``values`` (k,); None where the stage has no measured input with noise."""
    problem = criterion.data.problem
    if problem.stage == "command":  # its input is what was sent
        return None
    inputs = {s: level for s, level in noise.items() if s not in problem.signals and split_signal(s)[1] != "command"}
    smooth = [smoothed(recording, inputs) for recording in criterion.data.recordings]

    def copies(draw: int) -> list[Recording]:
        """The same in every round; made anew, since all of them together take twelve times the memory of the recordings."""
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
        if (np.abs(steps.mean(axis=0)) < SLIGHT * curvature.deviations).all():
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
    there = np.flatnonzero(~np.isnan(values))
    if level <= 0.0 or len(there) < 50:
        return values
    filled = np.interp(np.arange(len(values)), there, values[there])
    for cutoff in CUTOFFS:
        if cutoff >= 0.4 * rate_hz:
            break
        low_pass = filters.butter(2, cutoff, fs=rate_hz, output="sos")
        smooth = filters.sosfiltfilt(low_pass, filled)
        if np.std((smooth - values)[there]) <= ALLOWED * level:
            return np.where(np.isnan(values), np.nan, smooth)
    return values


def _noisy(recording: Recording, inputs: Mapping[str, float], rng: np.random.Generator) -> Recording:
    table = recording.table.copy()
    for name, level in inputs.items():
        if name in recording.signals:
            table[name] = recording.values(name) + rng.normal(0.0, level, len(table))
    return replace(recording, table=table)
