"""The recordings in the ingested paths, and their files."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from glob import escape
from pathlib import Path

from sysid.config import inside
from sysid.datasets.recipe import IngestRecipe, Recordings, StreamMap
from sysid.datasets.recording import Kind
from sysid.errors import InputError, SettingsError, nearest
from sysid.foreign import is_unicode
from sysid.logs.lerobot import LeRobotReader, data_files, is_lerobot
from sysid.logs.limits import check_file
from sysid.logs.reader import ReadOptions, Stream, read_confined
from sysid.logs.readers import is_log, reader_for
from sysid.logs.rosbag import side_files
from sysid.names import check_file_name
from sysid.quoting import toml_value


@dataclass(frozen=True)
class RecordingFiles:
    """The files of one recording.

    Args:
        streams: each file with its entry of the recipe, None without a recipe.
        written: file → size and time of its last change when it was found.
    """

    name: str
    kind: Kind
    root: Path
    streams: tuple[tuple[Path, StreamMap | None], ...]
    written: Mapping[Path, tuple[int, int]] = field(default_factory=dict)

    def check_unchanged(self) -> None:
        """Check that no file has changed since it was found.

        Raises:
            InputError: it has grown, was written again, or was removed.
        """
        for path, before in self.written.items():
            now = _written(path)
            if now != before:
                found = f"{'written' if now[1] >= 0 else 'removed'} while it was read"
                remedy = "Wait until it is recorded or copied, then run the command again."
                raise InputError(path, found, "a complete log", remedy)


def discover(paths: Sequence[Path], recipe: IngestRecipe) -> tuple[RecordingFiles, ...]:
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
    recordings = as_found(found)
    names = [recording.name for recording in recordings]
    for name in names:
        if names.count(name) > 1:
            raise InputError(", ".join(map(str, paths)), f"two recordings are named {name!r}", "one recording a name")
    if found and not any(recording.streams for recording in found):
        raise _nothing(paths, recipe)
    if not found:
        raise InputError(", ".join(map(str, paths)), "no recordings", "sub-folders with log files", "Check the path.")
    return recordings


def check_refused(refused: Mapping[str, InputError], read: int, place: str) -> None:
    """Check that every file can be used.

    Args:
        refused: ``recording/file`` → why it cannot be used.
        read: number of files.
        place: of the recipe, where the user may leave them out.

    Raises:
        InputError: of one file its own; of several all of them, those with the same reason together.
    """
    if not refused:
        return
    keys = ", ".join(toml_value(escape(key)) for key in refused)
    them = "it" if len(refused) == 1 else "them"
    leave = f"Or leave {them} out of the dataset: write `[recordings]` and below it `left_out = [{keys}]` in {place}."
    others = [leave] if len(refused) < read else []
    if len(refused) == 1:
        (error,) = refused.values()
        raise InputError(error.where, error.found, error.expected, " ".join([error.remedy or "Repair it.", *others]))
    reasons: dict[tuple[str, str, str], list[str]] = {}
    for error in refused.values():
        reasons.setdefault((error.found, error.expected, error.remedy), []).append(error.where)
    each = (str(InputError(", ".join(where), *reason)).rstrip(".?") for reason, where in reasons.items())
    found = "; ".join(f"({number}) {text}" for number, text in enumerate(each, 1))
    raise InputError(f"{len(refused)} of {read} files cannot be used", found, "", " ".join(["Repair them.", *others]))


def count_files(found: Sequence[RecordingFiles]) -> int:
    """Number of files of all recordings."""
    return len({(files.name, path) for files in found for path, _ in files.streams})


def left_out(paths: Sequence[Path], recipe: IngestRecipe) -> dict[str, list[str]]:
    """Glob of ``left_out`` in the recipe → the files, ``recording/file``, that are not read."""
    patterns = recipe.recordings.left_out
    places = {f"{name}/{file.name}" for path in paths for name, file in _places(path, recipe)} if patterns else set()
    return {pattern: sorted(key for key in places if fnmatchcase(key, pattern)) for pattern in patterns}


def _places(path: Path, recipe: IngestRecipe) -> Iterator[tuple[str, Path]]:
    """Every log file of a path with the name of its recording, as :func:`discover` names it."""
    named = recipe.recordings.files
    if path.is_file() or named:
        stated = [(name, file) for name, pattern in named.items() for file in (path.glob(pattern) if path.is_dir() else [path])]
        yield from stated or [(path.stem, path)]
        return
    folders = sorted(entry for entry in path.iterdir() if entry.is_dir()) if not is_lerobot(path) else []
    for folder in folders or [path]:
        if is_lerobot(folder):
            prefix = "" if folder == path else f"{folder.name}-"
            for file in data_files(folder):
                yield file.parent.name, file
                with contextlib.suppress(InputError):  # which is said where it is read
                    yield from ((f"{prefix}{stream.name}", file) for stream in _episodes_in(file))
        else:
            yield from ((folder.resolve().name, file) for file in sorted(folder.iterdir()) if is_log(file))


def check_sources(found: Sequence[RecordingFiles], where: object) -> None:
    """Check that no two entries of the recipe are primary sources of one signal in one recording.

    Raises:
        SettingsError: two are.
    """
    for files in found:
        primary: dict[str, StreamMap] = {}
        entries = {id(stream): stream for _, stream in files.streams if stream is not None}
        for stream in entries.values():
            for signal, mapping in stream.signals.items():
                if not mapping.primary or signal in stream.secondary:
                    continue
                if signal in primary:
                    raise SettingsError(
                        where,
                        f"two primary sources for {signal!r} in recording {files.name!r}: the entries "
                        f"{primary[signal].key!r} and {stream.key!r}",
                        "one primary source in a recording",
                        "Set `primary = false` on the other one. Where recordings have different layouts, write in each entry "
                        f'the recordings to which it applies: `recordings = ["{files.name}"]`, with globs.',
                    )
                primary[signal] = stream


def check_recordings(paths: Sequence[Path], found: Sequence[RecordingFiles], recipe: IngestRecipe, where: object) -> None:
    """Check that the recordings and files which the recipe names are there: ``recordings`` of its entries, ``left_out``.

    Raises:
        SettingsError: a glob that matches none.
    """
    names = [files.name for files in found]
    for pattern, matching in left_out(paths, recipe).items():
        if not matching:
            place = f"{where}: recordings.left_out"
            there = [f"{name}/{file.name}" for path in paths for name, file in _places(path, recipe)]
            raise SettingsError(place, f"no file {pattern!r}", nearest(pattern, there), "Correct the name.")
    for stream in recipe.streams:
        for pattern in stream.recordings:
            if not any(fnmatchcase(name, pattern) for name in names):
                place = f"{where}: streams {stream.files!r}: recordings"
                raise SettingsError(place, f"no recording {pattern!r}", nearest(pattern, names), "Correct the name.")


def unmatched(found: Sequence[RecordingFiles], recipe: IngestRecipe) -> tuple[str, ...]:
    """Notes about entries of the recipe that no file matches."""
    used = {stream.key for files in found for _, stream in files.streams if stream is not None}
    return tuple(
        f"no recording has a file {stream.key!r}: its entry is not used" for stream in recipe.streams if stream.key not in used
    )


def _checked(recording: RecordingFiles) -> str:
    for path, _ in recording.streams:
        if not is_unicode(path.name):
            raise InputError(path, "a name with bytes that are no UTF-8", "a name of text", "Rename it.")
    try:
        return check_file_name(recording.name, f"recording in {recording.root}")
    except SettingsError as error:
        raise InputError(error.where, error.found, error.expected, "Rename its folder or file.") from None


def _written(path: Path) -> tuple[int, int]:
    try:
        status = path.stat()
    except FileNotFoundError:
        return -1, -1
    return status.st_size, status.st_mtime_ns


def _nothing(paths: Sequence[Path], recipe: IngestRecipe) -> InputError:
    """Why single files are no recordings."""
    where = ", ".join(map(str, paths))
    if recipe.streams:
        patterns = [stream.files for stream in recipe.streams]
        return InputError(where, "no entry of the recipe matches", f"files {', '.join(patterns)}", "Correct `files`.")
    try:
        reader_for(paths[0])
    except InputError as error:
        return error
    return InputError(where, "no log file", "a log file or a folder of recordings", "Check the path.")


def sha256(path: Path) -> str:
    """Content address of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _in_path(path: Path, recipe: IngestRecipe) -> list[RecordingFiles]:
    recordings = recipe.recordings
    if recordings.files:
        return _single_files(path, recipe)
    if path.is_file() and recordings.leaves_out(path.stem, path.name):
        return []
    if path.is_file():
        home = path.resolve().parent  # a link that is named stands for its file
        streams = _matched([path], home, recipe, path.stem)
        return [RecordingFiles(path.stem, _kind(path.stem, recordings), home, streams)]
    if not path.is_dir():
        check_file(path, "a log file or a folder of recordings")  # a pipe or a device
    if is_lerobot(path):
        return episodes_of(path, recipe)
    folders = sorted(entry for entry in path.iterdir() if entry.is_dir() and not entry.name.startswith("."))
    result = []
    for folder in folders:
        result += in_folder(path, folder, recipe)
    if not result:  # the path is itself one recording
        streams = _matched(sorted(path.iterdir()), path, recipe, path.resolve().name)
        if not streams and recipe.streams:
            present = {entry.name for entry in (*path.iterdir(), *path.glob("*/*")) if is_log(entry)}
            patterns = ", ".join(repr(stream.files) for stream in recipe.streams)
            raise InputError(path, f"no file {patterns} of the recipe's `files`", nearest("", present), "Correct `files`.")
        if not streams:
            expected = "recordings " + ", ".join(map(repr, (*recordings.motion, *recordings.poses)))
            raise InputError(path, "no log files", expected, "Each sub-folder with log files is one recording.")
        result.append(RecordingFiles(path.resolve().name, _kind(path.resolve().name, recordings), path, streams))
    return result


