"""Content of the recordings: length, completeness, use of each axis with the time at each command, joint space with the
positions of pairs of axes, noise, clocks, files.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
from markupsafe import Markup

from sysid import display
from sysid.datasets.plausibility import check_plausibility
from sysid.datasets.quality import DatasetEvidence, evidence_of
from sysid.datasets.quality.coverage import GRID, PairMap, Rest, Span
from sysid.datasets.quality.use import CELLS, VISITED_S, AxisUse
from sysid.datasets.quality.use import SMALL as SMALL_COMMAND
from sysid.datasets.recording import ClockRecord, Dataset, Recording
from sysid.reports import words
from sysid.reports.charts import BOTTOM, LEFT, RIGHT, SMALL, TOP, WIDE, axis_labels, grid_lines, svg_element, tick_texts
from sysid.reports.dataset_texts import clock_summary, flag_lines, kinds_of, sample_lines
from sysid.reports.inputs import ReportInputs

#: Side of the square of a map, and its margins [px].
MAP, MAP_LEFT, MAP_TOP = 200.0, 58.0, 8.0


def command_picture(use: AxisUse, unit: str, small: bool, size: tuple[float, float] = SMALL) -> str:
    """Seconds at each command, idle time left out; the band of small commands is marked.

    Args:
        unit: SI unit of the command.
        small: mark the band of small commands (not for position commands).
        size: width and height [px].
    """
    width, height = size
    factor, label = display.shown_unit(unit)
    top = max(1.08 * max(use.seconds, default=0.0), 1.0)

    def px(share: float) -> float:
        return LEFT + (width - LEFT - RIGHT) * (share + 1.0) / 2.0

    def py(seconds: float) -> float:
        return height - BOTTOM - (height - TOP - BOTTOM) * seconds / top

    parts = []
    if small:
        for low, high in (SMALL_COMMAND, (-SMALL_COMMAND[1], -SMALL_COMMAND[0])):
            parts.append(
                f'<rect class="noise" x="{px(low):.1f}" y="{TOP:.0f}" width="{px(high) - px(low):.1f}" '
                f'height="{height - TOP - BOTTOM:.0f}"/>'
            )
    parts += grid_lines(0.0, top, py, width)
    step = 2.0 / CELLS
    for number, seconds in enumerate(use.seconds):
        left = px(-1.0 + number * step)
        look = "bar" if seconds >= VISITED_S else "bar thin"
        text = f"{display.number(seconds)} s at {_range(number, use.full * factor)} {label}".strip()
        parts.append(
            f'<rect class="{look}" x="{left + 0.8:.1f}" y="{py(seconds):.1f}" width="{px(-1.0 + step) - px(-1.0) - 1.6:.1f}" '
            f'height="{py(0.0) - py(seconds):.1f}"><title>{escape(text)}</title></rect>'
        )
    for share in (-1.0, -0.5, 0.0, 0.5, 1.0):
        value = display.number(share * use.full * factor, 2)
        parts.append(
            f'<text class="tick" x="{px(share):.1f}" y="{height - BOTTOM + 16:.0f}" text-anchor="middle">{value}</text>'
        )
    parts += axis_labels((display.with_unit("command", unit), "time [s]"), px(0.0), (TOP + height - BOTTOM) / 2, height)
    return svg_element("chart", width, height, "time at each command", parts)


def _range(number: int, full: float) -> str:
    ends = (-1.0 + 2.0 * (number + k) / CELLS for k in (0, 1))
    return " to ".join(display.number(full * end, 2) for end in ends)


def map_picture(found: PairMap, rests: Sequence[Rest], units: Mapping[str, str]) -> str:
    """Time in each cell of two ranges (logarithmic shade), static poses, and postures at rest."""
    width, height = MAP_LEFT + MAP + 12.0, MAP_TOP + MAP + 40.0
    cell = MAP / GRID
    most = max((s for row in found.seconds for s in row), default=0.0)
    parts = [f'<rect class="frame" x="{MAP_LEFT:.0f}" y="{MAP_TOP:.0f}" width="{MAP:.0f}" height="{MAP:.0f}"/>']
    for row in range(GRID):
        for column in range(GRID):
            seconds, poses = found.seconds[row][column], found.poses[row][column]
            x, y = MAP_LEFT + row * cell, MAP_TOP + MAP - (column + 1) * cell
            text = f"{display.number(seconds)} s" + (f", {poses} poses" if poses else "")
            if seconds >= VISITED_S:
                heat = 25.0 + 70.0 * math.log(seconds / VISITED_S) / max(math.log(most / VISITED_S), 1e-9)
                parts.append(
                    f'<rect class="cell" style="--heat:{min(heat, 95.0):.0f}%" x="{x + 0.5:.1f}" y="{y + 0.5:.1f}" '
                    f'width="{cell - 1:.1f}" height="{cell - 1:.1f}"><title>{text}</title></rect>'
                )
            if poses:
                middle = f'cx="{x + cell / 2:.1f}" cy="{y + cell / 2:.1f}"'
                parts.append(
                    f'<circle class="pose" {middle} r="{1.4 + 0.7 * min(poses, 9) ** 0.5:.1f}"><title>{text}</title></circle>'
                )
    a, b = found.first, found.second
    for rest in rests:
        if a.axis in rest.posture and b.axis in rest.posture:
            x = MAP_LEFT + MAP * _share(rest.posture[a.axis], a)
            y = MAP_TOP + MAP * (1.0 - _share(rest.posture[b.axis], b))
            title = f"at rest for {display.number(rest.seconds)} s in {rest.recording}"
            parts.append(f'<circle class="rest" cx="{x:.1f}" cy="{y:.1f}" r="3.6"><title>{escape(title)}</title></circle>')
    titles = (
        _scale(parts, a, units.get(a.signal), upright=False),
        _scale(parts, b, units.get(b.signal), upright=True),
    )
    parts += axis_labels(titles, MAP_LEFT + MAP / 2, MAP_TOP + MAP / 2, height)
    return svg_element("chart coverage", width, height, f"simultaneous positions of {a.axis} and {b.axis}", parts)


def _share(value: float, span: Span) -> float:
    return min(max((value - span.low) / (span.high - span.low), 0.0), 1.0)


def _scale(parts: list[str], span: Span, unit: str | None, upright: bool) -> str:
    """Add the ticks of one side of a map to ``parts``; returns its title."""
    factor, _ = display.shown_unit(unit)
    low, high = factor * span.low, factor * span.high
    for value, text in tick_texts(low, high, 3):
        share = (value - low) / (high - low)
        if upright:
            y = MAP_TOP + MAP * (1.0 - share)
            parts.append(f'<text class="tick" x="{MAP_LEFT - 6:.0f}" y="{y + 4:.1f}" text-anchor="end">{text}</text>')
        else:
            x = MAP_LEFT + MAP * share
            parts.append(f'<text class="tick" x="{x:.1f}" y="{MAP_TOP + MAP + 16:.0f}" text-anchor="middle">{text}</text>')
    return display.with_unit(span.axis, unit)


#: Number of maps shown unfolded, those with the lowest coverage.
SHOWN = 3
_ROLES = {"fit": "fit", "select": "selection", "held_out": "held out (proof)"}


def context(inputs: ReportInputs) -> dict[str, Any]:
    dataset = inputs.dataset
    evidence = evidence_of(dataset)
    paired = len(evidence.axes) in (2, 4)
    maps = [_map(item, evidence, dataset) for item in sorted(evidence.maps, key=lambda item: item.covered_moving)]
    return {
        "axes": [_axis(name, use, dataset, WIDE if paired else SMALL) for name, use in evidence.axes.items()],
        "bands": any(not dataset.machine.axis(name).follows_positions for name in evidence.axes),
        "paired": paired,
        "poses": any(recording.poses for recording in evidence.recordings),
        "by_recording": _by_recording(evidence),
        "maps": maps[:SHOWN],
        "more_maps": maps[SHOWN:],
        "together": [
            {"pair": f"{a} + {b}", "seconds": display.fixed(s, 0)}
            for (a, b), s in sorted(evidence.together_s.items(), key=lambda i: i[1])
        ],
        "rest": _rest(evidence),
        "noise": _noise(evidence, dataset),
        "repeats": len(evidence.repeats),
        "flagged": _flagged(dataset.quality),
        "flag_kinds": kinds_of(flag_lines(dataset.quality.get("flags", ()))),
        "reference": dataset.reference,
        "implausible": check_plausibility(dataset),
        "recordings": [_recording(recording, dataset) for recording in dataset.recordings],
        "samples": sample_lines(dataset),
        "ranges": _ranges(evidence, dataset),
        "clocks": [_clock(clock) for clock in dataset.clocks],
        "clock_summary": clock_summary(
            (c.recording, c.applied, float(np.ptp(c.offset_interval95)) / 2) for c in dataset.clocks
        ),
        "sources": [
            {
                "path": s.path,
                "size": f"{display.number(s.size / 1e6)} MB",
                "sha256": s.sha256[:16],
                "losses": "; ".join(s.losses),
            }
            for s in dataset.sources
        ],
        "notes": dataset.quality.get("notes", ()),
        "losses": sum(1 for source in dataset.sources if source.losses),
        "units": ", ".join(f"{name} [{unit}]" for name, unit in dataset.units.items()),
    }


def _recording(recording: Recording, dataset: Dataset) -> dict[str, Any]:
    poses = recording.kind == "poses"
    length = f"{len(recording)} poses" if poses else f"{display.number(len(recording) / recording.rate_hz)} s"
    missing = {s: float(np.mean(np.isnan(recording.values(s)))) for s in recording.signals}
    worst = max(missing, key=lambda s: missing[s], default="")
    return {
        "name": recording.name,
        "role": "static poses" if poses else _ROLES.get(dataset.splits.get(recording.name, ""), "not used"),
        "length": length,
        "signals": len(recording.signals),
        "complete": 1.0 - (sum(missing.values()) / len(missing) if missing else 0.0),
        "worst": f"{worst}: {display.percent(missing[worst])} missing" if worst and missing[worst] > 0.0 else "",
        "flags": dataset.quality.get("recordings", {}).get(recording.name, {}).get("flags", ()),
    }


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


def _axis(name: str, use: AxisUse, dataset: Dataset, size: tuple[float, float]) -> dict[str, Any]:
    axis = dataset.machine.axis(name)
    small = not axis.follows_positions
    return {
        "name": name,
        "picture": Markup(command_picture(use, dataset.units.get(f"{name}.command", "1"), small, size)),
        "small": _sides(use.small_negative_s, use.small_positive_s) if small else display.NOTHING,
        "given": _sides(use.negative_s, use.positive_s),
        "slow": _sides(use.slow_negative_s, use.slow_positive_s),
        "idle": display.fixed(use.idle_s, 1),
        "changes": use.command_changes,
        "reversals": use.reversals,
        "covered": f"{display.percent(use.covered(-1))} / {display.percent(use.covered(1))}",
    }


def _sides(negative: float, positive: float) -> str:
    """Seconds in either direction."""
    return f"{display.fixed(negative, 1)} / {display.fixed(positive, 1)}"


def _by_recording(evidence: DatasetEvidence) -> list[dict[str, Any]]:
    """The figures of each recording and axis."""
    rows = []
    for recording in evidence.recordings:
        for name, use in recording.axes.items():
            rows.append(
                {
                    "recording": recording.name,
                    "axis": name,
                    "given": _sides(use.negative_s, use.positive_s),
                    "small": _sides(use.small_negative_s, use.small_positive_s),
                    "slow": _sides(use.slow_negative_s, use.slow_positive_s),
                    "changes": use.command_changes,
                    "reversals": use.reversals,
                    "rests": len(recording.rests),
                }
            )
    return rows


def _map(item: PairMap, evidence: DatasetEvidence, dataset: Dataset) -> dict[str, Any]:
    missing = (
        " (no limits known: relative to the recorded range)" if "recorded" in (item.first.source, item.second.source) else ""
    )
    visited = display.percent(item.covered_moving)
    if item.covered > item.covered_moving:
        visited += f" (with the poses {display.percent(item.covered)})"
    return {
        "picture": Markup(map_picture(item, evidence.postures, dataset.units)),
        "caption": f"{item.first.axis} and {item.second.axis}: {visited} of the cells visited{missing}",
    }


def _rest(evidence: DatasetEvidence) -> str:
    phases = [phase for recording in evidence.recordings for phase in recording.rests]
    if not phases:
        return "The machine was never at rest for a second."
    times, postures = len(phases), len(evidence.postures)
    total, longest = sum(phase.seconds for phase in phases), max(phase.seconds for phase in phases)
    return (
        f"The machine was at rest {times} time{'s' if times > 1 else ''}, {display.number(total)} s in all, at most "
        f"{display.number(longest)} s, in {postures} different posture{'s' if postures > 1 else ''}."
    )


def _noise(evidence: DatasetEvidence, dataset: Dataset) -> list[dict[str, str]]:
    rows = []
    for signal, noise in evidence.noise.items():
        unit = dataset.units.get(signal)
        values = {"sheet": noise.sheet, "moving": noise.moving, "still": noise.still, "repeats": noise.repeats}
        shown = {key: display.NOTHING if value is None else display.quantity(value, unit) for key, value in values.items()}
        rows.append({"signal": words.signal_name(signal), **shown})
    return rows


def _flagged(quality: Mapping[str, Any]) -> list[dict[str, str]]:
    """The flagged samples."""
    return [
        {
            "recording": line.recording,
            "signals": line.signals,
            "kind": line.kind,
            "when": f"{display.fixed(line.from_s, 2)} to {display.fixed(line.to_s, 2)}",
            "text": line.text,
        }
        for line in flag_lines(quality.get("flags", ()))
    ]


def _clock(clock: ClockRecord) -> dict[str, Any]:
    half = 0.5 * (clock.offset_interval95[1] - clock.offset_interval95[0])
    skew = 0.5 * (clock.skew_interval95[1] - clock.skew_interval95[0])
    return {
        "recording": clock.recording,
        "stream": clock.stream,
        "offset": display.fixed(clock.offset_s, 6),
        "offset_error": display.fixed(1e3 * half, 3),
        "skew": display.fixed(clock.skew_ppm, 1),
        "skew_error": display.fixed(skew, 1),
        "signals": ", ".join(clock.used_signals),
        "applied": clock.applied,
        "reason": clock.reason,
    }
