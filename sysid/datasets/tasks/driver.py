"""The caller of the tasks of an ingest: from found recordings to one part of a dataset, ready to be published."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

from sysid.datasets.channels import Mounts, combined_mounts
from sysid.datasets.clocks.records import KnownSkew, skews_of
from sysid.datasets.discover import RecordingFiles, check_refused, count_files
from sysid.datasets.plan import Plan, ingested_dataset, made_by, notes_of, placed
from sysid.datasets.quality.use import scales_of
from sysid.datasets.recording import Dataset, Recording, Role, Source
from sysid.datasets.splits import copy_notes
from sysid.datasets.tasks.steps import (
    AlignResult,
    Plain,
    ReadResult,
    RecordingTask,
    align_recording,
    read_recording,
    store_recording,
    stored_table,
    survey_recording,
)
from sysid.datasets.versions.files import UNCHANGED, explained
from sysid.datasets.versions.manifest import Manifest, new_part
from sysid.datasets.versions.store import Store
from sysid.datasets.versions.tables import committed, file_name, sample_columns
from sysid.execution import Executor
from sysid.location import absolute_location
from sysid.names import uncut_name
from sysid.progress import Progress, part

#: Gives roles to recordings and cuts those that have several, see :func:`sysid.datasets.splits.split`.
Split = Callable[[Sequence[Recording]], tuple[tuple[Recording, ...], dict[str, Role]]]
#: Finds the mounts of rigid bodies, see :func:`sysid.datasets.channels.survey_mounts`.
Survey = Callable[[Sequence[RecordingFiles]], Mounts]

#: Begin and end of each step as shares of the total time.
_SURVEYED, _READ, _ALIGNED, _STORED = (0.0, 0.25), (0.25, 0.6), (0.6, 0.8), (0.8, 1.0)


@dataclass(frozen=True)
class TaskIngest:
    """An ingest whose recordings are read by tasks.

    Args:
        executor: runs the tasks; its processes reach the raw files and the workspace under the same paths.
        store: of the workspace.
    """

    executor: Executor
    store: Store

    @property
    def location(self) -> str:
        """The workspace for processes with another current folder."""
        return absolute_location(str(self.store.workspace))

    def survey(self, found: Sequence[RecordingFiles], plan: Plan, report: Progress) -> Mounts:
        """Mounts of the rigid bodies, as :func:`sysid.datasets.channels.survey_mounts`."""
        with_bodies = [files for files in found if any(m is not None and m.bodies for _, m in files.streams)]
        calls = [(self.location, plan, absolute(files)) for files in with_bodies]
        surveyed = self.executor.run(survey_recording, calls, part(report, *_SURVEYED))
        names = [files.name for files in with_bodies]
        return combined_mounts(found, [*zip(names, surveyed, strict=True)], plan.recipe_place)

    def written(
        self,
        found: Sequence[RecordingFiles],
        plan: Plan,
        mounts: Mounts,
        sources: Sequence[Source],
        divide: Split,
        folder: str,
        report: Progress,
        skews: Mapping[str, KnownSkew] | None = None,
    ) -> tuple[Dataset, Manifest]:
        """Read, align and describe the recordings ``found``, with their tables in ``folder``.

        Args:
            skews: known skews of the clocks, from other recordings.

        Returns:
            The dataset without name and digest, and the entry of the manifest for its tables.
        """
        run, machine = self.executor.run, plan.machine
        tasks = [RecordingTask(self.location, folder, k, plan, absolute(files)) for k, files in enumerate(found)]
        of_each = [{key: own for key, own in mounts.items() if key[0] == files.name} for files in found]
        read: list[ReadResult] = run(read_recording, [*zip(tasks, of_each, strict=True)], part(report, *_READ))
        unusable = {key: error for own in read for key, error in own.reading.refused.items()}
        check_refused(unusable, count_files(found), plan.recipe_place)
        shared = skews_of({files.name: own.pieces for files, own in zip(found, read, strict=True)}, skews)
        calls: list[tuple[Any, ...]] = [(task, own, shared) for task, own in zip(tasks, read, strict=True)]
        aligned: list[AlignResult] = run(align_recording, calls, part(report, *_ALIGNED))
        refused = {files.name: own.refused for files, own in zip(found, aligned, strict=True) if own.refused is not None}
        names = placed([files.name for files in found], refused, plan.rules.splits)
        kept = [k for k, files in enumerate(found) if files.name in names]
        tables = [stored_table(self.store.files, tasks[k], aligned[k].start_ns) for k in kept]
        parts, roles = divide(tables)
        dataset, assumed = ingested_dataset(
            plan,
            parts,
            roles,
            clocks=tuple(record for k in kept for record in aligned[k].clocks),
            channels={found[k].name: read[k].reading.channels for k in kept},
            streams=[pair for k in kept for pair in aligned[k].streams],
            sources=sources,
            losses={f"{found[k].name}/{file}": tuple(own) for k in kept for file, own in read[k].reading.losses.items()},
        )
        columns, scales, blocks = sample_columns(dataset), scales_of(parts, machine), _blocks(parts, tables)
        calls = [(tasks[k], read[k], aligned[k], blocks[found[k].name], scales, columns) for k in kept]
        stored: list[Plain] = run(store_recording, calls, part(report, *_STORED))
        rates = tuple(note for own in read for note in own.rates)
        notes = notes_of(found, plan, mounts, rates, [own.commands for own in read], refused)
        quality = {
            **_joined([own["quality"] for own in stored]),
            "flags": [flag for k in kept for flag in aligned[k].flags],
            "notes": [*notes, *copy_notes(tables), *assumed],
        }
        entry = self._committed(folder, [read[k] for k in kept], stored, kept)
        return replace(dataset, quality=quality), new_part(folder, *entry, made_by(found, plan, mounts))

    def _committed(
        self, folder: str, read: Sequence[ReadResult], stored: Sequence[Plain], kept: Sequence[int]
    ) -> tuple[Plain, Plain]:
        """The Delta tables of the files that the tasks wrote, numbered without gaps: samples and raw channels."""
        with explained(self.store.workspace, UNCHANGED):
            self.store.files.remove(f"{folder}/tables")
            entries: dict[str, list[dict[str, Any]]] = {}
            files = {"samples": [own["file"] for own in stored], "channels": [own.file for own in read]}
            for which, own in files.items():
                place = f"{folder}/{which}"
                there = {entry["path"] for entry in own}
                for name in self.store.files.names(place):
                    if name not in there:  # of a recording without a place in time, or of a task that was killed
                        self.store.files.remove(f"{place}/{name}")
                for number, (k, entry) in enumerate(zip(kept, own, strict=True)):
                    if k != number:
                        self.store.files.rename(f"{place}/{entry['path']}", f"{place}/{file_name(number)}")
                    entries.setdefault(which, []).append({**entry, "path": file_name(number)})
            samples = committed(self.store.files, f"{folder}/samples", entries["samples"])
            channels = committed(self.store.files, f"{folder}/channels", entries["channels"])
        return samples, {**channels, "clocks": [clock for one in read for clock in one.clocks]}


def absolute(files: RecordingFiles) -> RecordingFiles:
    """The recording for processes with another current folder."""
    return replace(
        files,
        root=files.root.absolute(),
        streams=tuple((path.absolute(), mapping) for path, mapping in files.streams),
        written={path.absolute(): state for path, state in files.written.items()},
    )


def _blocks(parts: Sequence[Recording], tables: Sequence[Recording]) -> dict[str, list[tuple[str, int, int]]]:
    """Uncut recording → (name, first row, last + 1) of its blocks; empty where it is not cut."""
    whole = {table.name: table for table in tables}
    found: dict[str, list[tuple[str, int, int]]] = {}
    for name, own in groupby(parts, lambda block: uncut_name(block.name, whole)):
        start, rate = whole[name].start_ns, whole[name].rate_hz
        cut = [block for block in own if block.name != name]
        firsts = [round((block.start_ns - start) * 1e-9 * rate) for block in cut]
        found[name] = [(block.name, first, first + len(block)) for block, first in zip(cut, firsts, strict=True)]
    return found


def _joined(qualities: Sequence[Plain]) -> Plain:
    """Entries by recording of all."""
    joined: Plain = {}
    for quality in qualities:
        for key, own in quality.items():
            joined[key] = {**joined.get(key, {}), **own}
    return joined
