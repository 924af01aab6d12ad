"""One recording on the machine's clock: its channels, resampled to the machine's rate, as one table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.channel import Channel
from sysid.datasets.channels import concatenate, joined
from sysid.datasets.chunked import median_step
from sysid.datasets.clocks.records import RecordingClocks, machine_times
from sysid.datasets.plausibility.stamps import likely_unit
from sysid.datasets.poses import pose_table, still_phases
from sysid.datasets.recipe import IngestRecipe
from sysid.datasets.recording import ClockRecord, Recording
from sysid.datasets.resample import grid, resample
from sysid.errors import InputError
from sysid.machine import Machine
from sysid.progress import Progress
from sysid.scratch import leave

#: Limit of rows on the grid, beyond which stamps are wrong (a day at 1 kHz has 86 million).
MAX_ROWS = 10**8


def aligned_recording(
    recording: RecordingClocks,
    records: Mapping[str, Sequence[ClockRecord]],
    machine: Machine,
    rules: IngestRecipe,
    report: Progress,
) -> Recording:
    """The aligned table of one recording.

    Args:
        records: source file → its clock records, see :func:`sysid.datasets.clocks.records.by_source`.

    Raises:
        InputError: no signal of the machine, or stamps that span too long a time.
    """
    start = recording.start_ns
    where = f"recording {recording.name}"
    signals = {name: concatenate(parts) for name, parts in joined(recording.channels, where).items()}
    signals = {name: signals[name] for name in machine.signals if name in signals}

    def times_of(channel: Channel) -> npt.NDArray[np.float64]:
        return machine_times(channel, start, records.get(channel.source))

    report(0.0, f"resampling {recording.name}")
    if recording.kind == "poses":
        sensors = [c for c in recording.machine if not c.signal.endswith(".command")]
        measured = {c.signal: (machine_times(c, start, None), c.values) for c in sensors}  # noqa: PD011
        phases = still_phases(measured, rules.still, where)
        slack = {name: max(map(_slack, records[c.source])) for name, c in signals.items() if c.source in records}
        values = {n: (times_of(c), c.values) for n, c in signals.items() if not n.endswith(".command")}  # noqa: PD011
        return Recording(
            recording.name,
            pose_table(phases, values, slack, machine.noise, rules.still.tolerance),
            machine.rate_hz,
            "poses",
            start,
        )
    end = max(int(channel.stamps[-1]) for channel in recording.machine)
    if (end - start) * 1e-9 * machine.rate_hz > MAX_ROWS:
        found = f"stamps that span {(end - start) * 1e-9 / 86400.0:.3g} days"
        expected = f"at most {MAX_ROWS} rows at {machine.rate_hz:g} Hz"
        slowest = max(recording.machine, key=lambda channel: int(channel.stamps[-1]))
        period = median_step(slowest.stamps) * 1e-9
        cause = likely_unit(1.0 / period, machine.rate_hz) if period > 0.0 else ""
        remedy = "Choose another clock or time unit in the recipe, or cut the log."
        raise InputError(where, found, expected, f"{cause}. {remedy}" if cause else remedy)
    at = grid(start, end, machine.rate_hz)
    columns = {"time": at}
    for number, (name, channel) in enumerate(signals.items()):
        report(number / len(signals), f"resampling {recording.name}: {name}")
        columns[name] = resample(channel, times_of(channel), at, machine.rate_hz, rules.hold_s)
        leave()
    return Recording(recording.name, pd.DataFrame(columns, copy=False), machine.rate_hz, "motion", start)


def stream_signals(recording: RecordingClocks) -> list[tuple[str, str]]:
    """(file stem, signal) of the primary signals of a recording."""
    found = joined(recording.channels, f"recording {recording.name}")
    return [(Path(parts[0].source).stem, name) for name, parts in found.items()]


def _slack(record: ClockRecord) -> float:
    """Widening of the window of a still phase for a clock that is only known to a part of a hold [s]."""
    half = (record.offset_interval95[1] - record.offset_interval95[0]) / 2.0
    return half if half > 0.01 else 0.0
