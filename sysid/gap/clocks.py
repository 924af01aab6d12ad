"""Uncertainty of the clock of a stream: an offset that alignment leaves open is no effect."""

from __future__ import annotations

import math
from pathlib import PurePath

from sysid.datasets.recording import Dataset

#: Standard errors of the offset within which it is not an effect, and those in a 95 % interval.
STANDARD_ERRORS, NORMAL95 = 2.0, 1.96


def open_offset(dataset: Dataset, stream: str) -> float:
    """Half-width [s] of a clock offset of ``stream`` that its clock records leave open.

    Two standard errors of the offset (root mean square over the recordings that were aligned on their motion), plus half a
    sample, the resolution of a stamp. For a stream that was not aligned, half a sample.

    Args:
        stream: stem of its file, as in ``dataset.streams`` and as the target of ``clock_offset``.
    """
    halves = [
        (record.offset_interval95[1] - record.offset_interval95[0]) / 2.0
        for record in dataset.clocks
        if record.applied and PurePath(record.stream).stem == stream and math.isfinite(record.residual_rms)
    ]
    known = [half for half in halves if math.isfinite(half)]
    error = math.sqrt(sum(half**2 for half in known) / len(known)) / NORMAL95 if known else 0.0
    return STANDARD_ERRORS * error + 0.5 / _rate(dataset, stream)


def _rate(dataset: Dataset, stream: str) -> float:
    """Sample rate of the tables, or of the stream where it is lower [Hz]."""
    rates = [recording.rate_hz for recording in dataset.of_kind("motion")] or [dataset.machine.rate_hz]
    for channels in dataset.quality.get("streams", {}).values():
        for key, figures in channels.items():
            source = key.rpartition("/")[0]
            if PurePath(source).stem == stream and figures.get("rate_hz"):
                rates.append(float(figures["rate_hz"]))
    return min(rates)
