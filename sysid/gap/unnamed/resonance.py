"""Resonance in a residual: a clear peak in its spectrum (a swinging tool, oil compressibility, a flexible boom)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.likelihood.discrepancy.shapes import filled
from sysid.gap.problem import Problem

Array = npt.NDArray[np.float64]

#: Length of the segments over which spectra are averaged [s]: a frequency resolution of 0.05 Hz.
SEGMENT = 20.0
#: Below this frequency [Hz] drift and motion look like an oscillation.
MIN_FREQUENCY = 0.2
#: A peak with less than this share of the power of the simulated motion at that frequency is attributed to the motion.
MIN_POWER_RATIO = 0.25
#: Half-width of a peak relative to its frequency, and least share of the power above the minimum frequency that it contains.
WIDTH, MIN_SHARE = 0.15, 0.5


def resonance_frequencies(problem: Problem, theta: Array, recordings: Sequence[Recording], sigma: Array) -> Array:
    """Resonance frequency of the residual of each output [Hz], (d,); zero where there is none, or within noise ``sigma``.

    Averaged periodograms (Welch, IEEE Trans. Audio Electroacoust. 15 (1967)) of all stretches that are measured without gaps.
    """
    from scipy.signal import welch

    found = np.zeros(len(problem.signals))
    parts = []
    for recording in (r for r in recordings if r.kind == "motion"):
        simulated = problem.predict(theta[None], recording)[0]
        parts.append((problem.rate(recording), simulated, problem.measured(recording) - simulated))
    if not parts:
        return found
    rate_hz = parts[0][0]
    length = round(SEGMENT * rate_hz)
    for k in range(len(found)):
        spectra, of_motion, rows, square = [], [], 0, 0.0
        for rate, simulated, residual in parts:
            if abs(rate - rate_hz) > 1e-6 * rate_hz:
                continue
            for stretch in _stretches(residual[:, k]):
                if stretch.stop - stretch.start < length // 2:
                    continue
                piece, motion = (_bridged(values[stretch, k]) for values in (residual, simulated))
                frequency, power = welch(piece, rate_hz, nperseg=min(length, len(piece)), nfft=length)
                _, moved = welch(motion, rate_hz, nperseg=min(length, len(piece)), nfft=length)
                spectra.append(len(piece) * power)
                of_motion.append(len(piece) * moved)
                rows, square = rows + len(piece), square + float(piece @ piece)
        if rows and square / rows > (2.0 * float(sigma[k])) ** 2:
            found[k] = _peak(frequency, np.sum(spectra, axis=0), np.sum(of_motion, axis=0))
    return found


def _peak(frequency: Array, power: Array, motion: Array) -> float:
    """Frequency of the highest peak if it contains most of the power and is not due to the motion, else zero."""
    above = frequency >= MIN_FREQUENCY
    top = float(frequency[above][np.argmax(power[above])])
    near = above & (np.abs(frequency - top) <= WIDTH * top)
    if near[np.argmax(above)] or float(power[near].sum()) < MIN_SHARE * float(power[above].sum()):
        return 0.0
    if float(power[near].sum()) < MIN_POWER_RATIO * float(motion[near].sum()):
        return 0.0
    return float(power[near] @ frequency[near] / power[near].sum())


def _stretches(values: Array) -> list[slice]:
    """Stretches without a gap of more than a few rows."""
    rows = np.flatnonzero(~np.isnan(values))
    if not len(rows):
        return []
    parts = np.split(rows, np.flatnonzero(np.diff(rows) > 5) + 1)
    return [slice(int(part[0]), int(part[-1]) + 1) for part in parts]


def _bridged(values: Array) -> Array:
    """Short gaps interpolated linearly, the mean subtracted."""
    path = filled(values)
    return np.asarray(path - path.mean())
