"""Layouts of log files: files with the same fields, and the entries of a recipe that separate them from all others."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from glob import escape
from itertools import combinations, takewhile
from pathlib import Path

import numpy as np

from sysid.logs.inspection import GAP, ClockSummary, FieldSummary, FileSummary, StreamSummary
from sysid.logs.lerobot import LeRobotReader
from sysid.logs.rosbag import bag_of

#: Readers of files with one table, whose name is that of the file.
TABLES = ("csv", "parquet", "mat", "npz")
#: Those of which all streams have the same fields: the episodes of a LeRobot dataset.
ONE_TABLE = (*TABLES, LeRobotReader().name)
#: Files of one folder with more than this share of their names of fields in common are recordings of the same device.
ALIKE = 0.6


@dataclass(frozen=True)
class Layout:
    """Files with the same fields.

    Args:
        files: in the order in which they were found.
        whole: the first of them, with ranges of its fields over all.
        entries: globs of names and of recordings (empty: all) that together match these files and no other.
        recordings: the recordings that have such a file.
    """

    files: tuple[FileSummary, ...]
    whole: FileSummary
    entries: tuple[tuple[str, tuple[str, ...]], ...]
    recordings: frozenset[str]


def recording_names(
    files: Sequence[FileSummary], in_folders: bool, signals: Sequence[Set[str]]
) -> tuple[dict[Path, str], bool]:
    """File → its recording, and whether every file, or every bag in several files, is a recording of its own.

    Files of one folder are one recording, unless two of them have the same layout and the same time, or the same signals. Files
    with names that repeat in other folders (``left.csv``, ``right.csv``) are devices of one recording; numbered ones are not.
    The parts of one bag (:func:`bags_of`) are of one recording.

    Args:
        in_folders: there are files in sub-folders.
        signals: of each file those that are recognised by the names of its fields.
    """
    folders: dict[Path, list[tuple[FileSummary, Set[str]]]] = {}
    for file, own in zip(files, signals, strict=True):
        folders.setdefault(file.path.parent, []).append((file, own))
    repeated = Counter(file.path.name for file in files)
    single = len(folders) > 1 and any(one in other.parents for one in folders for other in folders)
    single |= not in_folders and len(files) == 1
    bags = bags_of(files)
    for beside in folders.values():
        for (one, its), (other, others) in combinations(beside, 2):
            numbered = re.sub(r"\d+", "", one.path.stem) == re.sub(r"\d+", "", other.path.stem)
            devices = not numbered and repeated[one.path.name] > 1 and repeated[other.path.name] > 1
            apart = in_folders and not overlap(one, other)  # parts of one log
            if bags[one.path] == bags[other.path]:
                continue
            single |= not devices and ((_alike(one, other) and not apart) or bool(its & others))
    if not single:
        return {file.path: file.path.parent.name for file in files}, False
    parts: dict[Path, list[Path]] = {}
    for file in files:
        separate = file.reader == LeRobotReader().name
        parts.setdefault(file.path if separate else bags[file.path], []).append(file.path)
    for bag, paths in list(parts.items()):
        if len(paths) > 1 and glob_of(paths, [file.path for file in files]) is None:  # the recipe cannot name them together
            del parts[bag]
            parts |= {path: [path] for path in paths}
    stems = {paths[0]: _common([path.stem for path in paths]).rstrip("_-. ") or paths[0].stem for paths in parts.values()}
    unique = len({*stems.values()}) == len(stems)
    names = {first: stem if unique else f"{first.parent.name}-{stem}" for first, stem in stems.items()}
    return {path: names[paths[0]] for paths in parts.values() for path in paths}, True


def glob_of(paths: Sequence[Path], others: Sequence[Path]) -> str | None:
    """A glob of names that matches these files of one folder and no other of it; None where there is none."""
    beside = [other.name for other in others if other.parent == paths[0].parent and other not in paths]
    patterns = _patterns([path.name for path in paths])
    return next((own for own in patterns if not any(fnmatchcase(name, own) for name in beside)), None)


def layouts_of(
    files: Sequence[FileSummary], recordings: Mapping[Path, str], apart: Mapping[Path, str] | None = None
) -> list[Layout]:
    """The layouts of all files with streams, in the order of their first files.

    Args:
        recordings: file → its recording.
        apart: file → what else separates it from files with the same fields, such as another unit.
    """
    others, bags = apart or {}, bags_of(files)
    parts: dict[Path, list[FileSummary]] = {}
    for file in files:
        if file.streams:
            parts.setdefault(bags[file.path], []).append(file)
    keys = {file.path: layout_key(merged(own) if len(own) > 1 else file) for own in parts.values() for file in own}
    groups: dict[object, list[FileSummary]] = {}
    for file in files:
        if file.streams:
            key = keys[file.path]
            beside = [one for one in files if one is not file and one.streams and recordings[one.path] == recordings[file.path]]
            device = any(  # two sensors of one kind
                keys[one.path] == key and overlap(one, file) and bags[one.path] != bags[file.path] for one in beside
            )
            groups.setdefault((key, file.path.name if device else "", others.get(file.path, "")), []).append(file)
    places = {file.path: (recordings[file.path], file.path.name) for file in files}
    found = []
    for group in groups.values():
        inside = [places[file.path] for file in group]
        outside = [places[file.path] for file in files if file not in group and file.streams]
        entries = _entries(inside, outside)
        if group[0].reader == LeRobotReader().name and not any(fnmatchcase(name, "*.parquet") for _, name in outside):
            entries = (("*.parquet", ()),)  # also for episodes that are recorded later
        found.append(Layout(tuple(group), merged(group), entries, frozenset(r for r, _ in inside)))
    return found


def alike(files: Sequence[FileSummary]) -> list[tuple[FileSummary, ...]]:
    """The files in groups of one layout, in the order of their first files; one without streams is by itself."""
    groups: dict[object, list[FileSummary]] = {}
    for file in files:
        groups.setdefault(layout_key(file) if file.streams and not file.refusal else file.path, []).append(file)
    return [tuple(group) for group in groups.values()]


def bags_of(files: Sequence[FileSummary]) -> dict[Path, Path]:
    """File → the bag or LeRobot dataset of which it is a part, or itself.

    Parts are listed in the bag's ``metadata.yaml``; or their names differ in a number that counts up (``run_0``, ``run_1``),
    they have the same fields, but for few, and each continues the one before without a gap.
    """
    episodes = LeRobotReader().name
    found = {f.path: f.path.parents[2] if f.reader == episodes else bag_of(f.path) or f.path for f in files}
    before: dict[object, FileSummary] = {}
    for file in sorted(files, key=lambda file: (file.path.parent, _number(file.path))):
        place, number = (file.path.parent, re.sub(r"\d+", "", file.path.stem), file.path.suffix), _number(file.path)
        last = before.get((place, number - 1))
        if found[file.path] == file.path and last is not None and _continues(last, file):
            found[file.path] = found[last.path]
        before[place, number] = file
    return found


def _number(path: Path) -> int:
    """The number at the end of a file's name; -1 where there is none."""
    match = re.search(r"\d{1,9}$", path.stem)
    return int(match[0]) if match else -1


