"""The log files of one recording → its channels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from itertools import pairwise
from pathlib import Path

import numpy as np

from sysid import scratch
from sysid.datasets.channel import Channel, convert, counts_of, in_order
from sysid.datasets.checks.flag import ends_of, repaired_stamps, sentinels
from sysid.datasets.chunked import Array, masked
from sysid.datasets.clocks.set_clocks import with_continued_stamps
from sysid.datasets.discover import RecordingFiles, check_refused, count_files
from sysid.datasets.frames.bodies import MissingFrames, find_mounts, joints_and_points
from sysid.datasets.frames.rigid import POSE_FIELDS, mean_pose, with_marker_sets
from sysid.datasets.recipe import SignalMap, StreamMap
from sysid.datasets.wrapping import continuous, in_range
from sysid.errors import InputError, SettingsError, nearest
from sysid.logs import ReadOptions, Stream, reader_for, reader_named
from sysid.logs.reader import read_confined
from sysid.logs.rosbag import bag_of
from sysid.logs.table import no_numbers
from sysid.machine import Machine
from sysid.names import listed
from sysid.numbers import LARGEST_COUNT
from sysid.progress import Progress, part, silent
from sysid.units import split_header

#: (recording, key of the recipe's entry) → body → its mount on its link.
Mounts = Mapping[tuple[str, str], Mapping[str, Array]]
#: Key of the recipe's entry → body → its poses on its link, (4, 4) each.
ReferencePoses = Mapping[str, Mapping[str, Sequence[Array]]]


@dataclass(frozen=True)
class ReadRecording:
    """Content of one recording: channels, file name → losses, dropped frames.

    ``refused``: ``recording/file`` → why it cannot be used; then there are no channels.
    """

    channels: tuple[Channel, ...]
    losses: Mapping[str, tuple[str, ...]]
    flags: tuple[MissingFrames, ...] = ()
    refused: Mapping[str, InputError] = field(default_factory=dict)


def survey_mounts(found: Sequence[RecordingFiles], machine: Machine, recipe_place: str) -> Mounts:
    """Mounts of the rigid bodies on their links, for each recording, from the reference poses of the recipe.

    ``recipe_place``: of the recipe, in a remedy.

    Raises:
        InputError: a body is not visible, or moves, in the reference pose; of all such files at once.
        SettingsError: no reference, or it names a missing recording.
    """
    return combined_mounts(found, [(files.name, reference_poses(files, machine)) for files in found], recipe_place)


def reference_poses(files: RecordingFiles, machine: Machine) -> tuple[ReferencePoses, dict[str, InputError]]:
    """Poses of the rigid bodies on their links in the reference poses of one recording; none where it contains no reference.

    Also ``recording/file`` → why there is none: a file that cannot be read, a body that is not visible or moves.
    """
    found: dict[str, dict[str, list[Array]]] = {}
    refused: dict[str, InputError] = {}
    for path, mapping in files.streams:
        if mapping is None or not mapping.bodies:
            continue
        pattern = mapping.reference.recording if mapping.reference is not None else None
        if pattern is None or fnmatchcase(files.name, pattern):
            until = mapping.reference.seconds[1] if mapping.reference is not None else None
            try:
                found[mapping.key] = find_mounts(read_streams(path, mapping, until), mapping, machine)
            except InputError as error:
                refused[f"{files.name}/{path.name}"] = error
    return found, refused


def combined_mounts(
    found: Sequence[RecordingFiles],
    surveyed: Sequence[tuple[str, tuple[ReferencePoses, Mapping[str, InputError]]]],
    recipe_place: str,
) -> Mounts:
    """Mounts for each recording: of its own reference pose, or the mean of all where they share one.

    Args:
        surveyed: recordings and their :func:`reference_poses`; one without bodies may be missing.

    Raises:
        InputError: a body is not visible, or moves, in the reference pose; of all such files at once.
        SettingsError: a reference names a missing recording.
    """
    own = {(name, key): bodies for name, (poses, _) in surveyed for key, bodies in poses.items()}
    refused = {key: error for _, (_, errors) in surveyed for key, error in errors.items()}
    check_refused(refused, count_files(found), recipe_place)
    with_bodies = [(files.name, m) for files in found for _, m in files.streams if m is not None and m.bodies]
    mounts: dict[tuple[str, str], dict[str, Array]] = {}
    for name, mapping in with_bodies:
        shared = mapping.reference is not None and mapping.reference.recording is not None
        sources = [m for (_, files), m in own.items() if files == mapping.key] if shared else [own[name, mapping.key]]
        if not sources:
            pattern = mapping.reference.recording if mapping.reference is not None else ""
            where = f"streams {mapping.files!r}: reference.recording"
            raise SettingsError(where, f"no recording {pattern!r}", nearest(str(pattern), [files.name for files in found]))
        mounts[name, mapping.key] = {
            body: mean_pose(np.stack([pose for source in sources for pose in source[body]])) for body in mapping.bodies
        }
    return mounts


def read_channels(files: RecordingFiles, machine: Machine, mounts: Mounts, progress: Progress = silent) -> ReadRecording:
    """All mapped signals of a recording. ``progress``: called with the share of its bytes that have been read.

    A file is refused that cannot be read, lacks a field or topic, or has a wrong unit or stamps that go back; the others are
    read all the same, so that all that are refused are known at once.

    Raises:
        InputError: a signal that none of its files has, or that two have.
    """
    channels: list[Channel] = []
    losses: dict[str, tuple[str, ...]] = {}
    flags: list[MissingFrames] = []
    refused: dict[str, InputError] = {}
    shares = _shares(files)
    parts = Counter(id(mapping) for _, mapping in files.streams if mapping is not None)
    for (path, mapping), (begin, end) in zip(files.streams, shares, strict=True):
        done = part(progress, begin, end)
        try:
            own, said, dropped = _read_file(path, mapping, machine, mounts, files.name, parts[id(mapping)] > 1, channels, done)
        except InputError as error:
            refused[f"{files.name}/{path.name}"] = error
            continue
        channels += own
        flags += dropped
        losses[path.name] = tuple(dict.fromkeys((*losses.get(path.name, ()), *said)))
        scratch.leave()
    if refused:
        return ReadRecording((), losses, (), refused)
    _check_parts(files, channels)
    if any(mapping is None for _, mapping in files.streams):
        channels = _one_clock(channels)
    return ReadRecording(tuple(in_range(channels, machine)), losses, tuple(flags))


def _read_file(
    path: Path,
    mapping: StreamMap | None,
    machine: Machine,
    mounts: Mounts,
    recording: str,
    is_part: bool,
    before: Sequence[Channel],
    progress: Progress,
) -> tuple[list[Channel], list[str], tuple[MissingFrames, ...]]:
    """Channels of one file in its mapping, what was lost or assumed, and dropped frames; ``before``: channels of other files.

    Raises:
        InputError: the file cannot be used.
    """
    streams = read_streams(path, mapping, progress=progress, expected_hz=machine.rate_hz, is_part=is_part)
    progress(1.0, f"reading {path.name}")
    if mapping is None:
        commands = any(column.endswith(".command") for stream in streams for column in stream.columns)
        streams = with_continued_stamps(streams, None, machine=not before or commands)
    said = [loss for stream in streams for loss in (*stream.losses, *(stream.left_out if mapping is None else ()))]
    said += _mixed_clocks(streams) if mapping is not None and mapping.clock is None else ()
    absent = _absent(streams, mapping) if mapping is not None and is_part else {}
    said += absent.values()
    own = _canonical(path, streams, machine) if mapping is None else _mapped(path, streams, mapping, machine, absent)
    channels = [channel for channel, _ in own]
    said += [text for _, text in own if text]
    if mapping is None or not (mapping.bodies or mapping.points):
        return channels, said, ()
    captured, dropped = joints_and_points(streams, mapping, mounts.get((recording, mapping.key), {}), machine)
    return channels + captured, said, dropped


def _mixed_clocks(streams: Sequence[Stream]) -> tuple[str, ...]:
    """A note where the first clocks of the streams of a file differ, and the recipe does not choose one."""
    topics: dict[str, list[str]] = {}
    for stream in streams:
        topics.setdefault(next(iter(stream.stamps)), []).append(stream.name)
    if len(topics) < 2:
        return ()
    each = "; ".join(f"{clock} stamps of {listed(names, 3)}" for clock, names in topics.items())
    return (f"{each} are taken as one clock: state `clock` in the recipe to have one of them",)


def _absent(streams: Sequence[Stream], mapping: StreamMap) -> dict[str, str]:
    """Signal → why a part of a bag does not have it: nothing was sent on its topic in this part."""
    known = {(stream.name, name) for stream in streams for name in stream.columns}
    return {
        signal: f"{signal}: no {entry.field!r} of {entry.topic!r} in this part of the bag"
        for signal, entry in mapping.signals.items()
        if entry.topic is not None and (entry.topic, entry.field) not in known
    }


def _check_parts(files: RecordingFiles, channels: Sequence[Channel]) -> None:
    """Raise InputError where no part of a bag has a signal."""
    found = {channel.signal for channel in channels}
    for path, mapping in files.streams:
        for signal, entry in mapping.signals.items() if mapping is not None else ():
            if signal not in found:
                absent = f"no {entry.field!r} of {entry.topic!r} in any of its files"
                raise InputError(
                    f"{files.name}: {signal}", absent, f"as in {path.name}", "Correct `topic` and `field` in the recipe."
                )


def _shares(files: RecordingFiles) -> list[tuple[float, float]]:
    """Begin and end of each file as shares of the bytes of the recording."""
    sizes = [max(1, path.stat().st_size) for path, _ in files.streams]
    ends = np.cumsum([0, *sizes]) / sum(sizes) if sizes else np.zeros(1)
    return list(pairwise(ends.tolist()))


def read_streams(
    path: Path,
    mapping: StreamMap | None,
    seconds: float | None = None,
    progress: Progress = silent,
    expected_hz: float | None = None,
    is_part: bool = False,
) -> tuple[Stream, ...]:
    """The streams of a file in its mapping, with the rigid bodies of marker sets; all without a mapping.

    ``seconds``: later samples after the first stamp are not needed. ``expected_hz``: rate of the machine [Hz]. ``is_part``: of
    a bag in several files, so that a topic may have no message in this one.
    """

    def report(share: float) -> None:
        progress(share, f"reading {path.name}")

    if mapping is None:
        return read_confined(reader_for(path), path, ReadOptions(progress=report, expected_hz=expected_hz))
    reader = reader_named(mapping.reader, path) if mapping.reader is not None else reader_for(path)
    wanted = {signal.topic for signal in mapping.signals.values() if signal.topic is not None}
    tracked = {*mapping.bodies, *(point.body or point.marker or "" for point in mapping.points.values())}
    wanted |= tracked - mapping.marker_sets.keys()
    wanted |= {marker for markers in mapping.marker_sets.values() for marker in markers}
    fields: dict[str, set[str]] = {}
    for signal in mapping.signals.values():
        if signal.topic is not None:
            fields.setdefault(signal.topic, set()).add(signal.field)
    if fields:
        for name in wanted & {*tracked, *(m for markers in mapping.marker_sets.values() for m in markers)}:
            fields.setdefault(name, set()).update(POSE_FIELDS)
    options = ReadOptions(
        streams=frozenset(wanted) if wanted else None,
        fields={topic: frozenset(own) for topic, own in fields.items()} if fields else None,
        columns=frozenset(name for signal in mapping.signals.values() for name in _names(signal)) if mapping.signals else None,
        part=is_part,
        seconds=seconds,
        time=mapping.time,
        time_unit=mapping.time_unit,
        expected_hz=expected_hz,
        rate_hz=mapping.rate_hz,
        header=mapping.columns,
        delimiter=mapping.delimiter,
        decimal=mapping.decimal,
        length_unit=mapping.length_unit,
        rotation=mapping.rotation,
        dbc=Path(mapping.dbc) if mapping.dbc is not None else None,
        progress=report,
    )
    streams = with_continued_stamps(read_confined(reader, path, options), mapping.clock, mapping.domain == "machine")
    return with_marker_sets(streams, mapping)


def _mapped(
    path: Path, streams: Sequence[Stream], mapping: StreamMap, machine: Machine, absent: Container[str]
) -> list[tuple[Channel, str]]:
    """Channels of the mapped fields except ``absent`` ones, with what was undone in each."""
    channels = []
    for signal, entry in mapping.signals.items():
        if signal in absent:
            continue
        stream = _stream_of(path, streams, entry, signal)
        found = replace(entry, field=next((name for name in _names(entry) if name in stream.columns), entry.field))
        primary = entry.primary and signal not in mapping.secondary
        channels.append(_channel(path, stream, signal, found, mapping, machine, primary))
        scratch.leave()
    return channels


def _names(entry: SignalMap) -> tuple[str, str]:
    """The field of a table as the recipe names it, and without the unit of its header."""
    return entry.field, split_header(entry.field)[0]


def _stream_of(path: Path, streams: Sequence[Stream], entry: SignalMap, signal: str) -> Stream:
    if entry.topic is None:
        if len(streams) == 1:
            return streams[0]
        raise SettingsError(f"{path}: {signal}", "no topic", f"one of: {', '.join(sorted(s.name for s in streams))}")
    for stream in streams:
        if stream.name == entry.topic:
            return stream
    raise InputError(f"{path}: {signal}", f"no topic {entry.topic!r}", nearest(entry.topic, [s.name for s in streams]))


def _channel(
    path: Path, stream: Stream, signal: str, entry: SignalMap, mapping: StreamMap, machine: Machine, primary: bool
) -> tuple[Channel, str]:
    converted = convert(stream, entry, signal, machine)
    every = stream.on_clock(mapping.clock)  # shared by all signals of a stream
    stamps, values = every, converted.values
    there = masked(len(values), lambda first, last: ~np.isnan(values[first:last]))
    if not there.all():  # a row without a value is no sample: each signal has its own rate and its own gaps
        stamps, values = scratch.chosen(stamps, there), scratch.chosen(values, there)
    order, late = in_order(stamps, f"{path}: {stream.name}")
    counts = counts_of(stamps, values, order, late)
    repaired = late + len(stamps) - len(order)
    if len(order) < 2 and not signal.endswith(".command"):  # a single command is held
        found = f"{len(stamps)} sample{'s' if len(stamps) > 1 else ''} with {len(order)} stamp in {stream.name!r}"
        raise InputError(f"{path}: {signal}", found, "two at least", "Record longer, or leave the signal out of the recipe.")
    channel = Channel(
        signal=signal,
        source=path.name,
        domain=mapping.domain,
        stamps=stamps[order] if repaired else stamps,
        values=values[order] if repaired else values,
        unit=converted.unit,
        primary=primary,
        interpolation=mapping.interpolation,
        max_gap_s=mapping.max_gap_s,
        counts=replace(
            counts, rows=len(stream), empty=len(stream) - len(stamps) - converted.overflows, overflows=converted.overflows
        ),
        flags=(
            *sentinels(signal, stream.columns[entry.field], converted.values, every, ends_of(signal, machine)),
            *(repaired_stamps(signal, stamps) if repaired else ()),
        ),
    )
    unwrapped, undone = continuous(channel, entry, converted.per_raw, machine)
    said = []
    if converted.missing:
        numbers = ", ".join(f"{number:.10g}" for number in entry.missing)
        said.append(f"{signal}: {converted.missing} values {numbers} taken as missing")
    if count := converted.overflows:
        said.append(f"{signal}: {count} overflow{'s' if count > 1 else ''} (beyond {LARGEST_COUNT:g}) taken as missing")
    return unwrapped, "; ".join([*said, *([undone] if undone else [])])


def _canonical(path: Path, streams: Sequence[Stream], machine: Machine) -> list[tuple[Channel, str]]:
    """Channels of a file whose columns are canonical names, with what was undone in each; on a clock of the file or its bag."""
    domain = (bag_of(path) or path).stem
    channels = []
    for stream in streams:
        for column, reason in stream.unread.items():
            if column in machine.signals:
                raise no_numbers(path, column, reason)
        for column in stream.columns:
            if column not in machine.signals:
                raise InputError(
                    path,
                    f"unknown column {column!r}",
                    nearest(column, machine.signals),
                    "Rename the column, or map the file with a recipe.",
                )
            mapping = StreamMap(files=path.name, domain=domain)
            channels.append(_channel(path, stream, column, SignalMap(field=column), mapping, machine, primary=True))
            scratch.leave()
    return channels


def _one_clock(channels: Sequence[Channel]) -> list[Channel]:
    """``channels`` with the file of the commands (else the first) on the machine's clock."""
    with_command = [channel.domain for channel in channels if channel.signal.endswith(".command")]
    machine_domain = (with_command or [channel.domain for channel in channels])[0]
    return [replace(c, domain="machine") if c.domain == machine_domain else c for c in channels]


