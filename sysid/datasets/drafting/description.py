"""``machine.toml`` and ``recipe.toml`` for a folder of logs, each drafted value with a comment on where it is from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sysid.datasets.chunked import Array
from sysid.datasets.draft import Chosen, draft_recipe
from sysid.datasets.drafting.axes import KINDS, AxisDraft, axes_of, unit_factor
from sysid.datasets.drafting.fields import Answers, Field, Question, read_fields
from sysid.datasets.layouts import recording_names, refusal_of, unreadable
from sysid.errors import InputError
from sysid.logs.inspection import FileSummary
from sysid.machine import Machine
from sysid.names import listed
from sysid.quoting import comment, toml_value

#: Rates of controllers [Hz]; one is taken if the fastest log is within this share of it.
RATES, NEAR = (10.0, 20.0, 25.0, 30.0, 50.0, 60.0, 100.0, 125.0, 200.0, 240.0, 250.0, 400.0, 500.0, 1000.0), 0.04
#: A step between two rows is no pause up to this multiple of the median.
REGULAR = 2.01
#: Logs of one rate differ by less than this factor.
FASTER = 1.5


@dataclass(frozen=True)
class Description:
    """The two files, and what could not be decided.

    Args:
        axes: names, in the order of the columns.
        kind: hydraulic, servo or force, where the commands of all columns are of one; None otherwise.
        questions: what was not answered; the files have the proposals.
        left_out: columns and files that are not used, and why, as sentences.
    """

    machine: str
    recipe: str
    axes: tuple[str, ...]
    kind: str | None
    questions: tuple[Question, ...]
    left_out: tuple[str, ...]


def describe(
    files: Sequence[FileSummary],
    folder: Path,
    name: str,
    answers: Answers,
    kind: str | None = None,
    robot: tuple[str, Machine] | None = None,
) -> Description:
    """Draft the machine and the recipe of a folder of logs.

    Args:
        files: summaries of the log files in ``folder`` or one folder below.
        kind: hydraulic, servo or force, of all axes; None: as the data show.
        robot: text of ``machine.toml`` drafted from a robot's file, and the machine that it describes.

    Raises:
        InputError: no file with a time, or no axis in the columns.
        SettingsError: an answer that is not one of the choices.
    """
    left = [f"{file.path.name}: {refusal_of(file)}" for file in files if file.refusal]
    used = [file for file in files if not file.refusal and any(stream.clocks for stream in file.streams)]
    if not used:
        why = left[0] if left else "no column of times"
        remedy = "Look into one of them with sysid ingest --inspect."
        if any(file.untimed for file in files):
            remedy = f"Where its rows are evenly spaced, state their rate [Hz]: --set rate_hz=100. {remedy}"
        raise InputError(folder, why, "log files with a time", remedy)
    used = [_with_time_unit(file, answers) for file in used]
    in_folders = any(file.path.parent != folder for file in used)
    names, _ = recording_names(used, in_folders, [frozenset() for _ in used])
    fields = read_fields(used, names)
    axes, others, without = axes_of(fields, answers, kind)
    answers.check_used()
    left += [*others, *(f"{recording}: {why}" for recording, why in without.items())]
    kinds = [each for each, actuation in KINDS.items() if {axis.actuation for axis in axes} == {actuation}]
    if robot is not None:
        axes, others = _of_robot(axes, robot[1])
        left += others
    left += [f"{recording}: no number in {listed([name for _, name in keys], 4)}" for recording, keys in _empty(axes).items()]
    if not axes:
        seen = "; ".join(left[-4:]) or "no column changes"
        columns = listed([field.label for field in fields], 8)
        remedy = f"Assign columns: --set AXIS.command=COLUMN --set AXIS.motion=COLUMN, of {columns}."
        raise InputError(folder, f"no axis with a command and a motion ({seen})", "both, by the names of columns", remedy)
    rate, why = _rate(fields)
    machine = _machine_text(name, axes, rate, why) if robot is None else _with_rate(robot[0], rate, why)
    recipe = draft_recipe(
        [*used, *unreadable(files)], None, "machine.toml", ".", in_folders, folder, _chosen(name, axes, names, without)
    )
    return Description(
        machine, recipe, tuple(axis.name for axis in axes), next(iter(kinds), None), tuple(answers.asked), tuple(left)
    )


def _with_time_unit(file: FileSummary, answers: Answers) -> FileSummary:
    """The file with one unit of its time, where several are plausible."""
    if len(file.time_units) < 2:
        return file
    units = tuple(each.unit for each in file.time_units)
    why = f"The time of {file.path.name} may be in {' or '.join(map(str, file.time_units))}"
    unit = answers.of(Question("time_unit", units[0], why, units))
    return replace(file, stated={**file.stated, "time_unit": unit}, time_units=())


def _chosen(name: str, axes: Sequence[AxisDraft], recordings: Mapping[Path, str], without: Mapping[str, str]) -> Chosen:
    """The lines of all axes; files of recordings in other units, or in which one of the columns is empty, have lines of their
    own, those ``without`` none.
    """
    empty = _empty(axes)
    others = {recording for axis in axes for recording in axis.units} | empty.keys()
    lines = {"": {key: line for axis in axes for key, line in _lines(axis)}}
    for other in others:
        in_its_units = (replace(axis, unit=axis.units.get(other, axis.unit)) for axis in axes)
        of_it = {key: line for axis in in_its_units for key, line in _lines(axis)}
        lines[other] = {key: line for key, line in of_it.items() if key not in empty.get(other, ())}
    apart = {path: recording for path, recording in recordings.items() if recording in others}
    left = {path: without[recording] for path, recording in recordings.items() if recording in without}
    episodes = {recording: why for recording, why in without.items() if recording not in recordings.values()}
    return Chosen(name, lines, apart, left, episodes)


def _empty(axes: Sequence[AxisDraft]) -> dict[str, list[tuple[str, str]]]:
    """Recording → topic and name of the columns of axes that have no number in it."""
    found: dict[str, list[tuple[str, str]]] = {}
    for column in (column for axis in axes for column in (axis.command, axis.motion)):
        for one in column.series:
            if not np.isfinite(one.values).any():
                found.setdefault(one.recording, []).append((column.topic, column.name))
    return found


def _of_robot(axes: Sequence[AxisDraft], machine: Machine) -> tuple[list[AxisDraft], list[str]]:
    """The axes with the names of the robot's: by their words, else by their number in the order of the axes; one is the one."""
    names, found, left = machine.axis_names, dict[str, AxisDraft](), list[str]()
    for axis in axes:
        words = axis.command.axis
        same = [name for name in names if name == axis.name or name.replace("_", "") == words.replace("_", "")]
        number = next((int(part) for part in words.split("_") if part.isdecimal()), None)
        first = min((int(p) for a in axes for p in a.command.axis.split("_") if p.isdecimal()), default=1)
        place = number - first if number is not None else None
        if len(axes) == len(names) == 1:
            same = [*names]
        elif not same and place is not None and 0 <= place < len(names):
            same = [names[place]]
        if len(same) == 1 and same[0] not in found:
            found[same[0]] = replace(axis, name=same[0], drives=machine.axis(same[0]).drives)
        else:
            left.append(f"{axis.command.label}: no joint of the robot has this name")
    return [found[name] for name in names if name in found], left


