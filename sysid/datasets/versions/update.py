"""Brings a version up to date with recordings that arrive one by one and may have been copied in part.

A new recording is appended. One with other content than the version holds supersedes it, and so does one under another name
that begins with all of a held one, which was a part of it. A copy is recognised by its content; of several, the first by name
is held. Each recording is read, aligned and split by itself, with the clocks of ``fixed`` recordings only, so that its tables
depend neither on the order in which recordings arrive nor on how many arrive at once; one that cannot be used does not affect
the others.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from sysid.datasets.channel import Channel
from sysid.datasets.channels import Mounts, survey_mounts
from sysid.datasets.clocks.records import known_skews
from sysid.datasets.discover import RecordingFiles, as_found, check_sources, in_folder
from sysid.datasets.ingestion import read_and_align
from sysid.datasets.plan import Plan, content_of, made_by, streams_of
from sysid.datasets.recording import Dataset, Source
from sysid.datasets.splits import split
from sysid.datasets.versions.append import checked_addition, joined_quality, mounts_of, roles_of
from sysid.datasets.versions.files import OvertakenError, working_on
from sysid.datasets.versions.manifest import Manifest, Superseded, clock_from, digest_of, files_of, reduced
from sysid.datasets.versions.store import Store
from sysid.errors import InputError, StoreError, SysidError
from sysid.foreign import visible
from sysid.progress import Progress, part, silent

#: Bytes read at a time.
_PIECE = 1 << 20


@dataclass(frozen=True)
class Update:
    """What became of the recordings of an update.

    Args:
        added: recordings that the version did not hold.
        replaced: (recording that the version held, the one that supersedes it).
        repeated: (path, the recording of which it is a copy or the beginning).
        notes: (recording, what is missing in it): a log that was cut off.
        refused: (path, why); ``failed``: (path, why) of those that could not be read now, such as on a failing disk.
        relies: path → recordings whose content decided what became of it.
    """

    added: tuple[str, ...] = ()
    replaced: tuple[tuple[str, str], ...] = ()
    repeated: tuple[tuple[Path, str], ...] = ()
    notes: tuple[tuple[str, str], ...] = ()
    refused: tuple[tuple[Path, str], ...] = ()
    failed: tuple[tuple[Path, str], ...] = ()
    relies: Mapping[Path, tuple[str, ...]] = field(default_factory=dict)


def update(
    plan: Plan,
    paths: Sequence[Path],
    store: Store,
    name: str,
    fixed: Collection[str] = (),
    present: Collection[str] = (),
    progress: Progress = silent,
) -> Update:
    """Bring the newest version of dataset ``name`` up to date with recordings.

    Args:
        plan: of the folder of recordings.
        paths: sub-folders of it.
        fixed: recordings of the dataset, before they were cut into blocks, that are never superseded.
        present: names of all recordings that are among the logs: a copy of another one was renamed.

    Raises:
        StoreError: no such dataset, or the workspace fails. Nothing that is wrong with a recording is an error.
    """
    with working_on(store.workspace):
        while True:
            try:
                return _Pass(plan, store, store.manifest(name), frozenset(fixed), frozenset(present)).over(paths, progress)
            except OvertakenError as error:  # each time another writer has stored a version, so that this ends
                progress(0.0, f"{error.found}: repeated on that version")


@dataclass(frozen=True)
class _Part:
    """A recording that was read: the tables and provenance of it alone."""

    files: RecordingFiles
    dataset: Dataset
    channels: tuple[Channel, ...]
    mounts: Mounts


class _Pass:
    """One pass over recordings, on one version."""

    def __init__(self, plan: Plan, store: Store, base: Manifest, fixed: frozenset[str], present: frozenset[str]) -> None:
        self._plan, self._store, self._base, self._fixed, self._present = plan, store, base, fixed, present
        self._reference = f"{base['name']}@{base['version']}"
        self._held: dict[str, dict[str, tuple[int, str]]] = {
            recording: {file: (entry["size"], entry["sha256"]) for file, entry in own.items()}
            for recording, own in files_of(base["sources"]).items()
        }
        self._original = frozenset(self._held)
        self._beginnings: dict[str, list[list[str]]] = {
            name: [list(own) for own in lists] for name, lists in base.get("beginnings", {}).items()
        }
        self._parts: dict[str, _Part] = {}
        self._by: dict[str, str] = {}
        self._repeated: dict[str, str] = {}
        self._relies: dict[str, str] = {}
        self._units: dict[str, str] = dict(base["units"])
        clocks = [clock_from(item) for item in base["clocks"] if not fixed or item["recording"] in fixed]
        self._skews = known_skews(clocks, store.clock_domains(self._reference))

    def over(self, paths: Sequence[Path], progress: Progress) -> Update:
        """What :func:`update` returns.

        The smallest is the first, so that the beginning of a recording comes before the whole.
        """
        refused, failed = list[tuple[Path, str]](), list[tuple[Path, str]]()
        names: dict[Path, tuple[str, ...]] = {}
        ordered = sorted(paths, key=lambda path: (_size(path), path.name))
        for number, path in enumerate(ordered):
            share = part(progress, 0.9 * number / len(ordered), 0.9 * (number + 1) / len(ordered))
            try:
                found = self._found(path)
                names[path] = tuple(files.name for files in found)
                for files in found:
                    self._relies[files.name] = self._decided(files, share)
            except StoreError:
                raise
            except SysidError as error:
                refused.append((path, visible(error)))
            except OSError as error:
                failed.append((path, visible(f"{error.filename or path}: {error.strerror or error}")))
        self._store_parts(part(progress, 0.9, 1.0))
        replaced = tuple((name, by) for name, by in self._by.items())
        notes = [(name, loss) for name, own in self._parts.items() for s in own.dataset.sources for loss in s.losses]
        added = tuple(name for name in self._parts if name not in {by for _, by in replaced})
        repeated = tuple((path, self._repeated[name]) for path in names for name in names[path] if name in self._repeated)
        relies = {path: tuple(self._relies[name] for name in names[path] if name in self._relies) for path in names}
        return Update(added, replaced, repeated, tuple(notes), tuple(refused), tuple(failed), relies)

    def _found(self, path: Path) -> tuple[RecordingFiles, ...]:
        found = as_found(in_folder(self._plan.roots[0], path, self._plan.rules))
        if not found:
            expected = "log files in a sub-folder that the recipe takes for a recording"
            raise InputError(path, "no log that is a recording", expected, "Correct the recipe, or move it elsewhere.")
        check_sources(found, self._plan.where)
        return found

    def _decided(self, files: RecordingFiles, progress: Progress) -> str:
        """Decide on a recording; returns the one whose content decided.

        Raises:
            SysidError, OSError: it cannot be used.
        """
        sources, prefixes = _read_through(files, [size for own in self._held.values() for size, _ in own.values()])
        own = {source.path.rpartition("/")[2]: (source.size, source.sha256) for source in sources}
        before = self._held.get(files.name)
        if before is not None and own.items() <= before.items():  # the recipe may map fewer of its files
            return files.name
        same = self._same(files.name, own)
        if same is not None:
            self._repeated[files.name] = same
            if before is not None and files.name not in self._fixed:
                self._supersede(files.name, same, False)
            return same
        begun = [name for name, theirs in self._held.items() if {*theirs.values()} <= prefixes]
        taken = {*begun, *([files.name] if before is not None else [])}
        for name in sorted(taken & self._fixed):
            found = "other content than the dataset holds" if name == files.name else f"all of recording {name}, and more"
            expected = f"{name} as it was when the effects were named"
            raise InputError(files.root, found, expected, "Ingest the logs again, then begin again with --restart.")
        read = self._read(files, sources, progress)
        beginnings = [[sha for _, sha in self._held[name].values()] for name in begun]
        beginnings += [content for name in begun for content in self._beginnings.get(name, [])]
        for name in taken:
            self._supersede(name, files.name, name in begun)
        if beginnings:
            self._beginnings[files.name] = beginnings
        self._parts[files.name], self._held[files.name] = read, own
        return files.name

    def _same(self, name: str, own: Mapping[str, tuple[int, str]]) -> str | None:
        """The recording of which this is a copy, or known to be the beginning.

        One that was renamed is none. Of copies, a fixed one or the first by name is none, whichever came first.
        """
        content = {sha for _, sha in own.values()}
        for other, theirs in self._held.items():
            if other != name and {sha for _, sha in theirs.values()} == content:
                takes_place = name < other or not self._is_present(other)
                return None if takes_place and self._fixed.isdisjoint((name, other)) else other
        for other, beginnings in self._beginnings.items():
            if other != name and any({*sha} == content for sha in beginnings):
                return other
        return None

    def _is_present(self, recording: str) -> bool:
        """Whether the folder of a recording, or of the dataset of which it is an episode, is among the logs."""
        return any(recording == name or recording.startswith(f"{name}-") for name in self._present)

    def _supersede(self, name: str, by: str, contained: bool) -> None:
        """Leave out recording ``name``; unless ``by`` contains it, what was found to be its copy is to be read again."""
        self._held.pop(name)
        self._beginnings.pop(name, None)
        self._parts.pop(name, None)
        for decisions in (self._repeated, self._relies):
            for other in [other for other, of in decisions.items() if of == name]:
                if contained:
                    decisions[other] = by
                else:
                    del decisions[other]
        self._by = {old: by if new == name else new for old, new in self._by.items()}
        if name in self._original:
            self._by[name] = by

    def _read(self, files: RecordingFiles, sources: Sequence[Source], progress: Progress) -> _Part:
        """Read, align, split and describe one recording."""
        plan = self._plan
        mounts = mounts_of([files], self._base, lambda open_files: survey_mounts(open_files, plan.machine, plan.recipe_place))
        ingested = read_and_align([files], plan, mounts, progress, self._skews)
        parts, roles = split(ingested.recordings, roles_of(ingested.recordings, plan.rules.splits, None), plan.where)
        dataset = replace(ingested.dataset(plan, parts, roles, sources), name=self._base["name"])
        checked_addition(dataset, {**self._base, "units": self._units}, plan)
        self._units = {**dataset.units, **self._units}
        return _Part(files, dataset, ingested.channels[files.name], mounts)

    def _store_parts(self, progress: Progress) -> None:
        """Store what was decided as the next version, if it changes anything."""
        superseded = Superseded(self._by, self._beginnings) if self._by else None
        parts = list(self._parts.values())
        sources = [source for own in parts for source in own.dataset.sources]
        content = {"base": self._base["digest"], "superseded": self._by, **content_of(sources, self._plan.rules)}
        digest = digest_of(content)
        if not parts:
            if superseded is not None:
                self._store.reduce(self._reference, digest, superseded)
            return
        first = parts[0].dataset
        base = self._base if superseded is None else reduced(self._base, self._base["version"] + 1, digest, superseded)
        quality: Mapping[str, Any] = base["quality"]
        for own in parts:
            quality = joined_quality(quality, own.dataset.quality)
        recordings = tuple(recording for own in parts for recording in own.dataset.recordings)
        streams = [(name, signal) for own in parts for name, signals in own.dataset.streams.items() for signal in signals]
        addition = replace(
            first,
            digest=digest,
            recordings=recordings,
            units={name: unit for own in parts for name, unit in own.dataset.units.items()},
            splits={name: role for own in parts for name, role in own.dataset.splits.items()},
            sources=tuple(sources),
            clocks=tuple(clock for own in parts for clock in own.dataset.clocks),
            quality=quality,
            streams=streams_of(streams, recordings),
        )
        mounts: Mounts = {key: pose for own in parts for key, pose in own.mounts.items()}
        made = made_by([own.files for own in parts], self._plan, mounts)
        channels = {own.files.name: own.channels for own in parts}
        self._store.append(self._reference, addition, channels, made, True, progress, superseded)


def _size(path: Path) -> int:
    """Bytes of the files in a folder; what is wrong with it is found when it is read."""
    try:
        return sum(file.stat().st_size for file in path.iterdir() if file.is_file())
    except OSError:
        return 0


def _read_through(files: RecordingFiles, sizes: Iterable[int]) -> tuple[tuple[Source, ...], frozenset[tuple[int, str]]]:
    """The files of a recording by sha256, and the size and sha256 of those of their beginnings that have one of ``sizes``."""
    stops = sorted({*sizes})
    sources, prefixes = [], set()
    for path in dict.fromkeys(path for path, _ in files.streams):
        digest, done = hashlib.sha256(), 0
        with path.open("rb") as file:
            for stop in stops:
                while done < stop and (piece := file.read(min(_PIECE, stop - done))):
                    digest.update(piece)
                    done += len(piece)
                if done < stop:
                    break
                prefixes.add((stop, digest.hexdigest()))
            while piece := file.read(_PIECE):
                digest.update(piece)
                done += len(piece)
        sources.append(Source(f"{files.name}/{path.name}", digest.hexdigest(), done))
    return tuple(sources), frozenset(prefixes)
