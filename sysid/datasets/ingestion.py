"""Logs → dataset version: discover → read → align clocks → resample → split → describe → store."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sysid.datasets.channel import Channel
from sysid.datasets.channels import Mounts, ReadRecording, read_channels, survey_mounts
from sysid.datasets.checks.run import flag_rows
from sysid.datasets.clocks.records import KnownSkew, RecordingClocks, aligned, by_source
from sysid.datasets.discover import RecordingFiles, check_recordings, check_refused, check_sources, count_files, discover
from sysid.datasets.plan import (
    Plan,
    command_rates,
    content_of,
    ingested_dataset,
    made_by,
    notes_of,
    placed,
    plan_of,
    rate_notes,
    sources_of,
)
from sysid.datasets.quality.describe import describe
from sysid.datasets.recording import ClockRecord, Dataset, Recording, Role, Source
from sysid.datasets.splits import copy_notes, split
from sysid.datasets.tasks.driver import TaskIngest
from sysid.datasets.tasks.steps import aligned_recording, stream_signals
from sysid.datasets.versions.files import working_on
from sysid.datasets.versions.manifest import PartRecord, digest_of
from sysid.datasets.versions.store import Store
from sysid.errors import InputError
from sysid.execution import Executor
from sysid.names import check_dataset_name
from sysid.progress import Progress, part, silent

#: Begin and end of each step as shares of the total time, for a large log on one clock.
_READ, _RESAMPLED, _FLAGGED, DESCRIBED, STORED = (0.01, 0.12), (0.12, 0.29), (0.29, 0.49), (0.49, 0.64), (0.64, 1.0)


def ingest(
    paths: Sequence[Path | str] | Path | str,
    workspace: Path | str,
    machine: Path | str | None = None,
    recipe: Path | str | None = None,
    name: str | None = None,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Dataset:
    """Read logs and store them as a new version of dataset ``name``; the same content again returns the existing version.

    Args:
        paths: folders of recordings (``DIR/<recording>/<files>``) or single log files.
        workspace: folder or object-store URL.
        machine: ``machine.toml``; else the one of the recipe, else ``machine.toml`` beside the logs.
        recipe: ``recipe.toml``; else the one in the ingested folder, else the columns have canonical names.
        name: of the dataset; else the recipe's, else the machine's.
        progress: called with the share done and a text.
        executor: reads and stores each recording as a task; its processes reach the logs and the workspace under the same
            paths. The version is the same. By default all is done in this process.

    Raises:
        InputError: a log that cannot be used.
        SettingsError: a mistake in ``machine.toml`` or in the recipe.
        StorageError: the disk of the workspace is full, for the version or for scratch files.
    """
    with working_on(workspace):
        return _ingest(plan_of(paths, machine, recipe), workspace, name, progress or silent, executor)


def _ingest(plan: Plan, workspace: Path | str, name: str | None, report: Progress, executor: Executor | None) -> Dataset:
    rules, description = plan.rules, plan.machine
    title = name or rules.name or description.name
    check_dataset_name(title, remedy="Choose another --name.")

    report(0.0, "reading file names")
    found = discover(plan.roots, rules)
    check_recordings(plan.roots, found, rules, plan.where)
    check_sources(found, plan.where)
    sources = sources_of(found)
    digest = digest_of({**content_of(sources, rules), "machine": description.files()})
    store = Store(workspace)
    known = store.intact(title, digest)
    if known is not None:
        report(1.0, f"the same logs are {known.reference}")
        return known

    def divide(recordings: Sequence[Recording]) -> tuple[tuple[Recording, ...], dict[str, Role]]:
        return split(recordings, rules.splits, plan.where, description)

    if executor is not None:
        with store.new_part(title, digest) as folder, executor.kept() as kept:
            tasks = TaskIngest(kept, store)
            mounts = tasks.survey(found, plan, report)
            dataset, entry = tasks.written(found, plan, mounts, sources, divide, folder, report)
            number = store.publish(replace(dataset, name=title, digest=digest), entry)
        saved = store.load(f"{title}@{number}")
    else:
        ingested = read_and_align(found, plan, survey_mounts(found, description, plan.recipe_place), report)
        parts, roles = divide(ingested.recordings)
        dataset = ingested.dataset(plan, parts, roles, sources, part(report, *DESCRIBED))
        saved = store.save(replace(dataset, name=title, digest=digest), ingested.channels, ingested.made, part(report, *STORED))
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
        plan: Plan,
        parts: Sequence[Recording],
        roles: Mapping[str, Role],
        sources: Sequence[Source],
        progress: Progress = silent,
    ) -> Dataset:
        """The version to be stored, without name and digest, with recordings ``parts`` in ``roles``."""
        losses = {f"{name}/{file}": items for name, reading in self.readings.items() for file, items in reading.losses.items()}
        streams = [pair for recording in self.recording_clocks for pair in stream_signals(recording)]
        dataset, assumed = ingested_dataset(plan, parts, roles, self.clocks, self.channels, streams, sources, losses)
        for recording in parts:
            recording.table.attrs["units"] = {str(column): dataset.units[str(column)] for column in recording.table.columns}
        quality = {
            **describe(parts, self.readings, self.clocks, plan.machine, progress),
            "flags": list(self.flags),
            "notes": [*self.notes, *assumed],
        }
        return replace(dataset, quality=quality)


def read_and_align(
    found: Sequence[RecordingFiles],
    plan: Plan,
    mounts: Mounts,
    report: Progress,
    skews: Mapping[str, KnownSkew] | None = None,
) -> IngestPass:
    """Read, align and resample the recordings ``found``.

    Args:
        skews: known skews of the clocks, from other recordings.
    """
    readings: dict[str, ReadRecording] = {}
    refused: dict[str, InputError] = {}
    sizes = [sum(size for size, _ in files.written.values()) for files in found]
    before = 0
    for size, files in zip(sizes, found, strict=True):
        begin, end = (_READ[0] + (_READ[1] - _READ[0]) * done / max(1, sum(sizes)) for done in (before, before + size))
        report(begin, f"reading {files.name}")
        reading = read_channels(files, plan.machine, mounts, part(report, begin, end))
        files.check_unchanged()
        refused |= reading.refused
        if refused:
            readings.clear()  # the others are only read to know all that are refused
        else:
            readings[files.name] = reading
        before += size
    check_refused(refused, count_files(found), plan.recipe_place)
    recording_clocks = tuple(RecordingClocks(files.name, files.kind, readings[files.name].channels) for files in found)
    report(_READ[1], "aligning clocks")
    alignment = aligned(recording_clocks, skews)
    names = placed([recording.name for recording in recording_clocks], alignment.refused, plan.rules.splits)
    clocks, recording_clocks = alignment.records, tuple(r for r in recording_clocks if r.name in names)
    recordings = []
    for number, recording in enumerate(recording_clocks):
        own = _share(report, _RESAMPLED, number, len(recording_clocks))
        recordings.append(aligned_recording(recording, by_source(clocks, recording.name), plan.machine, plan.rules, own))
    made = made_by(found, plan, mounts)
    flags = []
    for number, recording in enumerate(recording_clocks):
        own = _share(report, _FLAGGED, number, len(recording_clocks))
        flags += flag_rows(recording, clocks, plan.machine, plan.rules.hold_s, own)
    rates = rate_notes(found, readings, plan.machine.rate_hz)
    commands = [command_rates(reading) for reading in readings.values()]
    notes = (*notes_of(found, plan, mounts, rates, commands, alignment.refused), *copy_notes(recordings))
    readings = {recording.name: readings[recording.name] for recording in recording_clocks}
    return IngestPass(readings, recording_clocks, clocks, tuple(recordings), made, tuple(flags), tuple(notes))


def _share(report: Progress, step: tuple[float, float], number: int, count: int) -> Progress:
    """The progress of one of ``count`` recordings in a step."""
    return part(part(report, *step), number / count, (number + 1) / count)