def _rate(fields: Sequence[Field]) -> tuple[float, str]:
    """Rate of the fastest logs, as a controller would have it, and where it is from."""
    series = {id(one.time): one.time for field in fields for one in field.series}
    rates = [rate for time in series.values() if math.isfinite(rate := _rows_per_second(time))] or [50.0]
    fastest = float(np.median([rate for rate in rates if rate >= max(rates) / FASTER]))
    near = min(RATES, key=lambda rate: abs(rate - fastest))
    rate = near if abs(near - fastest) <= NEAR * near else float(f"{fastest:.3g}")
    return rate, f"even time grid of the dataset [Hz]; the fastest logs have {fastest:.4g}"


def _rows_per_second(time: Array) -> float:
    """Rate of stamps [s]: by the mean of their steps without pauses, which rounded stamps keep; NaN without a step."""
    steps = np.diff(time)
    steps = steps[steps > 0.0]
    if not len(steps):
        return math.nan
    regular = steps[steps <= REGULAR * np.median(steps)]
    return 1.0 / float(np.mean(regular))


def _with_rate(text: str, rate: float, why: str) -> str:
    lines = [f"rate_hz = {rate}   # {why}" if line.startswith("rate_hz") else line for line in text.splitlines()]
    return "\n".join(lines) + "\n"