def _continues(one: FileSummary, other: FileSummary) -> bool:
    """Whether a bag begins where another ends: its fastest stream goes on without a gap, as :data:`GAP` defines it."""
    if not _alike(one, other) or one.reader in TABLES:
        return False
    ends, begins = _log_clocks(one), _log_clocks(other)
    name = max(ends, key=lambda name: ends[name].rate_hz, default=None)
    if name is None or name not in begins or not ends[name].rate_hz > 0.0:
        return False
    pause = begins[name].first_ns * 1e-9 - (ends[name].first_ns * 1e-9 + ends[name].seconds)
    return 0.0 < pause <= GAP / ends[name].rate_hz


def _log_clocks(file: FileSummary) -> dict[str, ClockSummary]:
    """Topic → its clock of the recorder, where it has one with a rate."""
    clocks = ((stream.name, clock) for stream in file.streams for clock in stream.clocks if clock.name == "log")
    return {name: clock for name, clock in clocks if np.isfinite(clock.rate_hz)}


def layout_key(file: FileSummary) -> object:
    """What files of one layout have in common: reader, suffix, fields with units, and what the recipe has to state."""
    table = file.reader in ONE_TABLE
    content = tuple(dict.fromkeys(("" if table else s.name, tuple((f.name, f.unit) for f in s.fields)) for s in file.streams))
    captured = file.streams[0].clocks and file.streams[0].clocks[0].name == "capture"
    stated = (tuple(sorted(file.stated.items())), file.columns, len(file.time_units))
    return file.reader, file.path.suffix, () if captured else content, stated


def _alike(one: FileSummary, other: FileSummary) -> bool:
    """Whether two files have the same layout, or most names of fields in common."""
    if not one.streams or not other.streams or one.reader != other.reader:
        return False
    if layout_key(one) == layout_key(other):
        return True
    names, others = _field_names(one), _field_names(other)
    return len(names & others) > ALIKE * len(names | others)


