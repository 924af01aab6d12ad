"""Does the disagreement swing? A clear peak in its spectrum: a tool on its pendulum, oil that rings, a boom that bends."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.problem import Problem

Array = npt.NDArray[np.float64]

#: Length of the pieces that spectra are averaged over [s]: frequencies come out to a twentieth of a hertz.
PIECE = 20.0
#: Below this [Hz] drift and motion look like an oscillation.
LOWEST = 0.2
#: A peak is what lies within this share of its frequency; it has to hold this share of the power above the lowest frequency.
WIDTH, CLEAR = 0.15, 0.5


def swinging(problem: Problem, theta: Array, recordings: Sequence[Recording], sigma: Array) -> Array:
    """Frequency [Hz] of each output's disagreement, (d,); zero where it has none, or is no more than noise ``sigma``.

    Averaged periodograms (Welch, IEEE Trans. Audio Electroacoust. 15 (1967)) of all stretches that are measured throughout.
    """
    from scipy.signal import welch

    found = np.zeros(len(problem.signals))
    residuals = [
        (problem.rate(r), problem.measured(r) - problem.predict(theta[None], r)[0]) for r in recordings if r.kind == "motion"
    ]
    if not residuals:
        return found
    rate_hz = residuals[0][0]
    length = round(PIECE * rate_hz)
    for k in range(len(found)):
        spectra, rows, square = [], 0, 0.0
        for rate, residual in residuals:
            for stretch in _whole(residual[:, k]):
                if abs(rate - rate_hz) > 1e-6 * rate_hz or len(stretch) < length // 2:
                    continue
                piece = stretch - stretch.mean()
                frequency, power = welch(piece, rate_hz, nperseg=min(length, len(piece)), nfft=length)
                spectra.append(len(piece) * power)
                rows, square = rows + len(piece), square + float(piece @ piece)
        if rows and square / rows > (2.0 * float(sigma[k])) ** 2:
            found[k] = _peak(frequency, np.sum(spectra, axis=0) / rows)
    return found


def _peak(frequency: Array, power: Array) -> float:
    """Frequency of the highest peak if it holds most of the power, else zero."""
    above = frequency >= LOWEST
    frequency, power = frequency[above], power[above]
    top = int(np.argmax(power))
    near = np.abs(frequency - frequency[top]) <= WIDTH * frequency[top]
    if top == 0 or float(power[near].sum()) < CLEAR * float(power.sum()):
        return 0.0
    return float(power[near] @ frequency[near] / power[near].sum())


def _whole(values: Array) -> list[Array]:
    """Stretches without a gap; short gaps of a few rows are bridged."""
    there = ~np.isnan(values)
    if not there.any():
        return []
    rows = np.flatnonzero(there)
    cuts = np.flatnonzero(np.diff(rows) > 5)
    parts = np.split(rows, cuts + 1)
    return [np.interp(np.arange(part[0], part[-1] + 1), part, values[part]) for part in parts]
