"""Logs → dataset version: discover → read → align clocks → resample → split → describe → store."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.channel import Channel
from sysid.datasets.channels import Mounts, ReadRecording, concatenate, joined, read_channels, survey_mounts
from sysid.datasets.chunked import median_step
from sysid.datasets.clocks.records import Alignment, KnownSkew, RecordingClocks, aligned, by_source, machine_times
from sysid.datasets.discover import RecordingFiles, check_recordings, check_sources, discover, unmatched
from sysid.datasets.flags.collect import flag_rows
from sysid.datasets.frames.degenerate import offset_notes
from sysid.datasets.joint_units import with_joint_units
from sysid.datasets.plan import INGEST_VERSION, Plan, content_of, plan_of, settings_of, shared_mounts, sources_of
from sysid.datasets.plausibility.stamps import likely_unit
from sysid.datasets.poses import pose_table, still_phases
from sysid.datasets.quality import describe
from sysid.datasets.rates import rate_notes
from sysid.datasets.recipe import IngestRecipe, Splits
from sysid.datasets.recording import ClockRecord, Dataset, Recording, Role, Source
from sysid.datasets.resample import grid, resample
from sysid.datasets.splits import split
from sysid.datasets.versions.files import scratch_folder
from sysid.datasets.versions.manifest import PartRecord, digest_of
from sysid.datasets.versions.store import Store
from sysid.errors import InputError
from sysid.machine import Machine
from sysid.names import check_dataset_name
from sysid.progress import Progress, part, silent
from sysid.scratch import leave, scratch_in

#: Limit of rows on the grid, beyond which stamps are wrong (a day at 1 kHz has 86 million).
MAX_ROWS = 10**8
#: Begin and end of each step as shares of the total time, for a large log on one clock.
_READ, _RESAMPLED, _FLAGGED, DESCRIBED, STORED = (0.01, 0.12), (0.12, 0.29), (0.29, 0.49), (0.49, 0.64), (0.64, 1.0)


def ingest(
    paths: Sequence[Path | str] | Path | str,
    workspace: Path | str,
    machine: Path | str | None = None,
    recipe: Path | str | None = None,
    name: str | None = None,
    progress: Progress | None = None,
) -> Dataset:
    """Read logs and store them as a new version of dataset ``name``; the same content again returns the existing version.

    Args:
        paths: folders of recordings (``DIR/<recording>/<files>``) or single log files.
        workspace: folder or object-store URL.
        machine: ``machine.toml``; else the one of the recipe, else ``machine.toml`` beside the logs.
        recipe: ``recipe.toml``; else the one in the ingested folder, else the columns have canonical names.
        name: of the dataset; else the recipe's, else the machine's.
        progress: called with the share done and a text.

    Raises:
        InputError: a log that cannot be used.
        SettingsError: a mistake in ``machine.toml`` or in the recipe.
        StorageError: the disk of the workspace is full, for the version or for scratch files.
    """
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    # One thread: for thousands of small systems threads are slower.
    with threadpool_limits(limits=1), scratch_in(scratch_folder(workspace)):
        return _ingest(plan_of(paths, machine, recipe), workspace, name, progress or silent)


def _ingest(plan: Plan, workspace: Path | str, name: str | None, report: Progress) -> Dataset:
    rules, description = plan.rules, plan.machine
    title = name or (rules.name if rules is not None else None) or description.name
    check_dataset_name(title, remedy="Choose another --name.")

    report(0.0, "reading file names")
    found = discover(plan.roots, rules)
    check_recordings(found, rules, plan.where)
    check_sources(found, rules, plan.where)
    sources = sources_of(found)
    digest = digest_of({**content_of(sources, rules), "machine": description.files()})
    store = Store(workspace)
    known = store.intact(title, digest)
    if known is not None:
        report(1.0, f"the same logs are {known.reference}")
        return known

    ingested = read_and_align(found, plan, survey_mounts(found, description), report)
    settings = rules if rules is not None else IngestRecipe(schema=1)
    parts, roles = split(ingested.recordings, settings.splits, plan.where, description)
    dataset = ingested.dataset(title, digest, description, parts, roles, sources, part(report, *DESCRIBED))
    saved = store.save(dataset, ingested.channels, ingested.made, part(report, *STORED))
    report(1.0, f"stored {saved.reference}")
    return saved


@dataclass(frozen=True)
class IngestPass:
    """Logs on the machine's clock and grid, not yet split."""

    readings: Mapping[str, ReadRecording]
    recording_clocks: tuple[RecordingClocks, ...]
    clocks: tuple[ClockRecord, ...]
    recordings: tuple[Recording, ...]
    made: PartRecord
    flags: tuple[dict[str, Any], ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def channels(self) -> dict[str, tuple[Channel, ...]]:
        return {name: reading.channels for name, reading in self.readings.items()}

    def dataset(
        self,
        name: str,
        digest: str,
        machine: Machine,
        parts: Sequence[Recording],
        roles: Mapping[str, Role],
        sources: Sequence[Source],
        progress: Progress = silent,
    ) -> Dataset:
        """The version to be stored, with recordings ``parts`` in ``roles``."""
        units, assumed = with_joint_units(_units(self.channels), machine)
        parts = tuple(_with_units(part, units) for part in parts)
        losses = {f"{name}/{file}": items for name, reading in self.readings.items() for file, items in reading.losses.items()}
        return Dataset(
            name=name,
            version=0,
            digest=digest,
            machine=machine,
            recordings=parts,
            units=units,
            splits=roles,
            sources=tuple(replace(source, losses=losses.get(source.path, ())) for source in sources),
            clocks=self.clocks,
            quality={
                **describe(parts, self.readings, self.clocks, machine, progress),
                "flags": list(self.flags),
                "notes": [*self.notes, *assumed],
            },
            streams=_streams(self.recording_clocks, parts),
        )


def read_and_align(
    found: Sequence[RecordingFiles],
    plan: Plan,
    mounts: Mounts,
    report: Progress,
    skews: Mapping[str, KnownSkew] | None = None,
) -> IngestPass:
    """Read, align and resample the recordings ``found``.

    Args:
        mounts: of the rigid bodies.
        skews: known skews of the clocks, from other recordings.
    """
    settings = plan.rules if plan.rules is not None else IngestRecipe(schema=1)
    readings: dict[str, ReadRecording] = {}
    sizes = [sum(size for size, _ in files.written.values()) for files in found]
    before = 0
    for size, files in zip(sizes, found, strict=True):
        begin, end = (_READ[0] + (_READ[1] - _READ[0]) * done / max(1, sum(sizes)) for done in (before, before + size))
        report(begin, f"reading {files.name}")
        readings[files.name] = read_channels(files, plan.machine, mounts, part(report, begin, end))
        files.check_unchanged()
        before += size
    recording_clocks = tuple(RecordingClocks(files.name, files.kind, readings[files.name].channels) for files in found)
    report(_READ[1], "aligning clocks")
    alignment = aligned(recording_clocks, skews)
    clocks, recording_clocks = alignment.records, _placed(recording_clocks, alignment, settings.splits)
    recordings = []
    for number, recording in enumerate(recording_clocks):
        own = _share(report, _RESAMPLED, number, len(recording_clocks))
        recordings.append(_recording(recording, by_source(clocks, recording.name), plan.machine, settings, own))
    made = PartRecord(
        INGEST_VERSION, plan.rules.text if plan.rules is not None else "", settings_of(plan), shared_mounts(found, mounts)
    )
    flags = []
    for number, recording in enumerate(recording_clocks):
        own = _share(report, _FLAGGED, number, len(recording_clocks))
        flags += flag_rows(recording, clocks, plan.machine, settings.hold_s, own)
    omitted = [f"left out: {error}" for error in alignment.refused.values()]
    rates = rate_notes(found, readings, plan.machine.rate_hz)
    notes = (*offset_notes(settings.streams, mounts, plan.machine), *unmatched(found, plan.rules), *rates, *omitted)
    readings = {recording.name: readings[recording.name] for recording in recording_clocks}
    return IngestPass(readings, recording_clocks, clocks, tuple(recordings), made, tuple(flags), tuple(notes))


def _placed(recordings: Sequence[RecordingClocks], alignment: Alignment, splits: Splits) -> tuple[RecordingClocks, ...]:
    """The recordings that could be placed in time.

    Raises:
        AlignmentError: none could, or not one that the recipe names in its splits.
    """
    named = {*splits.fit, *splits.select, *splits.held_out, *splits.held_out_last}
    kept = tuple(recording for recording in recordings if recording.name not in alignment.refused)
    for name, error in alignment.refused.items():
        if not kept or name in named:
            raise error
    return kept


def _share(report: Progress, step: tuple[float, float], number: int, count: int) -> Progress:
    """The progress of one of ``count`` recordings in a step."""
    return part(part(report, *step), number / count, (number + 1) / count)


def _recording(
    recording: RecordingClocks,
    records: Mapping[str, Sequence[ClockRecord]],
    machine: Machine,
    rules: IngestRecipe,
    report: Progress,
) -> Recording:
    """The aligned table of one recording."""
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


def _streams(recordings: Sequence[RecordingClocks], tables: Sequence[Recording]) -> dict[str, tuple[str, ...]]:
    """File stem → its signals in the tables."""
    kept = {signal for table in tables for signal in table.signals}
    found: dict[str, dict[str, None]] = {}
    for recording in recordings:
        for name, parts in joined(recording.channels, f"recording {recording.name}").items():
            if name in kept:
                found.setdefault(Path(parts[0].source).stem, {})[name] = None
    return {stream: tuple(signals) for stream, signals in sorted(found.items())}


def _slack(record: ClockRecord) -> float:
    """Widening of the window of a still phase for a clock that is only known to a part of a hold [s]."""
    half = (record.offset_interval95[1] - record.offset_interval95[0]) / 2.0
    return half if half > 0.01 else 0.0


def _units(channels: Mapping[str, Sequence[Channel]]) -> dict[str, str]:
    """Signal → SI unit.

    Raises:
        InputError: a signal whose unit differs between recordings.
    """
    units = {"time": "s"}
    for name, parts in channels.items():
        for channel in parts:
            if units.setdefault(channel.signal, channel.unit) != channel.unit:
                found, expected = f"[{channel.unit}]", f"[{units[channel.signal]}] as in the recordings before"
                raise InputError(f"recording {name}: {channel.signal}", found, expected)
    return units


def _with_units(recording: Recording, units: Mapping[str, str]) -> Recording:
    recording.table.attrs["units"] = {str(column): units[str(column)] for column in recording.table.columns}
    return recording