def in_folder(path: Path, folder: Path, recipe: IngestRecipe) -> list[RecordingFiles]:
    """The recording in a sub-folder of a folder of recordings; none without logs, or where the recipe does not name it."""
    recordings = recipe.recordings
    if not any(fnmatchcase(folder.name, pattern) for pattern in (*recordings.motion, *recordings.poses)):
        return []
    inside(path, str(folder.resolve()), folder)
    if is_lerobot(folder):
        return episodes_of(folder, recipe, f"{folder.name}-")
    streams = _matched(sorted(folder.iterdir()), folder, recipe, folder.name)
    return [RecordingFiles(folder.name, _kind(folder.name, recordings), folder, streams)] if streams else []


def as_found(recordings: Sequence[RecordingFiles]) -> tuple[RecordingFiles, ...]:
    """The recordings with the size and time of each file as they are now, after a check of their names.

    Raises:
        InputError: a name that cannot be stored.
    """
    for recording in recordings:
        _checked(recording)
    return tuple(replace(files, written={path: _written(path) for path in all_files(files)}) for files in recordings)


def all_files(recording: RecordingFiles) -> tuple[Path, ...]:
    """Its files once, each followed by the files beside it that are a part of it."""
    return tuple(dict.fromkeys(file for path, _ in recording.streams for file in (path, *side_files(path))))


