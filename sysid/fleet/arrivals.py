"""Log folders to which recordings are added: those that are complete are taken into the dataset, each once.

A recording is complete if each of its files has the end that its format states, or if nothing has changed in it while this
process watched it for a while. The times of files are not compared with a clock: copies keep old ones, and clocks differ. Since
a copy may pause for longer, a recording that changes later supersedes what was taken in before.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from sysid.config import Strict
from sysid.datasets.plan import Plan, content_of
from sysid.datasets.versions.append import plan_on
from sysid.datasets.versions.manifest import contents_of, digest_of
from sysid.datasets.versions.store import Store
from sysid.datasets.versions.update import Update, update
from sysid.errors import InputError, SettingsError, StoreError
from sysid.foreign import visible
from sysid.logs.readers import is_log
from sysid.names import check_file_name
from sysid.progress import Progress, part, silent
from sysid.release import __version__
from sysid.root import Root

#: A log without an end is complete if nothing in its recording changes for so long [s].
QUIET_S = 60.0
#: Last bytes of a complete file: suffix → bytes (mcap.dev/spec; parquet.apache.org/docs/file-format).
_ENDS = {".mcap": b"\x89MCAP0\r\n", ".parquet": b"PAR1"}
#: Recordings of one version of the dataset, so that a process that is killed loses no more work than that.
BATCH = 32
#: Time between two checks for changes [s], and levels of folders in a recording.
_LOOK_S, _LEVELS = 1.0, 16
_KINDS = {"link": "a link, which is not followed", "other": "a pipe, a device or a socket"}


@dataclass(frozen=True)
class Seen(Strict):
    """What became of a recording of a log folder.

    Args:
        signature: of its files and the recipe; it changes with any of them.
        relies: recording of the dataset → its content, on which that depends.
        refused: why it was not taken in; ``repeats``: the recording of which it is a copy.
    """

    signature: str
    relies: dict[str, str] = field(default_factory=dict)
    refused: str = ""
    repeats: str = ""


@dataclass(frozen=True)
class SeenLogs(Strict):
    """The recordings of log folders by their paths, so that they are read again only when they have changed."""

    schema: Literal[1] = 1
    recordings: dict[str, Seen] = field(default_factory=dict)


@dataclass(frozen=True)
class Arrivals:
    """What a look at log folders found.

    Args:
        added: recordings that were appended.
        replaced: (recording of the dataset, the one that supersedes it, mostly itself with more content).
        repeated: (recording, the one of which it is a copy); it is not counted.
        notes: (recording that was taken in, what is missing in it).
        waiting: recordings that are still being written.
        left_out: (recording, why) of those that cannot be used; they are read again when they have changed.
    """

    added: tuple[str, ...] = ()
    replaced: tuple[tuple[str, str], ...] = ()
    repeated: tuple[tuple[str, str], ...] = ()
    notes: tuple[tuple[str, str], ...] = ()
    waiting: tuple[str, ...] = ()
    left_out: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class _Folder:
    """A log folder; ``rules``: digest of its recipe and of the program."""

    plan: Plan
    rules: str

    @property
    def path(self) -> Path:
        return self.plan.roots[0]


@dataclass(frozen=True)
class _Look:
    """A recording as it was found; ``ended``: each file has its end."""

    path: Path
    folder: _Folder
    signature: str
    ended: bool
    empty: bool

    @property
    def key(self) -> str:
        return str(self.path)


def take_in(
    folders: Sequence[Path],
    store: Store,
    name: str,
    fixed: Collection[str],
    quiet_s: float,
    seen: SeenLogs,
    progress: Progress = silent,
) -> tuple[Arrivals, SeenLogs]:
    """Bring dataset ``name`` up to date with the complete recordings in ``folders``.

    Recordings with an end are taken in at once. Where others are new, the call waits until nothing has changed in them for
    ``quiet_s``, or until each of them has changed.

    Args:
        fixed: recordings of the dataset that are never superseded; one that changes is left out.
        seen: what earlier calls found.

    Raises:
        InputError: a folder is missing or cannot be read.
        SettingsError: another machine, or a mistake in the recipe.
        StoreError: the workspace fails.
    """
    manifest = store.manifest(name)
    found, left_out = _all(folders, manifest)
    contents = contents_of(manifest)
    known = {look.key: own for look in found if (own := _known(look, seen, contents)) is not None}
    new = [look for look in found if look.key not in known and not look.empty]
    begun = time.monotonic()
    ready, others = _parted(new, lambda look: look.ended or quiet_s <= 0.0)
    intake = _Intake(store, name, fixed, [look.path.name for look in found if not look.empty], known)
    intake.take(ready, part(progress, 0.0, 0.5))
    quiet, moving = _settled(others, begun + quiet_s, part(progress, 0.5, 0.6))
    intake.take(quiet, part(progress, 0.6, 1.0))
    waiting = sorted({look.path.name for look in found if look.empty} | {look.path.name for look in moving} | intake.changed)
    left_out += intake.failed
    left_out += [(Path(key).name, own.refused) for key, own in intake.known.items() if own.refused]
    repeated = [(Path(key).name, own.repeats) for key, own in intake.known.items() if own.repeats]
    arrivals = replace(
        intake.arrivals, repeated=tuple(sorted(repeated)), waiting=tuple(waiting), left_out=tuple(sorted(left_out))
    )
    return arrivals, SeenLogs(recordings=dict(sorted(intake.known.items())))


class _Intake:
    """Takes recordings into the dataset, and keeps what became of each by its path."""

    def __init__(
        self, store: Store, name: str, fixed: Collection[str], present: Collection[str], known: Mapping[str, Seen]
    ) -> None:
        self._store, self._name, self._fixed, self._present = store, name, fixed, present
        self.known = dict(known)
        self.changed: set[str] = set()
        self.failed: list[tuple[str, str]] = []
        self.arrivals = Arrivals()

    def take(self, arrived: Sequence[_Look], progress: Progress) -> None:
        for first in range(0, len(arrived), BATCH):
            batch = arrived[first : first + BATCH]
            share = part(progress, first / len(arrived), (first + len(batch)) / len(arrived))
            for folder in {id(look.folder): look.folder for look in batch}.values():
                own = [look for look in batch if look.folder is folder]
                paths = [look.path for look in own]
                self._keep(own, update(folder.plan, paths, self._store, self._name, self._fixed, self._present, share))

    def _keep(self, arrived: Sequence[_Look], done: Update) -> None:
        contents = contents_of(self._store.manifest(self._name))
        refused, repeated = dict(done.refused), dict(done.repeated)
        failed = dict(done.failed)
        for look in arrived:
            if _changed(look):  # written while it was read: the next call reads it
                self.changed |= {look.path.name} if look.path in refused or look.path in failed else set()
            elif look.path in failed:
                self.failed.append((look.path.name, failed[look.path]))
            else:
                relies = {name: contents[name] for name in done.relies.get(look.path, ()) if name in contents}
                own = Seen(look.signature, relies, refused.get(look.path, ""), repeated.get(look.path, ""))
                self.known[look.key] = own
        earlier = self.arrivals
        self.arrivals = Arrivals(
            earlier.added + done.added,
            replaced=earlier.replaced + done.replaced,
            notes=earlier.notes + done.notes,
        )


def _known(look: _Look, seen: SeenLogs, contents: Mapping[str, str]) -> Seen | None:
    """What became of a recording in an earlier call, if neither it nor what that depends on has changed."""
    own = seen.recordings.get(look.key)
    if own is None or own.signature != look.signature or not own.relies.items() <= contents.items():
        return None
    return own if own.relies or own.refused else None


def _all(folders: Sequence[Path], manifest: dict[str, Any]) -> tuple[list[_Look], list[tuple[str, str]]]:
    """The recordings in all folders, and (name, why) of entries that are none."""
    found: list[_Look] = []
    left_out: list[tuple[str, str]] = []
    names: dict[str, Path] = {}
    for folder in folders:
        if not folder.is_dir():
            raise InputError(folder, "no such folder", "the log folder of a runner", "Check the path.")
        plan = plan_on(manifest, [folder.resolve()])
        place = _Folder(plan, digest_of({"sysid": __version__, **content_of((), plan.rules)}))
        try:
            entries = Root(place.path).entries("")
        except OSError as error:
            raise InputError(folder, error.strerror or str(error), "a folder that can be read", "Check it.") from None
        for name, kind in entries.items():
            if name.startswith(".") or (kind == "file" and not is_log(place.path / name)):
                continue
            other = names.setdefault(name, place.path)
            look: _Look | str = f"a recording of this name is in {other} too; expected a name for each. Rename one."
            if other == place.path:
                look = _entry(place.path / name, kind, place)
            if isinstance(look, str):
                left_out.append((visible(name), look))
            else:
                found.append(look)
    return found, left_out


def _entry(path: Path, kind: str, folder: _Folder) -> _Look | str:
    """The recording at an entry of a log folder, or why it is none."""
    if kind in _KINDS:
        return f"it is {_KINDS[kind]}; expected a folder with the files of one recording"
    if kind == "file":
        return "it is a log beside the recordings; expected a folder for each recording. Move it into one of its own."
    try:
        check_file_name(path.name, "recording")
    except SettingsError as error:
        return str(error)
    return _look(path, folder)


def _look(path: Path, folder: _Folder) -> _Look | str:
    """A recording as it is now, or why it cannot be read. No file is opened but to see its end."""
    root = Root(path)
    try:
        files = dict(_files(root, ""))
        signature = digest_of({"rules": folder.rules, "files": sorted((name, *rest) for name, rest in files.items())})
        return _Look(path, folder, signature, bool(files) and all(_ends(root, name) for name in files), not files)
    except (InputError, StoreError) as error:
        return str(error)
    except OSError as error:
        return f"{error.filename or path}: {error.strerror or error}"


def _files(root: Root, folder: str, level: int = 0) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Path of each file of a recording → size, times of its last change, and its number on the disk.

    Raises:
        InputError: a link, a pipe or a device, or folders too deep.
    """
    for name, kind in root.entries(folder).items():
        path = f"{folder}/{name}".lstrip("/")
        if kind in _KINDS:
            raise InputError(root.folder / path, _KINDS[kind], "a file of its own", "Copy the log into a file.")
        if kind == "folder":
            if level == _LEVELS:
                raise InputError(root.folder / path, f"a folder {_LEVELS} levels deep", "the files of one recording")
            yield from _files(root, path, level + 1)
            continue
        try:
            state = os.lstat(root.folder / path)
        except FileNotFoundError:  # removed since it was listed
            continue
        yield path, (state.st_size, state.st_mtime_ns, state.st_ctime_ns, state.st_ino)


