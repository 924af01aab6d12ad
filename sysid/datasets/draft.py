"""A recipe drafted from the content of logs: recognised entries, and commented lines for what only the user knows."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from glob import escape
from pathlib import Path

from sysid.datasets.layouts import TABLES, Layout, bags_of, glob_of, layouts_of, recording_names, refusal_of, unreadable
from sysid.datasets.words import NO_SIGNAL, says_command, signal_of, words_without_numbers
from sysid.errors import InputError
from sysid.logs.inspection import FieldSummary, FileSummary, StreamSummary
from sysid.logs.lerobot import KIND, LeRobotReader
from sysid.logs.readers import READERS
from sysid.machine import Machine
from sysid.names import listed
from sysid.quoting import comment, toml_key, toml_value
from sysid.units import si_factor

#: Messages of these packages are in SI (ROS REP 103).
_SI_PACKAGES = ("sensor_msgs/", "geometry_msgs/", "nav_msgs/", "tf2_msgs/", "control_msgs/", "trajectory_msgs/")
#: SI units that signals have; a command in another one is converted by `zero` and `span`.
_UNITS = ("1", "rad", "m", "rad/s", "m/s", "N", "N·m")
#: Listed fields of one stream, and of those that are no signals; the others are counted.
MAX_LINES, MAX_LISTED = 80, 8
_HEAD = """\
# Drafted from {names}.
# A line without "#" has been recognised: check it. Of the others remove the "#" where you need them and fill in what is in
# <…>; remove the rest. Each field is followed by its range. docs/recipes.md describes every key.
schema = 1
"""


@dataclass(frozen=True)
class Chosen:
    """Lines of signals that are decided.

    Args:
        name: of the dataset.
        lines: by what separates files with the same fields, topic (of a table its file's stem, or empty) and field → the line.
        apart: file → what separates it; files without an entry have the lines of the empty one.
        without: file that can be read and is left out → why; ``episodes``: recording of a file with several → why.
    """

    name: str
    lines: Mapping[str, Mapping[tuple[str, str], str]]
    apart: Mapping[Path, str]
    without: Mapping[Path, str]
    episodes: Mapping[str, str]


def draft_recipe(
    files: Sequence[FileSummary],
    machine: Machine | None = None,
    machine_path: str = "machine.toml",
    logs: str | None = None,
    in_folders: bool = False,
    root: Path | None = None,
    chosen: Chosen | None = None,
) -> str:
    """TOML of a recipe for ``files``; with ``machine`` its axes are recognised in the names of the fields.

    ``machine_path`` and ``logs`` (the folder of the recordings) are relative to the recipe. ``in_folders``: there are files in
    sub-folders; else each file in a folder may be a recording. ``root``: the folder of the recordings. ``chosen``: the
    lines of signals, where all are decided already; the other fields are left out.
    """
    lines = [_HEAD.format(names=", ".join(sorted({comment(file.path.name) for file in files})[:6]) or "nothing")]
    lines += [f"name = {toml_value(chosen.name)}"] if chosen is not None else []
    known = machine is not None or chosen is not None
    lines.append(f"{'' if known else '# '}machine = {toml_value(machine_path)}")
    if logs is not None:
        lines.append(f"logs = {toml_value(logs)}")
    damaged, without = unreadable(files), chosen.without if chosen is not None else {}
    files = [file for file in files if file not in damaged]
    names, single = recording_names(files, in_folders, [_sure(file, machine) for file in files])
    names |= {file.path: _damaged_name(file.path, {*names.values()} if single else None) for file in damaged}
    reasons = {file.path: refusal_of(file) for file in damaged} | dict(without)
    episodes_without = chosen.episodes if chosen is not None else {}
    if reasons or episodes_without:
        left = [*((path.name, why) for path, why in reasons.items()), *episodes_without.items()]
        lines += ["", *(f"# left out: {name}: {comment(why)}" for name, why in left), "[recordings]"]
        keys = [escape(f"{names[path]}/{path.name}") for path in reasons]
        keys += [f"{escape(name)}/*" for name in episodes_without]
        lines += [f"left_out = [{', '.join(map(toml_value, dict.fromkeys(keys)))}]"]
    files = [file for file in files if file.path not in without]
    layouts = layouts_of(files, names, chosen.apart if chosen is not None else None)
    if single:
        lines += ["", "[recordings.files]          # each file, or bag in several files, is a recording of its own"]
        for name in dict.fromkeys(names.values()):
            own = [path for path in names if names[path] == name]
            pattern = glob_of(own, [*names]) if len(own) > 1 else None
            lines.append(f"{toml_key(name)} = {toml_value(_relative(own[0], root, pattern))}")
    elif not in_folders and len({*bags_of(files).values()}) > 1:
        lines += ["", "# The files are taken for one recording. Where each is a recording of its own:", "# [recordings.files]"]
        lines += [f"# {toml_key(file.path.stem)} = {toml_value(file.path.name)}" for file in files]
    episodes = LeRobotReader().name
    of_files = ([s.name for s in file.streams] if file.reader == episodes else [names[file.path]] for file in files)
    recordings = dict.fromkeys(name for own in of_files for name in own)
    if len(recordings) < 3 and (in_folders or single):
        lines += [
            "",
            "# [splits]                  # a recording is cut into the three parts that sysid gap needs; to keep it whole:",
        ]
        lines += [f"# fit = [{', '.join(map(toml_value, recordings))}]"]
    candidates = Counter(
        (signal, recording)
        for layout in layouts
        for stream in _listed(layout.whole)
        for signal in _recognised(layout.whole, stream, machine)
        for recording in layout.recordings
    )
    for layout in layouts:
        doubtful = {signal for (signal, recording), count in candidates.items() if count > 1 and recording in layout.recordings}
        empty = layout.whole.reader in TABLES and not any(stream.fields for stream in layout.whole.streams)
        for files_, recordings_ in layout.entries:
            if empty:
                lines += ["", f"# left out: {comment(files_)}: no column of numbers beside the stamps"]
                continue
            lines += ["", *_stream(layout, files_, recordings_, machine, doubtful, chosen)]
    return "\n".join(lines) + "\n"


def _damaged_name(path: Path, others: Set[str] | None) -> str:
    """The recording of a file that cannot be read: its folder's, or its own where each file is one beside ``others``."""
    folder = path.resolve().parent.name
    return folder if others is None else path.stem if path.stem not in others else f"{folder}-{path.stem}"


def missing_strokes(files: Sequence[FileSummary], machine: Machine) -> list[str]:
    """For each axis with a cylinder but without a stroke the key that ``machine.toml`` needs, with the range in the logs."""
    lines = []
    for axis in machine.axes:
        if axis.drives != "cylinder" or axis.stroke is not None:
            continue
        found: dict[str, list[FieldSummary]] = {}
        for file in files:
            for stream in _listed(file):
                topic = "" if _is_table(file) else stream.name
                for field in _moving(stream):
                    if signal_of(topic, field.name, machine, stream.kind) == (f"{axis.name}.cylinder", True):
                        found.setdefault(f"{topic} {field.name}".strip(), []).append(field)
        ranges = [f"{name!r} ({_stroke_of(fields)})" for name, fields in found.items()]
        logs = (
            f"the logs show of {listed(ranges, MAX_LISTED)}" if ranges else "no field of the logs is recognised as its cylinder"
        )
        lines.append(f"axis {axis.name!r} needs stroke = [lo, hi] [m] in machine.toml; {logs}")
    return lines


def _stroke_of(fields: Sequence[FieldSummary]) -> str:
    low, high = min(field.low for field in fields), max(field.high for field in fields)
    unit = fields[0].unit or _unit_in_name(fields[0].name)
    try:
        factor, si = si_factor(unit) if unit is not None else (1.0, "")
    except InputError:
        si = ""
    if si != "m":
        return f"{low:.6g} … {high:.6g}, of no stated length unit"
    return f"at least stroke = [{factor * low:.6g}, {factor * high:.6g}]"


def _relative(path: Path, root: Path | None, pattern: str | None = None) -> str:
    """The path of a file for ``[recordings.files]``, or ``pattern`` in its place, a glob below the folder of recordings."""
    inside = root is not None and path.is_relative_to(root)
    parts = path.relative_to(root).parts if inside and root is not None else (path.name,)
    return "/".join((*map(escape, parts[:-1]), pattern or escape(parts[-1])))


def _sure(file: FileSummary, machine: Machine | None) -> set[str]:
    """Signals that are recognised in the names of the fields of a file."""
    found = set()
    for stream in file.streams if machine is not None else ():
        topic = "" if file.reader in TABLES else stream.name
        for field in stream.fields:
            signal, sure = signal_of(topic, field.name, machine, stream.kind)
            found |= {signal} if sure else set()
    return found


def _stream(
    layout: Layout,
    pattern: str,
    recordings: Sequence[str],
    machine: Machine | None,
    doubtful: Set[str],
    chosen: Chosen | None,
) -> Iterator[str]:
    file = layout.whole
    by_suffix = next((r.name for r in READERS if file.path.suffix.lower() in r.suffixes), None)
    clocks = [clock.name for clock in file.streams[0].clocks]
    captured = clocks[:1] == ["capture"]
    yield "[[streams]]"
    if file.reader in ("can", "mf4"):
        yield '# dbc = "<file>.dbc"          # database of the CAN frames: inspect again with --dbc'
    yield f"files = {toml_value(pattern)}{_found(layout)}"
    if recordings:
        yield f"recordings = [{', '.join(map(toml_value, recordings))}]   # other recordings have other fields in such files"
    if by_suffix != file.reader:
        yield f"reader = {toml_value(file.reader)}"
    if file.columns:
        yield "# The file has no header row: columns are numbered here. Better names may be given, also below."
        yield f"columns = [{', '.join(map(toml_value, file.columns))}]"
    first = {clock.name for stream in file.streams for clock in stream.clocks[:1]}
    if len(first) > 1:
        every = [clock for clock in clocks if all(clock in {c.name for c in stream.clocks} for stream in file.streams)]
        named = [comment(stream.name) for stream in file.streams if stream.clocks and stream.clocks[0].name != every[0]]
        others = f"; {clocks[0]} stamps: an entry of its own for {', '.join(named[:4])}{' …' if len(named) > 4 else ''}"
        yield f"clock = {toml_value(every[0])}   # all topics have it{others if named else ''}"
    elif clocks:
        others = f"   # or {', '.join(clocks[1:])}" if len(clocks) > 1 else ""
        yield f"clock = {toml_value(clocks[0])}{others}"
    else:
        yield '# time = "<column>"          # the column of the time; time_unit = "ms" where it is not in seconds'
        yield "# rate_hz = <rate>           # or, where no column has the time, the rate of evenly spaced rows [Hz]"
    yield f'domain = "{"mocap" if captured else "machine"}"   # the device of that clock; any other name for another device'
    for key, value in file.stated.items():
        if key == "time_unit" and file.time_units:
            units = " or ".join(unit.unit for unit in file.time_units)
            yield f'time_unit = "<{units}>"   # not stated in the file: {" or ".join(map(str, file.time_units))}'
        else:
            yield f"{key} = {toml_value(value)}   # not stated in the file: check it"
    rest = _listed(file)
    bodies = [stream for stream in file.streams if stream not in rest and _is_body(stream)]
    markers = [stream for stream in file.streams if stream not in rest and not _is_body(stream)]
    if bodies or markers:
        yield from _capture(bodies, markers, machine)
    if rest:
        yield "[streams.signals]"
        yield from _signals(file, rest, machine, doubtful, chosen)


def _found(layout: Layout) -> str:
    """A comment on number and form of the files of a layout."""
    count = f"{len(layout.files)} files; ranges are those of all" if len(layout.files) > 1 else ""
    text = "; ".join(filter(None, (count, *layout.whole.remarks)))
    return f"   # {comment(text)}" if text else ""


def _signals(
    file: FileSummary,
    streams: Sequence[StreamSummary],
    machine: Machine | None,
    doubtful: Set[str],
    chosen: Chosen | None,
) -> Iterator[str]:
    tables = _is_table(file)
    for stream in streams:
        moving = _moving(stream)
        if not tables:
            kind = f" ({comment(stream.kind)})" if stream.kind else ""
            yield f"# {comment(stream.name)}{kind}: {stream.samples} samples"
        if chosen is not None:
            lines = chosen.lines[chosen.apart.get(file.path, "")]
            of_file = file.path.stem if any(topic == file.path.stem for topic, _ in lines) else ""
            keys = [(of_file if tables else stream.name, field.name) for field in stream.fields]
            yield from (lines[key] for key in keys if key in lines)
            others = [comment(field.name) for key, field in zip(keys, stream.fields, strict=True) if key not in lines]
            if others:
                yield f"# left out: {', '.join(others[:MAX_LINES])}{' …' if len(others) > MAX_LINES else ''}"
            continue
        usable = [field for field in moving if not _foreign(stream, field)]
        for field in usable[:MAX_LINES]:
            line = _line("" if tables else stream.name, field, machine, stream.kind)
            yield line.text(line.signal in doubtful)
        still = len(stream.fields) - len(moving)
        if still:
            yield f"# {still} more fields are constant, covariances or stamps"
        if len(usable) > MAX_LINES:
            yield f"# {len(usable) - MAX_LINES} more fields"
        foreign = [f"{comment(field.name)} [{comment(field.unit or '')}]" for field in moving if _foreign(stream, field)]
        if foreign:
            more = f" and {len(foreign) - MAX_LISTED} more" if len(foreign) > MAX_LISTED else ""
            yield f"# no unit of a signal: {', '.join(foreign[:MAX_LISTED])}{more}"


def _is_table(file: FileSummary) -> bool:
    """Whether its fields have no topic: a table, or the episodes of a dataset, which are those of one entry."""
    return file.reader == LeRobotReader().name or (
        len(file.streams) == 1 and not file.streams[0].kind and file.reader in TABLES
    )


def _listed(file: FileSummary) -> list[StreamSummary]:
    """The streams of which fields are listed: all but bodies and markers of a motion capture."""
    captured = [clock.name for clock in file.streams[0].clocks[:1]] == ["capture"] if file.streams else False
    return [stream for stream in file.streams if not (captured and (_is_body(stream) or _is_marker(stream)))]


def _moving(stream: StreamSummary) -> list[FieldSummary]:
    """Its fields that change and may be signals."""
    return [field for field in stream.fields if field.high > field.low and not NO_SIGNAL.search(field.name)]


def _recognised(file: FileSummary, stream: StreamSummary, machine: Machine | None) -> list[str]:
    """The signals of its fields that are recognised, as often as they are."""
    topic = "" if _is_table(file) else stream.name
    lines = [_line(topic, field, machine, stream.kind) for field in _moving(stream) if not _foreign(stream, field)]
    return [line.signal for line in lines if line.sure]


def _foreign(stream: StreamSummary, field: FieldSummary) -> bool:
    """Whether the unit of a field is that of no signal, as of a temperature or a muscle, and its name is not of a command."""
    try:
        return field.unit is not None and si_factor(field.unit)[1] not in _UNITS and not says_command(stream.name, field.name)
    except InputError:
        return False


@dataclass(frozen=True)
class _Line:
    """A line of a signal.

    Args:
        sure: whether the signal is recognised, and its line complete.
    """

    signal: str
    entry: tuple[str, ...]
    note: str
    sure: bool

    def text(self, doubtful: bool) -> str:
        """The line; commented where it is not sure, or ``doubtful``: others are recognised as the same signal."""
        note = f"{self.note}; one of several for {self.signal}: choose" if doubtful and self.sure else self.note
        begin = "" if self.sure and not doubtful else "# "
        return f"{begin}{toml_value(self.signal)} = {{ {', '.join(self.entry)} }}   # {note}"


def _line(topic: str, field: FieldSummary, machine: Machine | None, kind: str) -> _Line:
    signal, sure = signal_of(topic, field.name, machine, kind)
    entry = [f"topic = {toml_value(topic)}"] if topic else []
    entry.append(f"field = {toml_value(field.name)}")
    note = f"{field.low:.4g} … {field.high:.4g}{f' {comment(field.unit)}' if field.unit else ''}"
    command, actuation = signal.endswith(".command"), _actuation(signal, machine)
    share = actuation == "velocity" or not actuation  # the command is a share of the full one
    if command and actuation == "velocity" and max(abs(field.low), abs(field.high)) > 1.5:
        entry += ["zero = <neutral>", "span = <from neutral to full>"]
        sure = False
    elif field.unit is None and (kind == KIND or not (command and share)) and not kind.startswith(_SI_PACKAGES):
        stated = _unit_in_name(field.name)
        entry.append(f"unit = {toml_value(stated or '<unit>')}")
        sure = sure and stated is not None and _fits(stated, signal, machine)
    elif field.unit is not None:
        sure = sure and _fits(field.unit, signal, machine)
    return _Line(signal, tuple(entry), note, sure)


def _fits(unit: str, signal: str, machine: Machine | None) -> bool:
    """Whether a signal may be in this unit."""
    try:
        si = si_factor(unit)[1]
    except InputError:
        return False
    expected = machine.expected_unit(signal) if machine is not None else None
    if expected is not None:
        return si == expected
    force = signal.endswith(".command") and _actuation(signal, machine) == "force"
    return si in (("rad/s", "m/s") if signal.endswith(".speed") else ("N", "N·m") if force else ("rad", "m"))


def _unit_in_name(name: str) -> str | None:
    """The unit in parentheses at the end of a name, ``Boom (mm)``; None where there is none."""
    match = re.search(r"\(([^()]{1,12})\)\s*$", name)
    if match is None:
        return None
    try:
        si_factor(match[1])
    except InputError:
        return None
    return match[1]


def _actuation(signal: str, machine: Machine | None) -> str:
    axes = machine.axes if machine is not None else ()
    return next((axis.actuation for axis in axes if signal.startswith(f"{axis.name}.")), "")


def _is_body(stream: StreamSummary) -> bool:
    return any(field.name == "qw" for field in stream.fields)


def _is_marker(stream: StreamSummary) -> bool:
    names = {field.name for field in stream.fields}
    return {"x", "y", "z"} <= names and "qw" not in names


def _capture(bodies: Sequence[StreamSummary], markers: Sequence[StreamSummary], machine: Machine | None) -> Iterator[str]:
    """Frame, bodies, points and reference pose of a motion capture."""
    kinematics = machine.kinematics() if machine is not None else None
    links = [joint.child for joint in kinematics.chain] if kinematics is not None else []
    yield "# [streams.frame]            # surveyed pose of the capture frame in the machine's base frame; else they coincide"
    yield "# translation = [<x>, <y>, <z>]"
    yield "# rpy = [<roll>, <pitch>, <yaw>]   # Motive counts y upwards: [1.5708, 0.0, 0.0] turns it to z"
    yield "[streams.points]             # a rigid body, a surveyed point in its frame, or a marker, as ee or tool"
    if bodies:
        yield f"# ee = {{ body = {toml_value(bodies[-1].name)}, at = [0.0, 0.0, 0.0] }}"
    else:
        yield f"# ee = {{ marker = {toml_value(markers[-1].name)} }}"
        listed = ", ".join(toml_value(stream.name) for stream in markers[:3])
        yield "[streams.marker_sets]        # rigid body → three or more rigidly connected markers"
        yield f"# <body> = [{listed}]"
    yield f"[streams.bodies]             # rigid body → URDF link{': ' + ', '.join(links) if links else ''}"
    for stream in bodies:
        link = [link for link in links if words_without_numbers(link) <= words_without_numbers(stream.name)]
        yield f"# {toml_key(stream.name)} = {toml_value(link[0] if len(link) == 1 else '<link>')}   # {_visible(stream)}"
    yield "# [streams.reference]        # needed with bodies: the machine at rest with known joint values"
    yield "# seconds = [0.2, 1.2]"
    axes = ", ".join(f"{axis.name} = <value>" for axis in machine.axes) if machine is not None else "<axis> = <value>"
    yield f"# joints = {{ {axes} }}"
    if markers:
        yield "# markers:"
    for stream in markers[:MAX_LINES]:
        yield f"#   {toml_value(stream.name)}: {_visible(stream)}"
    if len(markers) > MAX_LINES:
        yield f"#   and {len(markers) - MAX_LINES} more"


def _visible(stream: StreamSummary) -> str:
    share = min((1.0 - field.missing for field in stream.fields), default=0.0)
    return f"visible in {100.0 * share:.0f} % of {stream.samples} frames"


def default_machine(paths: Sequence[Path]) -> Path | None:
    """``machine.toml`` beside the logs or in the folder above, if there is one."""
    for path in paths:
        folder = path if path.is_dir() else path.parent
        for place in (folder, folder.parent):
            if (place / "machine.toml").is_file():
                return place / "machine.toml"
    return None
