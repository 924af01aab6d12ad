"""The tasks of an ingest, in their order: each does one step for one recording, on values that travel between processes.

In the folder of a part, recording ``k`` has the files ``channels/part-k``, ``samples/part-k`` and, until its roles are known,
``tables/k.arrow``: its uncut table (the recording on
the machine's clock, its channels resampled to the machine's rate). Every file appears whole, so that a task may run twice.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sysid.datasets.channel import Channel
from sysid.datasets.channels import Mounts, ReadRecording, ReferencePoses, concatenate, joined, read_channels, reference_poses
from sysid.datasets.checks.run import flag_rows
from sysid.datasets.checks.streams import likely_unit
from sysid.datasets.chunked import Array, median_step
from sysid.datasets.clocks.estimate import Skew
from sysid.datasets.clocks.records import RecordingClocks, by_source, machine_times, pieces_of, records_of
from sysid.datasets.clocks.resets import Piece
from sysid.datasets.discover import RecordingFiles
from sysid.datasets.plan import Plan, command_rates, rate_notes
from sysid.datasets.poses import pose_table, still_phases
from sysid.datasets.quality.describe import describe
from sysid.datasets.quality.use import Scale
from sysid.datasets.recipe import IngestRecipe
from sysid.datasets.recording import ClockRecord, Recording
from sysid.datasets.resample import grid, resample
from sysid.datasets.splits import rows_of
from sysid.datasets.versions.files import UNCHANGED, Files, explained, working_on
from sysid.datasets.versions.store import Store
from sysid.datasets.versions.tables import Columns, clock_entries, read_channel_file, write_channel_file, write_sample_file
from sysid.errors import AlignmentError, InputError
from sysid.files import plain
from sysid.machine import Machine
from sysid.progress import Progress, silent
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

    def times_of(channel: Channel) -> Array:
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


Plain = dict[str, Any]


@dataclass(frozen=True)
class RecordingTask:
    """What every task of a recording takes: the workspace, the ``folder`` of the part in it, and the ``number`` there."""

    location: str
    folder: str
    number: int
    plan: Plan
    files: RecordingFiles

    @property
    def table(self) -> str:
        """Path of the uncut table."""
        return f"{self.folder}/tables/{self.number:05d}.arrow"


@dataclass(frozen=True)
class ReadResult:
    """What :func:`read_recording` returns.

    Args:
        reading: without the samples of its channels, whose numbers are ``samples``; nothing else is there with refused files.
        pieces: clock → its pieces, without the residuals of their fits in blocks.
        file, clocks: for the manifest.
        rates: notes; ``commands``: log file → rate of its commands [Hz].
    """

    reading: ReadRecording
    samples: tuple[int, ...] = ()
    pieces: Mapping[str, tuple[Piece, ...]] = field(default_factory=dict)
    file: Plain = field(default_factory=dict)
    clocks: tuple[Plain, ...] = ()
    rates: tuple[str, ...] = ()
    commands: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class AlignResult:
    """What :func:`align_recording` returns: clock records, flags, ``streams`` (file stem and signal) and the first stamp of the
    table [ns]; or ``refused``: why a recording cannot be placed in time.
    """

    clocks: tuple[ClockRecord, ...] = ()
    flags: tuple[Plain, ...] = ()
    streams: tuple[tuple[str, str], ...] = ()
    start_ns: int = 0
    refused: AlignmentError | None = None


def without_samples(reading: ReadRecording) -> ReadRecording:
    """A recording whose channels have no samples."""
    nothing: dict[str, Any] = {"stamps": np.empty(0, np.int64), "values": np.empty(0)}
    return replace(reading, channels=tuple(replace(channel, **nothing) for channel in reading.channels))


def survey_recording(location: str, plan: Plan, files: RecordingFiles) -> tuple[ReferencePoses, Mapping[str, InputError]]:
    """Task: poses of rigid bodies in the reference poses of a recording, none where it has none; refused files."""
    with _prepared(location):
        return reference_poses(files, plan.machine)


def read_recording(own: RecordingTask, mounts: Mounts) -> ReadResult:
    """Task: raw files → ``channels/part-<number>``.

    Raises:
        SysidError: a log that cannot be used.
    """
    files, rate_hz = own.files, own.plan.machine.rate_hz
    with _prepared(own.location) as store:
        reading = read_channels(files, own.plan.machine, mounts)
        files.check_unchanged()
        if reading.refused:
            return ReadResult(without_samples(reading))
        found = pieces_of(RecordingClocks(files.name, files.kind, reading.channels))
        with explained(own.location, UNCHANGED):
            file = write_channel_file(store, f"{own.folder}/channels", own.number, files.name, reading.channels)
        return ReadResult(
            without_samples(reading),
            tuple(len(channel.stamps) for channel in reading.channels),
            {
                clock: tuple(replace(piece, estimate=replace(piece.estimate, blocks=None)) for piece in pieces)
                for clock, pieces in found.items()
            },
            file,
            tuple(clock_entries(files.name, reading.channels)),
            tuple(rate_notes([files], {files.name: reading}, rate_hz)),
            command_rates(reading),
        )


def align_recording(own: RecordingTask, read: ReadResult, skews: Mapping[str, Skew | None]) -> AlignResult:
    """Task: ``channels/part-<number>`` → ``tables/<number>.arrow`` on the machine's clock.

    Args:
        skews: clock domain → its skew; None: each recording has its own.
    """
    name, machine, rules = own.files.name, own.plan.machine, own.plan.rules
    with _prepared(own.location) as store:
        recording = RecordingClocks(name, own.files.kind, _stored(store, own, read).channels)
        try:
            records = records_of(recording, read.pieces, skews)
        except AlignmentError as error:
            return AlignResult(refused=error)
        table = aligned_recording(recording, by_source(records, name), machine, rules, silent)
        flags = flag_rows(recording, records, machine, rules.hold_s)
        with explained(own.location, UNCHANGED):
            _write_table(store, own.table, table.table)
        return AlignResult(tuple(records), tuple(flags), tuple(stream_signals(recording)), table.start_ns)


def store_recording(
    own: RecordingTask,
    read: ReadResult,
    aligned: AlignResult,
    blocks: Sequence[tuple[str, int, int]],
    scales: Mapping[str, Scale],
    columns: Columns,
) -> Plain:
    """Task: ``tables/<number>.arrow`` → ``samples/part-<number>``, and the quality of the recording.

    Args:
        blocks: (name, first row, last + 1) of the blocks with different roles; empty: it is not cut.
        scales: axis → full command and top speed over all recordings.
        columns: of the samples of all recordings.

    Returns:
        ``quality`` and the ``file`` for the manifest.
    """
    with _prepared(own.location) as store:
        whole = stored_table(store, own, aligned.start_ns)
        parts = [rows_of(whole, *block) for block in blocks] or [whole]
        readings = {own.files.name: _stored(store, own, read)}
        quality = describe(parts, readings, aligned.clocks, own.plan.machine, scales=scales)
        with explained(own.location, UNCHANGED):
            file = write_sample_file(store, f"{own.folder}/samples", own.number, parts, columns)
        return {"quality": plain(quality), "file": file}


def stored_table(files: Files, own: RecordingTask, start_ns: int) -> Recording:
    """The uncut recording that :func:`align_recording` stored; its table is mapped from a local file."""
    import pyarrow as pa

    uri = files.uri(own.table)
    source = pa.BufferReader(files.read(own.table)) if "://" in uri else pa.memory_map(uri)
    stored = pa.ipc.open_file(source).read_all()
    table = pd.DataFrame({field.name: stored[field.name].chunk(0).to_numpy() for field in stored.schema}, copy=False)
    return Recording(own.files.name, table, own.plan.machine.rate_hz, own.files.kind, start_ns)


def _write_table(files: Files, path: str, table: pd.DataFrame) -> None:
    import pyarrow as pa

    batch = pa.record_batch([pa.array(table[name].to_numpy()) for name in table.columns], names=list(map(str, table.columns)))
    with files.replaced(path) as sink:
        with pa.ipc.new_file(sink, batch.schema) as writer:
            writer.write_batch(batch)
        sink.flush()


def _stored(files: Files, own: RecordingTask, read: ReadResult) -> ReadRecording:
    """The channels that :func:`read_recording` stored."""
    samples = read_channel_file(files, f"{own.folder}/channels", own.number, read.samples)
    pairs = zip(read.reading.channels, samples, strict=True)
    return replace(read.reading, channels=tuple(replace(one, stamps=stamps, values=values) for one, (stamps, values) in pairs))


@contextmanager
def _prepared(location: str) -> Iterator[Files]:
    """The files of the workspace, in a process that works on it."""
    with working_on(location):
        yield Store(location).files