def joined(channels: Sequence[Channel], where: object) -> dict[str, list[Channel]]:
    """Signal → its primary channels (parts of one log in several files).

    Raises:
        InputError: two files give the same signal for the same time and neither is named secondary.
    """
    signals: dict[str, list[Channel]] = {}
    for channel in channels:
        if channel.primary and len(channel.stamps):
            signals.setdefault(channel.signal, []).append(channel)
    for signal, parts in signals.items():
        parts.sort(key=lambda part: int(part.stamps[0]))
        for before, after in pairwise(parts):
            if after.clock != before.clock or after.stamps[0] <= before.stamps[-1]:
                raise InputError(
                    f"{where}: {signal}",
                    f"two sources, {before.source!r} and {after.source!r}",
                    "one primary source",
                    "Name the other one secondary in the recipe (`primary = false` or `secondary = [...]`). Where each file is "
                    "a recording of its own, list them in `[recordings.files]`.",
                )
    return signals


def concatenate(parts: Sequence[Channel]) -> Channel:
    """Consecutive parts of one signal as one channel."""
    if len(parts) == 1:
        return parts[0]
    rows = sum(len(part.stamps) for part in parts)
    return replace(
        parts[0],
        stamps=np.concatenate([part.stamps for part in parts], out=scratch.empty(rows, np.int64)),
        values=np.concatenate([part.values for part in parts], out=scratch.empty(rows)),
    )
