"""Content of the recordings: length, completeness, use of each axis with the time at each command, joint space with the
positions of pairs of axes, noise, clocks, files; and residuals of the clock alignment.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from html import escape
from typing import Any

import numpy as np
from markupsafe import Markup

from sysid import display
from sysid.datasets.checks.run import check_plausibility
from sysid.datasets.clocks.residual import ClockResidual, PairResidual
from sysid.datasets.quality.coverage import GRID, PairMap, Rest, Span
from sysid.datasets.quality.evidence import DatasetEvidence, evidence_of
from sysid.datasets.quality.use import CELLS, VISITED_S, AxisUse
from sysid.datasets.quality.use import SMALL as SMALL_COMMAND
from sysid.datasets.recording import Dataset
from sysid.figures import Table
from sysid.reports import words
from sysid.reports.charts import SMALL, WIDE, ChartCurve, Plane, captioned, chart, svg_element, tick_texts
from sysid.reports.dataset_texts import (
    USES,
    clock_summary,
    clock_table,
    clock_text,
    file_table,
    flag_lines,
    flag_table,
    half_offset,
    kinds_of,
    length_text,
    noise_table,
    rest_sentence,
    role_text,
    sample_table,
    use_cells,
    use_table,
)
from sysid.reports.inputs import ReportInputs

#: Side of the square of a map, and its margins [px].
MAP, MAP_LEFT, MAP_TOP = 200.0, 58.0, 8.0


def command_picture(use: AxisUse, unit: str, small: bool, size: tuple[float, float] = SMALL) -> Markup:
    """Seconds at each command, idle time left out; the band of small commands is marked.

    Args:
        unit: SI unit of the command.
        small: mark the band of small commands (not for position commands).
        size: width and height [px].
    """
    factor, label = display.shown_unit(unit)
    step, top = 2.0 / CELLS, max(1.08 * max(use.seconds, default=0.0), 1.0)
    plane = Plane.of(size, (-1.0, 1.0), (0.0, top))
    bands = (SMALL_COMMAND, (-SMALL_COMMAND[1], -SMALL_COMMAND[0])) if small else ()
    parts = [plane.box("noise", (low, high), plane.y) for low, high in bands]
    parts += plane.y_axis(lines=True)
    for number, seconds in enumerate(use.seconds):
        ends = -1.0 + number * step, -1.0 + (number + 1) * step
        text = f"{display.number(seconds)} s at {_range(ends, use.full * factor)} {label}".strip()
        parts.append(plane.box("bar" if seconds >= VISITED_S else "bar thin", ends, (0.0, seconds), text, gap=(0.8, 0.0)))
    parts += plane.x_axis([(share, display.number(share * use.full * factor, 2)) for share in (-1.0, -0.5, 0.0, 0.5, 1.0)])
    parts += plane.labels(display.with_unit("command", unit), "time [s]", size[1])
    return svg_element("chart", *size, "time at each command", parts)


def _range(ends: tuple[float, float], full: float) -> str:
    return " to ".join(display.number(full * end, 2) for end in ends)


def map_picture(found: PairMap, rests: Sequence[Rest], units: Mapping[str, str]) -> Markup:
    """Time in each cell of two ranges (logarithmic shade), static poses, and postures at rest."""
    width, height = MAP_LEFT + MAP + 12.0, MAP_TOP + MAP + 40.0
    a, b = found.first, found.second
    plane = Plane(_ends(a, units), _ends(b, units), MAP_LEFT, MAP_TOP, MAP, MAP)
    cells = Plane((0.0, GRID), (0.0, GRID), MAP_LEFT, MAP_TOP, MAP, MAP)
    most = max((s for row in found.seconds for s in row), default=0.0)
    parts = [cells.box("frame", cells.x, cells.y)]
    for row, column in np.ndindex(GRID, GRID):
        seconds, poses = found.seconds[row][column], found.poses[row][column]
        text = f"{display.number(seconds)} s" + (f", {poses} poses" if poses else "")
        if seconds >= VISITED_S:
            heat = 25.0 + 70.0 * math.log(seconds / VISITED_S) / max(math.log(most / VISITED_S), 1e-9)
            style = f'style="--heat:{min(heat, 95.0):.0f}%"'
            parts.append(cells.box("cell", (row, row + 1), (column, column + 1), text, style, gap=(0.5, 0.5)))
        if poses:
            radius = 1.4 + 0.7 * min(poses, 9) ** 0.5
            parts.append(_dot("pose", cells.px(row + 0.5), cells.py(column + 0.5), radius, text))
    for rest in rests:
        if a.axis in rest.posture and b.axis in rest.posture:
            x, y = (GRID * _share(rest.posture[span.axis], span) for span in (a, b))
            text = f"at rest for {display.number(rest.seconds)} s in {rest.recording}"
            parts.append(_dot("rest", cells.px(x), cells.py(y), 3.6, text))
    parts += [*plane.x_axis(tick_texts(*plane.x, 3)), *plane.y_axis(3)]
    across, up = (display.with_unit(span.axis, units.get(span.signal)) for span in (a, b))
    parts += plane.labels(across, up, height)
    return svg_element("chart coverage", width, height, f"simultaneous positions of {a.axis} and {b.axis}", parts)


def _dot(look: str, x: float, y: float, radius: float, title: str) -> str:
    return f'<circle class="{look}" cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}"><title>{escape(title)}</title></circle>'


def _ends(span: Span, units: Mapping[str, str]) -> tuple[float, float]:
    """The ends of a range, as they are shown."""
    factor, _ = display.shown_unit(units.get(span.signal))
    return factor * span.low, factor * span.high


def _share(value: float, span: Span) -> float:
    return min(max((value - span.low) / (span.high - span.low), 0.0), 1.0)


#: Number of maps shown unfolded, those with the lowest coverage.
SHOWN = 3


#: Headers of tables that the console has too.
NOISE = ("Signal", "Data sheet", "Its samples", "At rest", "Repeated commands")
SAMPLES = ("Signal", "In the files", "Used", "Rows with a value", "Interpolated over", "Not used")


def context(inputs: ReportInputs) -> dict[str, Any]:
    dataset = inputs.dataset
    evidence, flags = evidence_of(dataset), flag_lines(dataset.quality.get("flags", ()))
    size = WIDE if len(evidence.axes) in (2, 4) else SMALL
    maps = [_map(item, evidence, dataset) for item in sorted(evidence.maps, key=lambda item: item.covered_moving)]
    return {
        "axes": [_axis(name, use, dataset, size) for name, use in evidence.axes.items()],
        "commands": use_table(evidence, dataset),
        "bands": any(not dataset.machine.axis(name).follows_positions for name in evidence.axes),
        "paired": size == WIDE,
        "poses": any(recording.poses for recording in evidence.recordings),
        "by_recording": _by_recording(evidence, dataset),
        "maps": maps[:SHOWN],
        "more_maps": maps[SHOWN:],
        "together": ", ".join(
            f"{a} + {b} {display.fixed(s, 0)} s" for (a, b), s in sorted(evidence.together_s.items(), key=lambda i: i[1])
        ),
        "rest": rest_sentence(evidence),
        "noise": replace(noise_table(evidence, dataset, words.signal_name), header=NOISE),
        "repeats": len(evidence.repeats),
        "flagged": flag_table(flags),
        "flag_kinds": kinds_of(flags),
        "reference": dataset.reference,
        "implausible": check_plausibility(dataset),
        "recordings": _recordings(dataset),
        "samples": replace(sample_table(dataset), header=SAMPLES),
        "ranges": _ranges(evidence, dataset),
        "clocks": clock_table(dataset.clocks),
        "refused": any(not clock.applied for clock in dataset.clocks),
        "clock_summary": clock_summary(dataset.clocks),
        "sources": file_table((s.path, s.size, s.sha256, s.losses) for s in dataset.sources),
        "notes": dataset.quality.get("notes", ()),
        "losses": sum(1 for source in dataset.sources if source.losses),
        "units": ", ".join(f"{name} [{unit}]" for name, unit in dataset.units.items()),
    }


def _recordings(dataset: Dataset) -> Table:
    rows = []
    for recording in dataset.recordings:
        missing = {s: float(np.mean(np.isnan(recording.values(s)))) for s in recording.signals}
        worst = max(missing, key=lambda s: missing[s], default="")
        flags = dataset.quality.get("recordings", {}).get(recording.name, {}).get("flags", ())
        remarks = [f"{worst}: {display.percent(missing[worst])} missing"] if worst and missing[worst] > 0.0 else []
        rows.append(
            (
                recording.name,
                role_text(recording.kind, dataset.splits.get(recording.name)),
                length_text(recording.kind, len(recording), recording.rate_hz),
                len(recording.signals),
                display.percent(1.0 - (sum(missing.values()) / len(missing) if missing else 0.0)),
                " · ".join([*remarks, *flags]),
            )
        )
    return Table(("Recording", "Used for", "Length", "Signals", "Complete", "Remarks"), rows, (2, 3, 4))


def _ranges(evidence: DatasetEvidence, dataset: Dataset) -> list[dict[str, Any]]:
    """The part of each axis' range that the motion recordings cover [%]: the console's figure."""
    rows = []
    for span in evidence.spans:
        if span.source != "limits" or span.moving is None:
            continue
        unit, left = dataset.units.get(span.signal, "1"), (span.moving[0] - span.low) / (span.high - span.low)
        rows.append(
            {
                "name": words.signal_name(span.signal),
                "left": round(100 * min(max(left, 0.0), 1.0), 1),
                "width": round(100 * span.covered_moving, 1),
                "share": display.percent(span.covered_moving),
                "seen": display.interval(*span.moving, unit),
                "range": display.interval(span.low, span.high, unit),
            }
        )
    return rows


def _axis(name: str, use: AxisUse, dataset: Dataset, size: tuple[float, float]) -> Markup:
    unit, small = dataset.units.get(f"{name}.command", "1"), not dataset.machine.axis(name).follows_positions
    text = Markup("<b>{}</b> · {} reversals of the motion, {} changes of the command")
    return captioned(command_picture(use, unit, small, size), text.format(name, use.reversals, use.command_changes))


def _by_recording(evidence: DatasetEvidence, dataset: Dataset) -> Table:
    """The figures of each recording and axis."""
    rows: list[tuple[object, ...]] = []
    row_classes = {}
    for recording in evidence.recordings:
        row_classes[len(rows)] = "first"
        for number, (name, use) in enumerate(recording.axes.items()):
            first, rests = (recording.name, len(recording.rests)) if number == 0 else ("", "")
            cells = use_cells(use, dataset.machine.axis(name).follows_positions)
            rows.append((first, name, *cells, use.command_changes, use.reversals, rests))
    return Table(
        ("recording", "axis", *USES, "changes", "reversals", "still phases"), rows, range(2, 8), row_classes=row_classes
    )


def _map(item: PairMap, evidence: DatasetEvidence, dataset: Dataset) -> Markup:
    missing = (
        " (no limits known: relative to the recorded range)" if "recorded" in (item.first.source, item.second.source) else ""
    )
    visited = display.percent(item.covered_moving)
    if item.covered > item.covered_moving:
        visited += f" (with the poses {display.percent(item.covered)})"
    caption = f"{item.first.axis} and {item.second.axis}: {visited} of the cells visited{missing}"
    return captioned(map_picture(item, evidence.postures, dataset.units), caption)


# -- clocks --------------------------------------------------------------------------------------------------------------

#: Largest number of points of a curve over time.
POINTS = 300


def clocks(inputs: ReportInputs) -> dict[str, Any] | None:
    """Residuals of the clock alignment, over time and over the motion."""
    if not inputs.clocks:
        return None
    return {"records": [_record(item, inputs.dataset) for item in inputs.clocks]}


def _record(item: ClockResidual, dataset: Dataset) -> dict[str, Any]:
    record = item.record
    half = 1e3 * half_offset(record)
    step = max(1, -(-len(item.times) // POINTS))
    times = item.times[::step]
    shift, spread = 1e3 * item.shift[::step], 1e3 * item.error[::step]
    drawn = chart(
        times, [ChartCurve(shift, "before", dots=len(times) < 80, spread=spread)], ("time [s]", "offset correction [ms]"), half
    )
    rest = chart(times, [ChartCurve(item.residual[::step], "before")], ("time [s]", "residual [noise]"))
    return {
        "recording": record.recording,
        "stream": record.stream,
        "text": clock_text(record),
        "interval": f"{display.fixed(record.offset_interval95[0], 6)} … {display.fixed(record.offset_interval95[1], 6)}",
        "reason": record.reason[:1].upper() + record.reason[1:],
        "pictures": [
            captioned(drawn, "offset correction of every 2 s; grey: 95 % interval of the record"),
            captioned(rest, "residual of every 2 s in standard deviations of its noise"),
            *[_pair(pair, dataset) for pair in item.pairs],
        ],
    }


def _pair(pair: PairResidual, dataset: Dataset) -> Markup:
    ours, other = pair.name.split("~")
    across, up = (dataset.units.get(signal, dataset.machine.expected_unit(signal)) for signal in (ours, other))
    factor = display.shown_unit(up)[0]
    line = ChartCurve(factor * pair.mean, "before", dots=True, spread=factor * pair.spread)
    labels = display.with_unit(words.signal_name(ours), across), display.with_unit("residual", up)
    drawn = chart(display.shown_unit(across)[0] * pair.motion, [line], labels)
    return captioned(drawn, f"{words.signal_name(other)} against {words.signal_name(ours)}, over the motion")
