"""How well the clock of a stream is known: what alignment leaves open is no finding of the gap workflow."""

from __future__ import annotations

import math
from pathlib import PurePath

from sysid.datasets.recording import Dataset

#: So many standard errors of the offset are left open by alignment; its intervals hold 95 %, which are 1.96 of them.
ERRORS, NORMAL95 = 2.0, 1.96


def open_offset(dataset: Dataset, stream: str) -> float:
    """Half-width [s] within which a clock offset of ``stream`` belongs to its clock records, and is no effect of its own.

    Two standard errors of the offset, root mean square of the recordings that were aligned on their motion, plus half a sample
    (a stamp says no more than in which sample something was measured). A stream that was not aligned, or needs no alignment,
    has half a sample alone: its stamps were taken as they are.

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
    return ERRORS * error + 0.5 / _rate(dataset, stream)


def _rate(dataset: Dataset, stream: str) -> float:
    """Samples a second of the tables, or of the stream where it is slower [Hz]."""
    rates = [recording.rate_hz for recording in dataset.of_kind("motion")] or [dataset.machine.rate_hz]
    for channels in dataset.quality.get("streams", {}).values():
        for key, figures in channels.items():
            source = key.rpartition("/")[0]
            if PurePath(source).stem == stream and figures.get("rate_hz"):
                rates.append(float(figures["rate_hz"]))
    return min(rates)