def _field_names(file: FileSummary) -> set[str]:
    return {field.name for stream in file.streams for field in stream.fields} - {*file.columns}


def unreadable(files: Sequence[FileSummary]) -> tuple[FileSummary, ...]:
    """Files that cannot be read, beside others of their format that can: damaged ones."""
    readable = {(file.reader, file.path.suffix) for file in files if not file.refusal}
    return tuple(file for file in files if file.refusal and (file.reader, file.path.suffix) in readable)


def refusal_of(file: FileSummary) -> str:
    """Why a file cannot be read, in one line without its path."""
    return " ".join(file.refusal.split()).removeprefix(f"{file.path}: ")


def overlap(one: FileSummary, other: FileSummary) -> bool:
    """Whether the first clocks of two files overlap in time."""
    spans = []
    for file in (one, other):
        clocks = [stream.clocks[0] for stream in file.streams if stream.clocks]
        if not clocks:
            return True
        first = min(clock.first_ns for clock in clocks) * 1e-9
        spans.append((first, max(clock.first_ns * 1e-9 + clock.seconds for clock in clocks)))
    return spans[0][0] < spans[1][1] and spans[1][0] < spans[0][1]


def _entries(inside: Sequence[tuple[str, str]], outside: Sequence[tuple[str, str]]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Globs for (recording, file name) of ``inside`` that do not match ``outside``."""
    names, recordings = sorted({name for _, name in inside}), sorted({recording for recording, _ in inside})
    for pattern in _patterns(names):
        conflicting = {recording for recording, name in outside if fnmatchcase(name, pattern)}
        if not conflicting:
            return ((pattern, ()),)
        if conflicting.isdisjoint(recordings):
            return ((pattern, _separated(recordings, conflicting)),)
    entries = []
    for name in names:
        conflicting = {recording for recording, other in outside if other == name}
        own = sorted(recording for recording, other in inside if other == name)
        entries.append((escape(name), _separated(own, conflicting) if conflicting else ()))
    return tuple(entries)


def _separated(names: Sequence[str], others: set[str]) -> tuple[str, ...]:
    """One glob for ``names`` that matches none of ``others``, else all names."""
    for pattern in _patterns(names):
        if not any(fnmatchcase(other, pattern) for other in others):
            return (pattern,)
    return tuple(map(escape, names))


def _patterns(names: Sequence[str]) -> list[str]:
    """Globs that match all ``names``, the shortest first: by their suffix, and by what they have in common at both ends."""
    if len({*names}) == 1:
        return [escape(names[0])]
    front, back = _common(names), _common([name[::-1] for name in names])[::-1]
    back = back[max(0, len(front) + len(back) - min(map(len, names))) :]
    suffixes = {Path(name).suffix for name in names}
    suffix = suffixes.pop() if len(suffixes) == 1 else ""
    if len(front) > 2:
        return [f"{escape(front)}*{escape(suffix)}", f"{escape(front)}*{escape(back)}"]
    return [f"*{escape(suffix)}", f"*{escape(back)}", f"{escape(front)}*{escape(back)}"]


def _common(texts: Sequence[str]) -> str:
    """The letters with which all texts begin."""
    same = (len({*letters}) == 1 for letters in zip(*texts, strict=False))
    return texts[0][: sum(1 for _ in takewhile(bool, same))]


def merged(group: Sequence[FileSummary]) -> FileSummary:
    """The first file, with streams, ranges and missing values of all."""
    table = group[0].reader in ONE_TABLE
    streams: dict[str, list[StreamSummary]] = {}
    for file in group:
        for stream in file.streams:
            streams.setdefault("" if table else stream.name, []).append(stream)
    return replace(group[0], streams=tuple(_merged_stream(found) for found in streams.values()))


def _merged_stream(streams: Sequence[StreamSummary]) -> StreamSummary:
    fields: dict[str, list[tuple[FieldSummary, int]]] = {}
    for stream in streams:
        for field in stream.fields:
            fields.setdefault(field.name, []).append((field, stream.samples))
    merged = tuple(_merged_field(found) for found in fields.values())
    return replace(streams[0], samples=sum(stream.samples for stream in streams), fields=merged)


def _merged_field(found: Sequence[tuple[FieldSummary, int]]) -> FieldSummary:
    first = found[0][0]
    lows, highs = np.array([field.low for field, _ in found]), np.array([field.high for field, _ in found])
    if np.isnan(lows).all():
        return first
    samples = sum(count for _, count in found)
    missing = sum(field.missing * count for field, count in found) / max(1, samples)
    return replace(first, low=float(np.nanmin(lows)), high=float(np.nanmax(highs)), missing=missing)
