"""Resonance of a speed-commanded drive in the response of its measured speed to the one that the plant predicts.

A load behind a spring follows the speed v of its drive as ω²/(s² + 2ζω·s + ω²)·v. A free run fits this narrow peak only from a
frequency close by, which the response shows: it is compared with a gain, a delay and a lag, which bend it without a peak.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import Bounds, minimize

from sysid.datasets.recording import Recording
from sysid.gap.drive_resonance import DAMPED, DAMPINGS, FREQUENCIES, FROM, LEAST_DAMPED, SEGMENT, SEGMENTS
from sysid.gap.problem import Problem
from sysid.gap.thresholds import PRICE
from sysid.plant.force import highest_force_hz
from sysid.plant.force_band import fourier_segments, octave_sums

Array = npt.NDArray[np.float64]
Spectra = npt.NDArray[np.complex128]

#: Start values of delay and lag of a response without a peak [s].
DELAYS = ((0.0, 0.0), (0.005, 0.002))


@dataclass(frozen=True)
class SpeedResonance:
    """Natural frequency [Hz] and damping ratio of the load on its spring."""

    frequency: float
    damping_ratio: float

    @property
    def parameters(self) -> dict[str, float]:
        """As parameters of the effect ``oil_compressibility``."""
        return {"frequency": self.frequency, "damping_ratio": self.damping_ratio}


@dataclass(frozen=True)
class _Response:
    """Measured over predicted speed (f,) at circular frequencies ``w``, and its inverse standard deviation up to a factor."""

    w: Array
    values: Spectra
    weight: Array

    def left(self, shape: Spectra) -> float:
        """Weighted sum of squares beside the best gain of ``shape``."""
        product = float(np.sum(self.weight**2 * (self.values * shape.conj()).real))
        gain = product / max(float(np.sum((self.weight * np.abs(shape)) ** 2)), 1e-300)
        return float(np.sum((self.weight * np.abs(self.values - gain * shape)) ** 2))

    def late(self, delay: float, lag: float) -> Spectra:
        """Response of a delay and a first-order lag [s]."""
        return np.asarray(np.exp(-1j * self.w * delay) / (1.0 + 1j * self.w * abs(lag)), dtype=np.complex128)

    def peak(self, frequency: float, damping: float) -> Spectra:
        omega = 2.0 * np.pi * frequency
        return np.asarray(omega**2 / (omega**2 - self.w**2 + 2j * damping * omega * self.w), dtype=np.complex128)


def speed_resonance(problem: Problem, recordings: Sequence[Recording], theta: Array, least_hz: float) -> SpeedResonance | None:
    """The resonance of a command stage above ``least_hz``; None where a delay and a lag explain the response about as well.

    It has to divide the squared error that these leave by the price of an effect.
    """
    motions = [r for r in recordings if r.kind == "motion"]
    if not motions or highest_force_hz(motions[0].rate_hz) <= least_hz:
        return None
    response = _response(problem, [r for r in motions if r.rate_hz == motions[0].rate_hz], theta)
    if response is None:
        return None
    highest = highest_force_hz(motions[0].rate_hz)
    grid = [(f, z) for f in np.geomspace(FROM, highest, FREQUENCIES) for z in DAMPINGS]
    start = min(grid, key=lambda pair: response.left(response.peak(*pair)))

    def left_at(x: Array) -> float:
        return response.left(response.peak(float(np.exp(x[0])), float(np.exp(x[1]))) * response.late(x[2], x[3]))

    def left_without(x: Array) -> float:
        return response.left(response.late(x[0], x[1]))

    # Without a peak the error falls forever towards one that is far away or flat.
    low = np.array([np.log(FROM / 10.0), np.log(LEAST_DAMPED / 10.0), -np.inf, -np.inf])
    high = np.array([np.log(10.0 * highest), np.log(100.0), np.inf, np.inf])
    begin, ends = [*np.log(start), 0.0, 0.0], Bounds(low, high)
    found = minimize(left_at, begin, method="Nelder-Mead", bounds=ends, options={"maxiter": 1000})
    frequency, damping = float(np.exp(found.x[0])), max(float(np.exp(found.x[1])), LEAST_DAMPED)
    smooth = min(float(minimize(left_without, first, method="Nelder-Mead").fun) for first in DELAYS)
    if not (least_hz < frequency < highest and damping < DAMPED) or smooth < PRICE * found.fun:
        return None
    return SpeedResonance(frequency, damping)


def _response(problem: Problem, recordings: Sequence[Recording], theta: Array) -> _Response | None:
    """Averaged response; None where the recordings are too short or interrupted."""
    rate = recordings[0].rate_hz
    length = round(min(SEGMENT * rate, max(len(r) for r in recordings) / SEGMENTS))
    parts = []
    for recording in recordings:
        pair = np.column_stack([problem.predict(theta[None], recording)[0][:, 0], problem.measured(recording)[:, 0]])
        if len(pair) > length and not np.isnan(pair).any():
            parts.append(fourier_segments(np.diff(pair, axis=0), length))
    if not parts:
        return None
    segments = np.concatenate(parts)
    frequency: Array = np.fft.rfftfreq(length, 1.0 / rate).astype(np.float64)
    band = (frequency >= FROM) & (frequency <= highest_force_hz(rate))
    if len(segments) < SEGMENTS or band.sum() < 2 * SEGMENTS:
        return None
    predicted = np.maximum((np.abs(segments[:, :, 0]) ** 2).sum(axis=0), 1e-300)
    cross = (segments[:, :, 1] * segments[:, :, 0].conj()).sum(axis=0)
    noise = octave_sums(frequency, (np.abs(segments[:, :, 1]) ** 2).sum(axis=0) - np.abs(cross) ** 2 / predicted)
    noise /= np.maximum(octave_sums(frequency, np.ones(len(frequency))), 1.0)
    weight = np.sqrt(predicted / np.maximum(noise, 1e-9 * float(noise.max()) + 1e-300))
    return _Response(2.0 * np.pi * frequency[band], (cross / predicted)[band], weight[band])
