"""Which recordings lie in the ingested paths, and which files belong to each."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from sysid.config import inside
from sysid.datasets.recipe import Recipe, Recordings, StreamMap
from sysid.datasets.recording import Kind
from sysid.errors import InputError, nearest
from sysid.logs.readers import is_log


@dataclass(frozen=True)
class RecordingFiles:
    """The files of one recording; ``streams`` pairs each with its entry of the recipe, None in a canonical folder."""

    name: str
    kind: Kind
    root: Path
    streams: tuple[tuple[Path, StreamMap | None], ...]


def discover(paths: Sequence[Path], recipe: Recipe | None) -> tuple[RecordingFiles, ...]:
    """All recordings below ``paths``, in the order of their names.

    A path is a folder of recordings, one recording's folder, or a single file that is a recording.

    Raises:
        InputError: a missing path, a folder without logs, two recordings of one name, a file the recipe names is absent.
    """
    found: list[RecordingFiles] = []
    for path in paths:
        if not path.exists():
            raise InputError(path, "no such file or folder", "a folder of recordings", "Check the path.")
        found += _in_path(path, recipe)
    names = [recording.name for recording in found]
    for name in names:
        if names.count(name) > 1:
            raise InputError(", ".join(map(str, paths)), f"two recordings are named {name!r}", "one recording a name")
    if not found:
        raise InputError(", ".join(map(str, paths)), "no recordings", "sub-folders with log files", "Check the path.")
    return tuple(found)


def sha256(path: Path) -> str:
    """Content address of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _in_path(path: Path, recipe: Recipe | None) -> list[RecordingFiles]:
    recordings = recipe.recordings if recipe is not None else Recordings()
    if recordings.files:
        return _single_files(path, recordings, recipe)
    if path.is_file():
        return [
            RecordingFiles(path.stem, _kind(path.stem, recordings, path), path.parent, _matched([path], path.parent, recipe))
        ]
    folders = sorted(entry for entry in path.iterdir() if entry.is_dir() and not entry.name.startswith("."))
    result = []
    for folder in folders:
        wanted = [*recordings.motion, *recordings.poses]
        if not any(fnmatchcase(folder.name, pattern) for pattern in wanted):
            continue
        streams = _matched(sorted(folder.iterdir()), folder, recipe)
        if streams:
            result.append(RecordingFiles(folder.name, _kind(folder.name, recordings, path), folder, streams))
    if not result:  # the path is itself one recording
        streams = _matched(sorted(path.iterdir()), path, recipe)
        if not streams:
            expected = "recordings " + ", ".join(map(repr, (*recordings.motion, *recordings.poses)))
            raise InputError(path, "no log files", expected, "Each sub-folder with log files is one recording.")
        result.append(RecordingFiles(path.resolve().name, _kind(path.resolve().name, recordings, path), path, streams))
    return result


def _single_files(path: Path, recordings: Recordings, recipe: Recipe | None) -> list[RecordingFiles]:
    result = []
    for name, pattern in recordings.files.items():
        files = sorted(path.glob(pattern)) if path.is_dir() else [path] if fnmatchcase(path.name, pattern) else []
        files = [inside(path if path.is_dir() else path.parent, str(file.resolve()), path) for file in files]
        if len(files) != 1:
            present = [file.name for file in path.iterdir()] if path.is_dir() else [path.name]
            what = "no file" if not files else f"{len(files)} files"
            raise InputError(path, f"{what} {pattern!r} for recording {name!r}", nearest(pattern, present))
        result.append(RecordingFiles(name, _kind(name, recordings, path), files[0].parent, _matched(files, path, recipe)))
    return result


def _matched(files: Sequence[Path], folder: Path, recipe: Recipe | None) -> tuple[tuple[Path, StreamMap | None], ...]:
    """Each log file with the recipe's entry for it; where no recipe names streams, every file that some reader takes."""
    if recipe is None or not recipe.streams:
        return tuple((file, None) for file in files if is_log(file))
    pairs = []
    for stream in recipe.streams:
        for file in files:
            if file.is_file() and fnmatchcase(file.name, stream.files):
                inside(folder, str(file.resolve()), file)
                pairs.append((file, stream))
    return tuple(pairs)


def _kind(name: str, recordings: Recordings, path: Path) -> Kind:
    return "poses" if any(fnmatchcase(name, pattern) for pattern in recordings.poses) else "motion"
