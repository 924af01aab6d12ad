"""Single columns: never measured, constant while the axis is commanded, nothing but noise, positions that wrap."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sysid.datasets.chunked import Mask, copied, known, masked
from sysid.datasets.plausibility.finding import Cause, Evidence, Finding
from sysid.datasets.quality.noise import table_noise
from sysid.datasets.recording import Recording
from sysid.datasets.wrapping import WELL_SAMPLED, Wraps, is_position, one_turn, wraps_of
from sysid.machine import Machine
from sysid.scratch import computed
from sysid.signals import axis_signal, split_signal

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


def wrap_findings(recordings: Sequence[Recording], machine: Machine) -> dict[str, Finding]:
    """Axis → finding, for each axis with a position that wraps: its steps are no motion, so that nothing else is checked."""
    found = {}
    recorded = {signal for recording in recordings for signal in recording.signals}
    for signal in machine.signals:
        if signal not in recorded or not is_position(signal, machine):
            continue
        wrapped = {r.name: wraps for r in recordings if r.kind == "motion" if (wraps := _wraps(r, signal, machine)) is not None}
        if wrapped:
            most = max(wrapped.values(), key=lambda wraps: wraps.count)
            unit = machine.expected_unit(signal) or "1"
            evidence = Evidence(f"{signal} {most.text(unit)}", "a position that continues")
            remedy = "Ingest its logs again: steps of one modulus are undone, unless the recipe says `modulus = 0`"
            cause = Cause("", (signal,), f"known only up to multiples of {most.modulus:.6g}", remedy=remedy)
            names = () if len(wrapped) == len(recordings) else tuple(wrapped)
            found[split_signal(signal)[0]] = Finding((f"{signal}:wrap",), "severe", (evidence,), (cause,), names)
    return found


def _wraps(recording: Recording, signal: str, machine: Machine) -> Wraps | None:
    """Wraps in a table. Steps against the motion: a row that resampling has put into the middle of one is left out."""
    values = recording.values(signal)
    moduli = one_turn(machine.expected_unit(signal) or "1")
    there = known(values)
    travel = float(np.ptp(there)) if len(there) else 0.0
    moduli = [modulus for modulus in moduli if travel > (1.0 - WELL_SAMPLED) * modulus]  # no larger step without travel
    if not moduli:
        return None
    inner = max(len(values) - 2, 0)
    steps = computed(inner, lambda a, b: np.abs(values[a + 2 : b + 2] - values[a:b]))
    least = 0.5 * float(np.nanmax(steps, initial=0.0))

    def within(a: int, b: int) -> Mask:
        before, after = values[a + 1 : b + 1] - values[a:b], values[a + 2 : b + 2] - values[a + 1 : b + 1]
        return (before * after > 0.0) & (steps[a:b] > least)

    there = copied(values)
    there[1:-1][masked(inner, within)] = np.nan
    return wraps_of(recording.values("time"), there, moduli)


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
