"""Vicon Nexus text exports (CSV, ASCII): trajectories, segments, model outputs and devices → streams on the capture clock.

Each section has its name, its rate [Hz], the names of the objects above their columns, column names (``Frame``, ``Sub Frame``,
``X`` …), units, and rows up to an empty line; what is not visible is empty. Trajectories and segments: ``x y z`` [m]; other
columns keep their name and unit. Rotations of segments stay angles, because the file does not state their convention. The clock
counts from frame 1.
Source: Vicon Nexus documentation, "ASCII file format".
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sysid.errors import InputError
from sysid.logs.capture import Array, number_of, number_rows, separator_of, text_lines, without_lost
from sysid.logs.limits import uneven_sections
from sysid.logs.reader import LogReader, ReadOptions, Stream
from sysid.logs.table import to_ns
from sysid.units import si_factor

_WHAT = "a Vicon Nexus text export"
#: Sections with samples; others (events) are skipped.
SECTIONS = ("Trajectories", "Segments", "Joints", "Model Outputs", "Devices")
#: Largest number of sections.
_MAX_SECTIONS = 64
_POSITION = {"X": "x", "Y": "y", "Z": "z", "TX": "x", "TY": "y", "TZ": "z"}


@dataclass(frozen=True)
class _Section:
    """``first`` to ``first + count``: its rows of numbers, as lines of the file; ``last``: the file ends with them."""

    kind: str
    rate: float
    names: list[str]
    columns: list[str]
    units: list[str]
    separator: str
    first: int
    count: int
    last: bool


class ViconReader(LogReader):
    """Streams have the name of the marker, segment or device in Nexus, with the subject in front (``crane:tip``)."""

    name = "vicon"
    clocks = ("capture",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        budget = options.budget_of(path, _WHAT)
        found: list[tuple[str, Stream]] = []
        last_frames: list[tuple[str, float]] = []
        for number, section in enumerate(_sections(path)):
            if number == _MAX_SECTIONS:
                raise InputError(path, f"more than {number} sections", "one for each kind", "Export the trial again.")
            for stream in _streams(path, section, options, last_frames):
                budget.check_topics(path, len(found) + 1, "markers, segments and devices")
                twice = any(other.name == stream.name for _, other in found)
                name = f"{stream.name} ({section.kind})" if twice else stream.name
                found.append((name, stream))
        if not found:
            raise InputError(path, "no frames", f"a section such as {SECTIONS[0]!r} with frames", "Export the trial again.")
        options.check_streams(path, [name for name, _ in found], "marker, segment or device")
        losses = uneven_sections(path, last_frames)
        wanted = [replace(stream, name=name, losses=(*stream.losses, *losses)) for name, stream in found if options.wants(name)]
        return without_lost(path, wanted)


def _sections(path: Path) -> Iterator[_Section]:
    """The sections with samples, in the order of the file."""
    lines = enumerate(text_lines(path, _WHAT))
    for number, line in lines:
        kind = line.strip(',;\t "')
        if number == 0 and kind not in (*SECTIONS, "Events"):
            raise InputError(
                path, f"first cell {kind[:40]!r}", f"one of: {', '.join(SECTIONS)}", "Export it from Nexus as ASCII."
            )
        if kind not in SECTIONS:
            continue
        where = f"{path}: section {kind!r} in line {number + 1}"
        head = [next(lines, (number, ""))[1] for _ in range(4)]
        separator = separator_of(head[2])
        rows = [[cell.strip() for cell in text.split(separator)] for text in head]
        if rows[2][0] != "Frame" or len(rows[2]) < 3:
            raise InputError(
                where, f"no columns ({head[2][:40]!r})", "'Frame', 'Sub Frame' and axes", "Export the trial again."
            )
        try:
            rate = number_of(rows[0][0])
        except ValueError:
            rate = 0.0
        if not 0.0 < rate < 1e6:
            raise InputError(where, f"rate {rows[0][0]!r}", "a number of Hz", "Export the trial again.")
        count, last = 0, True
        for _, text in lines:
            if not text.strip(",;\t "):
                last = False
                break
            count += 1
        yield _Section(kind, rate, rows[1], rows[2], rows[3], separator, number + 5, count, last)


def _streams(path: Path, section: _Section, options: ReadOptions, last_frames: list[tuple[str, float]]) -> Iterator[Stream]:
    """The streams of a section; its last frame goes into ``last_frames``."""
    last = max(i for i, name in enumerate(section.columns) if name)
    table, losses = number_rows(path, last + 1, section.first, section.separator, section.count, section.last, options=options)
    frames = table[:, 0]
    damaged = ~np.isfinite(frames)
    if damaged.any():
        losses = (*losses, f"{path.name}: {section.kind}: {int(damaged.sum())} rows without a frame number have been left out")
        table = table[~damaged]
    last_frames.append((section.kind, float(table[-1, 0]) if len(table) else 0.0))
    if not len(table):
        return
    stamps = {"capture": to_ns(_seconds(table, section), 1.0, f"{path}: {section.kind}")}
    name = ""
    objects: dict[str, list[int]] = {}
    for index in range(2, last + 1):
        name = (section.names[index] if index < len(section.names) else "") or name
        if section.columns[index] and name:
            objects.setdefault(name, []).append(index)
    for name, indices in objects.items():
        values: dict[str, Array] = {}
        units: dict[str, str] = {}
        for index in indices:
            column, unit = section.columns[index], section.units[index] if index < len(section.units) else ""
            if column in _POSITION and section.kind in ("Trajectories", "Segments"):
                factor, si = si_factor(unit or "mm", f"{path}: {name}")
                values[_POSITION[column]], units[_POSITION[column]] = table[:, index] * factor, si
            else:
                values[column] = table[:, index]
                if unit:
                    units[column] = unit
        yield Stream(name, path, stamps, values, units, losses, kind=section.kind)


def _seconds(table: Array, section: _Section) -> Array:
    """Rows of one frame are its sub-frames, at the rate of the section."""
    sub = np.nan_to_num(table[:, 1]) if section.columns[1].lower().startswith("sub") else np.zeros(len(table))
    per_frame = float(np.max(sub)) + 1.0
    with np.errstate(over="ignore", invalid="ignore"):  # damaged numbers, refused as stamps
        return np.asarray(((table[:, 0] - 1.0) * per_frame + sub) / section.rate)
