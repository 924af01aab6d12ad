"""TRC files of motion capture (Motion Analysis, OpenSim): markers → streams ``x y z`` [m] on the capture clock.

Three head lines (file type; names and values of the settings), the markers' names over three columns each, the axes, an empty
line; then frame, time and positions, empty or ``nan`` where a marker is not visible. Tabs, or the separator of a spreadsheet.
Source: OpenSim documentation, "Marker (.trc) Files".
"""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np

from sysid.errors import InputError
from sysid.logs.capture import length_factor, number_rows, separator_of, text_lines, unique_names, without_lost
from sysid.logs.reader import LogReader, ReadOptions, Stream
from sysid.logs.table import to_ns

_WHAT = "a TRC file of motion capture"


class TrcReader(LogReader):
    """CAN logs with the same suffix begin with a semicolon and are read by ``can``."""

    name = "trc"
    suffixes = (".trc",)
    clocks = ("capture",)

    def read(self, path: Path, options: ReadOptions) -> tuple[Stream, ...]:
        budget = options.budget_of(path, _WHAT)
        head = list(islice(text_lines(path, _WHAT), 5))
        if not head or not head[0].startswith("PathFileType"):
            raise InputError(path, f"first line {head[0][:40] if head else ''!r}", "'PathFileType' as a TRC file begins")
        if len(head) < 5:
            raise InputError(path, f"{len(head)} lines", "five head lines and frames", "Export it again.")
        separator = separator_of(head[0])
        rows = [[cell.strip() for cell in line.split(separator)] for line in head]
        settings = dict(zip(rows[1], rows[2], strict=False))
        factor = length_factor(path, settings.get("Units", ""), options)
        markers = unique_names([name for name in rows[3][2:] if name])
        if not markers:
            raise InputError(path, "no names of markers", "names over the columns", "Export it again.")
        budget.check_topics(path, len(markers), "markers")
        options.check_streams(path, markers, "marker")
        width = 2 + 3 * len(markers)
        _check_commas(path, width, separator)
        table, losses = number_rows(path, width, 5, separator, ragged=separator != ",", options=options)
        table = table[~np.isnan(table[:, 1])]
        if not len(table):
            raise InputError(path, "a header but no frames", "at least one frame", "Export it again.")
        for key, count, what in (("NumFrames", len(table), "frames"), ("NumMarkers", len(markers), "names of markers")):
            stated = settings.get(key, "")
            if stated.isdecimal() and int(stated) != count:
                losses = (*losses, f"{path.name}: {count} {what} instead of the {stated} that the head states")
        stamps = {"capture": to_ns(table[:, 1], 1.0, f"{path}: Time")}
        streams = []
        for number, name in enumerate(markers):
            if options.wants(name):
                columns = {axis: table[:, 2 + 3 * number + i] * factor for i, axis in enumerate("xyz")}
                streams.append(Stream(name, path, stamps, columns, dict.fromkeys("xyz", "m"), losses, kind="Marker"))
        return without_lost(path, streams)


def _check_commas(path: Path, width: int, separator: str) -> None:
    """Raise where commas separate cells and decimals: the rows have two cells for each number but the frame."""
    if separator != ",":
        return
    for number, line in enumerate(islice(text_lines(path, _WHAT), 5, 10), start=6):
        cells = line.rstrip(", ").count(",") + 1
        if cells == 1 + 2 * (width - 1):
            found = f"{cells} cells for {width} numbers: commas separate cells and decimals"
            raise InputError(
                f"{path}: line {number}", found, "another separator than the decimal mark", "Export it again with tabs."
            )
