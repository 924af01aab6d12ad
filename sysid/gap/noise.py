"""How noisy each measured signal is: from the data sheet where the machine description has it, else from the data."""

from __future__ import annotations

import numpy as np

from sysid.datasets.quality import noise_of
from sysid.datasets.recording import Dataset
from sysid.signals import split_signal


def noise_levels(dataset: Dataset) -> dict[str, float]:
    """Signal → standard deviation, for every measured signal; a command has none unless the data sheet says so (a force).

    Without a data sheet: what ingest found in the sensor's own samples, else in the recordings' tables.
    """
    sheet = dataset.machine.noise
    signals = sorted({s for r in dataset.recordings for s in r.signals})
    measured = [s for s in signals if s in sheet or split_signal(s)[1] != "command"]
    return {s: sheet[s] if s in sheet else _from_data(dataset, s) for s in measured}


def _from_data(dataset: Dataset, signal: str) -> float:
    quality = dataset.quality.get("recordings", {})
    found = [quality.get(r.name, {}).get("signals", {}).get(signal, {}).get("noise") for r in dataset.recordings]
    levels = [level for level in found if level is not None and np.isfinite(level) and level > 0.0]
    if not levels:
        levels = [noise_of(r.values(signal), r.rate_hz) for r in dataset.recordings if r.kind == "motion"]
        levels = [level for level in levels if np.isfinite(level) and level > 0.0]
    if levels:
        return float(np.median(levels))
    values = np.concatenate([r.values(signal) for r in dataset.recordings])
    span = float(np.nanmax(values) - np.nanmin(values)) if not np.isnan(values).all() else 1.0
    return max(1e-6 * span, 1e-12)  # a signal without any scatter: simulated, or recorded in steps coarser than its motion