def _machine_text(name: str, axes: Sequence[AxisDraft], rate: float, why: str) -> str:
    lines = [
        "# Drafted from logs. SI units (m, rad, s). Every value has a comment on where it is from: correct it here.",
        "schema = 1",
        f"name = {toml_value(name)}",
        f"rate_hz = {rate}   # {why}",
    ]
    for axis in axes:
        lines += ["", "[[axes]]", f"name = {toml_value(axis.name)}"]
        lines.append(f"actuation = {toml_value(axis.actuation)}{_note(axis, 'actuation')}")
        lines.append(f"drives = {toml_value(axis.drives)}")
        if axis.actuation == "velocity":
            lines.append(f"gain = {axis.gain:.4g}{_note(axis, 'gain')}")
        if math.isfinite(axis.inertia):
            lines.append(f"inertia = {axis.inertia:.4g}{_note(axis, 'inertia')}")
        if axis.actuation != "position":
            known = "gain" if axis.actuation == "velocity" else "inertia"
            lines.append(f'estimated = ["{known}"]   # {known} is from these logs: remove this line where you know it')
        if axis.drives == "joint" and axis.unit in ("m", "mm", "cm"):
            lines.append('joint_type = "prismatic"')
        key = "stroke" if axis.drives == "cylinder" else "limits"
        lines.append(f"{key} = [{axis.ends[0]:.6g}, {axis.ends[1]:.6g}]{_note(axis, 'ends')}")
    return "\n".join(lines) + "\n"


def _note(axis: AxisDraft, key: str) -> str:
    return f"   # {comment(axis.notes[key])}" if key in axis.notes else ""


def _lines(axis: AxisDraft) -> list[tuple[tuple[str, str], str]]:
    """The lines of command and motion in the recipe, by topic and field."""
    command = _entry(axis.command)
    if axis.actuation == "velocity":
        if (axis.zero, axis.span) != (0.0, 1.0):
            command += [f"zero = {axis.zero:.9g}", f"span = {axis.span:.9g}"]
        if axis.sign < 0:
            command.append("sign = -1")
    elif axis.command_unit:
        command += [f"scale = {axis.scale:.9g}"] if axis.scale != 1.0 else []
        command += _unit(axis.command_unit)
    motion = [*_entry(axis.motion), *_unit(axis.unit)]
    notes = "; ".join(axis.notes[key] for key in ("zero", "span") if key in axis.notes)
    signals = ((axis.command, "command", command, notes), (axis.motion, axis.drives, motion, axis.notes.get("unit", "")))
    return [
        (
            (field.topic, field.name),
            f'"{axis.name}.{what}" = {{ {", ".join(entry)} }}' + (f"   # {comment(note)}" if note else ""),
        )
        for field, what, entry, note in signals
    ]


def _unit(unit: str) -> list[str]:
    """The unit of a signal in the recipe; of counts as counts per radian."""
    if unit.endswith("/turn"):
        return [f"span = {1.0 / unit_factor(unit):.9g}", 'unit = "rad"']
    return [f"unit = {toml_value(unit)}"]


def _entry(field: Field) -> list[str]:
    topic = [] if field.table or not field.topic else [f"topic = {toml_value(field.topic)}"]
    return [*topic, f"field = {toml_value(field.name)}"]