def episodes_of(folder: Path, recipe: IngestRecipe, prefix: str = "") -> list[RecordingFiles]:
    """The episodes of a LeRobot dataset, a recording each: entries of the recipe read the stream of the episode.

    Raises:
        InputError: no recipe, or a data file that is not readable.
    """
    if not recipe.streams:
        remedy = "Draft one: sysid ingest --inspect FOLDER --machine machine.toml --draft recipe.toml."
        raise InputError(folder, "a LeRobot dataset, whose files state no units", "a recipe", remedy)
    result, files = [], data_files(folder)
    refused: dict[str, InputError] = {}
    for file in files:
        inside(folder, str(file.resolve()), file)
        if recipe.recordings.leaves_out(file.parent.name, file.name):
            continue
        try:
            streams = _episodes_in(file)
        except InputError as error:
            refused[f"{file.parent.name}/{file.name}"] = error
            continue
        for stream in streams:
            name = f"{prefix}{stream.name}"
            if recipe.recordings.leaves_out(name, file.name):
                continue
            entries = [entry for _, entry in _matched([file], file.parent, recipe, name) if entry is not None]
            own = tuple((file, _for_episode(entry, stream.name)) for entry in entries)
            if own:
                result.append(RecordingFiles(name, _kind(name, recipe.recordings), folder, own))
    check_refused(refused, len(files), "the recipe")
    return result


def _episodes_in(file: Path) -> Sequence[Stream]:
    """The episodes of a data file, without their columns."""
    return read_confined(LeRobotReader(), file, ReadOptions(columns=frozenset()))


def _for_episode(entry: StreamMap, episode: str) -> StreamMap:
    """The entry of a recipe for the stream of one episode."""
    signals = {signal: replace(own, topic=episode) for signal, own in entry.signals.items()}
    return replace(entry, signals=signals, reader=LeRobotReader().name)


def _single_files(path: Path, recipe: IngestRecipe) -> list[RecordingFiles]:
    result, recordings = [], recipe.recordings
    for name, pattern in recordings.files.items():
        files = sorted(path.glob(pattern)) if path.is_dir() else [path] if fnmatchcase(path.name, pattern) else []
        files = [inside(path if path.is_dir() else path.parent, str(file.resolve()), path) for file in files]
        if not files:
            present = [file.name for file in path.iterdir()] if path.is_dir() else [path.name]
            raise InputError(path, f"no file {pattern!r} for recording {name!r}", nearest(pattern, present))
        if all(recordings.leaves_out(name, file.name) for file in files):
            continue
        result.append(RecordingFiles(name, _kind(name, recordings), files[0].parent, _matched(files, path, recipe, name)))
    return result


def _matched(
    files: Sequence[Path], folder: Path, recipe: IngestRecipe, recording: str
) -> tuple[tuple[Path, StreamMap | None], ...]:
    """Each log file of ``recording`` with its entry of the recipe; without entries, every file for which there is a reader."""
    files = [file for file in files if not recipe.recordings.leaves_out(recording, file.name)]
    if not recipe.streams:
        for file in files:
            inside(folder, str(file.resolve()), file)
        return tuple((file, None) for file in files if is_log(file))
    pairs = []
    for stream in recipe.streams:
        if not stream.applies_to(recording):
            continue
        for file in files:
            if file.is_file() and fnmatchcase(file.name, stream.files):
                inside(folder, str(file.resolve()), file)
                pairs.append((file, stream))
    return tuple(pairs)


def _kind(name: str, recordings: Recordings) -> Kind:
    return "poses" if any(fnmatchcase(name, pattern) for pattern in recordings.poses) else "motion"
