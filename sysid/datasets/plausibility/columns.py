"""Columns without information: never measured, constant while the axis is commanded, nothing but noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sysid.datasets.plausibility.finding import Evidence, Finding
from sysid.datasets.quality.noise import table_noise
from sysid.datasets.recording import Recording
from sysid.machine import Machine
from sysid.signals import axis_signal

#: Least time with a command in which a working sensor shows motion [s], and what counts as a command (share of the largest).
COMMANDED_S, COMMANDED = 3.0, 0.3
#: Share of its range above which the noise of a signal is nearly all of it: pure noise ranges over eight times its deviation.
NOISE_SHARE = 0.1
#: Samples of a recording in which noise is estimated.
NOISE_ROWS = 2**15


def column_findings(recordings: Sequence[Recording], machine: Machine) -> Iterator[Finding]:
    """Findings about single columns."""
    present = [signal for signal in machine.signals if any(signal in recording.signals for recording in recordings)]
    for signal in present:
        if all(signal not in r.signals or np.isnan(r.values(signal)).all() for r in recordings):
            evidence = Evidence(f"{signal} has no value in any recording", "values, or no such signal in the recipe")
            yield Finding((f"{signal}:missing",), "notice", (evidence,))
    motion = [recording for recording in recordings if recording.kind == "motion"]
    for axis in machine.axes:
        commanded = _commanded_s(motion, axis_signal(axis.name, "command"))
        if commanded < COMMANDED_S:
            continue
        for signal in dict.fromkeys((axis.driven, axis_signal(axis.name, "joint"))):
            if signal in present:
                yield from _still_sensor(motion, signal, commanded)


def _commanded_s(recordings: Sequence[Recording], command: str) -> float:
    """Time in which a command differs from its commonest value by :data:`COMMANDED` of its largest difference [s]."""
    total = 0.0
    for recording in recordings:
        values = recording.values(command)[: 2**18]
        values = values[~np.isnan(values)]
        if len(values):
            away = np.abs(values - np.median(values))
            total += float(np.count_nonzero(away > COMMANDED * away.max())) / recording.rate_hz if away.max() > 0.0 else 0.0
    return total


def _still_sensor(recordings: Sequence[Recording], signal: str, commanded: float) -> Iterator[Finding]:
    low, high, noises = np.inf, -np.inf, []
    for recording in recordings:
        values = recording.values(signal)
        if np.isnan(values).all():
            continue
        low, high = min(low, float(np.nanmin(values))), max(high, float(np.nanmax(values)))
        noises.append(table_noise(values[:NOISE_ROWS], recording.rate_hz))
    if not noises:
        return
    expected = f"motion: the axis is commanded for {commanded:.0f} s"
    if high - low <= 1e-9 * max(abs(low), abs(high), 1e-3):
        yield Finding((f"{signal}:constant",), "severe", (Evidence(f"{signal} is {low:.4g} in every row", expected),))
    elif np.median(noises) > NOISE_SHARE * (high - low):
        share = float(np.median(noises)) / (high - low)
        found = f"the noise of {signal} is {100 * share:.0f} % of its whole range"
        yield Finding((f"{signal}:noise",), "notice", (Evidence(found, expected),))