def _ends(root: Root, path: str) -> bool:
    """Whether a file has the end that its format states."""
    end = _ENDS.get(Path(path).suffix.lower())
    if end is None:
        return False
    try:
        with root.open(path) as file:
            if os.fstat(file.fileno()).st_size <= len(end):
                return False
            file.seek(-len(end), os.SEEK_END)
            return file.read() == end
    except FileNotFoundError:
        return False


def _settled(arrived: Sequence[_Look], until: float, progress: Progress) -> tuple[list[_Look], list[_Look]]:
    """The recordings in which nothing changes up to a time of :func:`time.monotonic`, and the others."""
    begun, quiet, moving = time.monotonic(), list(arrived), list[_Look]()
    while quiet:
        left = until - time.monotonic()
        changed, quiet = _parted(quiet, _changed)
        moving += changed
        if left <= 0.0:
            break
        progress(1.0 - left / max(until - begun, left), f"waiting {left:.0f} s for {len(quiet)} logs without an end")
        time.sleep(min(left, _LOOK_S) if quiet else 0.0)
    return quiet, moving


def _parted(arrived: Sequence[_Look], condition: Callable[[_Look], bool]) -> tuple[list[_Look], list[_Look]]:
    """The recordings that fulfil a condition, and the others."""
    parts: tuple[list[_Look], list[_Look]] = ([], [])
    for look in arrived:
        parts[0 if condition(look) else 1].append(look)
    return parts


def _changed(look: _Look) -> bool:
    now = _look(look.path, look.folder)
    return isinstance(now, str) or now.signature != look.signature
