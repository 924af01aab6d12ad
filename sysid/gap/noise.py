"""How noisy each measured signal is: from the data sheet where the machine description has it, else from the data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset, Recording
from sysid.signals import split_signal

Array = npt.NDArray[np.float64]


def noise_levels(dataset: Dataset) -> dict[str, float]:
    """Signal → standard deviation, for every measured signal that is not a command."""
    recordings = dataset.recordings
    measured = {s for r in recordings for s in r.signals if split_signal(s)[1] != "command"}
    levels: Mapping[str, float] = dataset.machine.noise
    return {s: levels[s] if s in levels else estimate_noise(s, recordings) for s in sorted(measured)}


def estimate_noise(signal: str, recordings: Iterable[Recording]) -> float:
    """Standard deviation of what cannot be motion: scatter about a line through neighbours, in the quietest stretches.

    The third difference removes any motion that is smooth over four samples; a signal on a grid that is finer than its
    sensor is thinned until neighbouring values differ. The median over stretches of a second keeps fast motion out.
    """
    scatters = []
    for recording in recordings:
        values = recording.values(signal)
        stride = _stride(values)
        values = values[::stride]
        length = max(12, round(recording.rate_hz / stride))
        third = np.diff(values, 3)
        for k in range(0, len(third) - length + 1, length):
            part = third[k : k + length]
            if not np.isnan(part).any():
                scatters.append(float(np.sqrt(np.mean(part**2) / 20.0)))  # 1 + 9 + 9 + 1
    scatters = [s for s in scatters if s > 0.0]
    if scatters:
        return float(np.median(scatters))
    span = [float(np.nanmax(v) - np.nanmin(v)) for v in (r.values(signal) for r in recordings) if not np.isnan(v).all()]
    return 1e-6 * max(span, default=1.0) or 1e-12


def _stride(values: Array) -> int:
    """Samples between independent readings of a signal that was interpolated to a finer grid (1 where it was not)."""
    second = np.abs(np.diff(values, 2))
    second = second[~np.isnan(second)]
    if len(second) < 50:
        return 1
    straight = float(np.mean(second < 1e-9 * max(float(np.nanmax(np.abs(values))), 1e-12)))
    return 1 if straight < 0.3 else round(1.0 / max(1.0 - straight, 0.1))
