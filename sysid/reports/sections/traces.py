"""Measured and simulated signals of held-out recordings: curves, the largest errors before and after the repair, and a short
replay of the machine and its simulation around the largest one, as data that the page's script draws.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from markupsafe import Markup

from sysid import display
from sysid.gap.disagreement import worst_row
from sysid.gap.result import GapResult, Traces
from sysid.machine import Kinematics, Machine
from sysid.reports import words
from sysid.reports.charts import WIDE, ChartCurve, captioned, chart, embed, packed, space_path, thin
from sysid.reports.inputs import ReportInputs
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]

VERSIONS = ("before", "after")
#: Length of the shown window [s], and its number of points.
WINDOW, POINTS = 8.0, 200
#: Below this share of the signal's range, errors are shown in the place of curves.
MIN_DIFFERENCE = 0.08
#: Largest number of shown signals.
MAX_SIGNALS = 3


@dataclass(frozen=True)
class Moment:
    """The worst row of a signal: ``error`` (before or after) [SI] at ``time`` [s] of ``recording``."""

    signal: str
    recording: str
    time: float
    before: float
    after: float
    row: int


def worst_moment(traces: Sequence[Traces], signal: str, version: str) -> Moment | None:
    """The row of all recordings with the largest error of ``before`` or ``after``; None without any."""
    found: Moment | None = None
    for trace in traces:
        if signal not in trace.measured or signal not in trace.before or signal not in trace.after:
            continue
        worst = worst_row(getattr(trace, version)[signal], trace.measured[signal])
        if worst is None or (found is not None and abs(worst[1]) <= getattr(found, version)):
            continue
        row = worst[0]
        before, after = (abs(_column(getattr(trace, v)[signal])[row] - _column(trace.measured[signal])[row]) for v in VERSIONS)
        time = float(_column(trace.measured["time"])[row])
        found = Moment(signal, trace.recording, time, float(before), float(after), row)
    return found


def largest_error_signals(gap: GapResult) -> list[str]:
    """Outputs of the stages with errors, one per owner, the largest first; without any, the largest errors of the free run."""
    before, floor = gap.gap.before, gap.gap.noise_floor
    measured = [i for i in gap.localised if i.noise_floor > 0.0 and i.signal in before and not i.signal.endswith(".command")]
    times = {i.signal: i.stage_rmse / i.noise_floor for i in measured}
    if not any(ratio > 1.5 for ratio in times.values()):
        times = {s: before[s] / floor[s] for s in before if floor.get(s, 0.0) > 0.0}
    owners: dict[str, str] = {}
    for signal in sorted(times, key=lambda s: -times[s]):
        if times[signal] > 1.5 and not signal.endswith(".command"):
            owners.setdefault(signal.rpartition(".")[0], signal)
    return list(owners.values())[:MAX_SIGNALS]


def moment_chart(trace: Traces, moment: Moment, unit: str, label: str, repaired: bool) -> Markup:
    """Measured, before and after around a moment; errors instead if the curves could not be distinguished."""
    factor, _ = display.shown_unit(unit)
    time = _column(trace.measured["time"])
    there = _around(time, moment.time, POINTS)
    values = {v: factor * _column(getattr(trace, v)[moment.signal])[there] for v in ("measured", "before", "after")}
    measured = values["measured"]
    apart = np.nanmax(np.abs(values["before"] - measured)) > MIN_DIFFERENCE * np.ptp(measured[np.isfinite(measured)])
    shift, what = (0.0 * measured, label) if apart else (measured, f"{label} error")
    lines = [
        ChartCurve(values["before"] - shift, "before"),
        *([ChartCurve(values["after"] - shift, "after")] if repaired else []),
    ]
    if apart:
        lines.append(ChartCurve(measured, "measured dotted"))
    return chart(time[there], lines, ("time [s]", display.with_unit(what, unit)), include_zero=not apart, size=WIDE)


def error_chart(trace: Traces, moment: Moment, unit: str, label: str, noise: float) -> Markup:
    """The error after the repair around its maximum, with the noise floor."""
    factor, _ = display.shown_unit(unit)
    time = _column(trace.measured["time"])
    there = _around(time, moment.time, 2 * POINTS)
    error = factor * (_column(trace.after[moment.signal]) - _column(trace.measured[moment.signal]))[there]
    return chart(
        time[there],
        [ChartCurve(error, "after")],
        ("time [s]", display.with_unit(f"{label} error", unit)),
        noise=2.0 * factor * noise,
        size=WIDE,
    )


def _around(time: Array, moment: float, points: int) -> npt.NDArray[np.int64]:
    """Every k-th row of the window around a moment, shifted to lie inside the recording."""
    begin = max(float(time[0]), min(moment - 0.5 * WINDOW, float(time[-1]) - WINDOW))
    there = np.flatnonzero((time >= begin) & (time <= begin + WINDOW))
    return there[:: max(1, len(there) // points)]


def _column(values: object) -> Array:
    return np.asarray(values, dtype=np.float64)


#: Length of the replay [s] and its frames per second.
REPLAY_WINDOW, RATE = 12.0, 25.0


def replay(gap: GapResult, machine: Machine, repaired: bool) -> dict[str, Any] | None:
    """Points of the machine over time: link origins, tip and tool of each version, (frames × points × 3) [m].

    None without a URDF, or where a joint was not recorded.
    """
    kinematics = machine.kinematics()
    signals = largest_error_signals(gap)
    moments = [moment for signal in signals if (moment := worst_moment(gap.traces, signal, "before")) is not None]
    if kinematics is None or not gap.traces or not moments:
        return None
    moment = moments[0]
    trace = next(trace for trace in gap.traces if trace.recording == moment.recording)
    rows = _rows(trace, moment.time)
    versions = ("measured", "before", *(("after",) if repaired else ()))
    found = {version: _points(getattr(trace, version).iloc[rows], machine, kinematics) for version in versions}
    if any(points is None or not np.isfinite(points).any() for points in found.values()):
        return None
    time = trace.measured["time"].to_numpy(dtype=np.float64)[rows]
    return {
        "recording": trace.recording,
        "signal": words.signal_name(moment.signal),
        "at": moment.time,
        "time": packed(time),
        "frames": len(rows),
        "rate": RATE,
        "versions": {name: packed(points.ravel()) for name, points in found.items() if points is not None},
    }


def _rows(trace: Traces, moment: float) -> npt.NDArray[np.int64]:
    """Row of each frame: the window around a moment, inside the recording, at a constant rate."""
    time = trace.measured["time"].to_numpy(dtype=np.float64)
    length = min(REPLAY_WINDOW, float(time[-1] - time[0]))
    begin = min(max(moment - 0.5 * length, float(time[0])), float(time[-1]) - length)
    wanted = begin + np.arange(1 + int(length * RATE)) / RATE
    return np.minimum(np.searchsorted(time, wanted), len(time) - 1)


def _points(table: pd.DataFrame, machine: Machine, kinematics: Kinematics) -> Array | None:
    """Origins of the links, then tip and tool as the table has them; NaN where a value is missing."""
    columns = [axis_signal(axis.name, "joint") for axis in machine.axes]
    if not set(columns) <= set(table.columns):
        return None
    poses = kinematics.link_poses(table[columns].to_numpy(dtype=np.float64))
    points = [pose[:, :3, 3] for pose in poses.values()]
    for name in ("ee", "tool"):
        own = list(point_signals(name))
        there = set(own) <= set(table.columns)
        points.append(table[own].to_numpy(dtype=np.float64) if there else np.full((len(table), 3), np.nan))
    return np.stack(points, axis=1)


#: Largest number of recordings on the page.
MAX_RECORDINGS = 3


def context(inputs: ReportInputs) -> dict[str, Any] | None:
    if inputs.gap is None or not inputs.gap.traces:
        return None
    shown = inputs.gap.traces[:MAX_RECORDINGS]
    signals = [
        name
        for name in dict.fromkeys(name for item in shown for name in item.before.columns)
        if name != "time" and any(name in item.measured and item.measured[name].notna().any() for item in shown)
    ]
    if not signals:
        return None
    before, floor = inputs.gap.gap.before, inputs.gap.gap.noise_floor
    repaired = any(not item.after.equals(item.before) for item in shown)
    worst = max(signals, key=lambda name: before.get(name, 0.0) / max(floor.get(name, np.inf), 1e-12))
    return {
        "data": embed("traces-data", {"recordings": {item.recording: _recording(item, signals, inputs) for item in shown}}),
        "recordings": [item.recording for item in shown],
        "left_out": len(inputs.gap.traces) - len(shown),
        "signals": [{"name": name, "label": words.signal_name(name)} for name in signals],
        "selected": worst,
        "repaired": repaired,
        "replay": _replay(inputs, repaired),
        "moments": _moments(inputs, repaired),
        "paths": _paths(shown, repaired),
    }


def _paths(traces: Sequence[Traces], repaired: bool) -> list[Markup]:
    """The measured path of the tool, else of the tip, coloured by the distance of the simulated one [mm], in one scale."""
    for point in ("tool", "ee"):
        found = [(item, errors) for item in traces if (errors := _distances(item, point)) is not None]
        if not found:
            continue
        trace, errors = max(found, key=lambda pair: float(np.nanmax(pair[1]["before"])))
        most, rows = 1e3 * float(np.nanmax(errors["before"])), slice(None, None, max(1, len(trace.measured) // 1500))
        points = trace.measured[list(point_signals(point))].to_numpy(dtype=np.float64)[rows]
        titles = {"before": "before", "after": "after the repair"} if repaired else {"before": "simulated"}
        return [
            captioned(
                space_path(points, 1e3 * errors[version][rows], most, "mm"),
                f"{words.owner_name(point)} in {trace.recording}, {title}: at most "
                f"{display.quantity(float(np.nanmax(errors[version])), 'm', 2)} apart (circle)",
            )
            for version, title in titles.items()
        ]
    return []


def _distances(trace: Traces, point: str) -> dict[str, Array] | None:
    """Distance of a point of either version from the measured one (n,) [m]; None where it is not measured at all."""
    names = list(point_signals(point))
    if not all(name in table for name in names for table in (trace.measured, trace.before, trace.after)):
        return None
    measured = trace.measured[names].to_numpy(dtype=np.float64)
    found = {v: np.linalg.norm(getattr(trace, v)[names].to_numpy(dtype=np.float64) - measured, axis=1) for v in VERSIONS}
    return found if all(np.isfinite(distances).any() for distances in found.values()) else None


def _replay(inputs: ReportInputs, repaired: bool) -> dict[str, Any] | None:
    assert inputs.gap is not None
    found = replay(inputs.gap, inputs.dataset.machine, repaired)
    return {**found, "data": embed("replay-data", found)} if found is not None else None


def _moments(inputs: ReportInputs, repaired: bool) -> list[Markup]:
    """The largest error of the signals with the largest errors, before and after the repair."""
    assert inputs.gap is not None
    traces = {trace.recording: trace for trace in inputs.gap.traces}
    found: list[Markup] = []
    for signal in largest_error_signals(inputs.gap):
        unit, label = inputs.dataset.units.get(signal, "1"), words.signal_name(signal)
        floor = inputs.gap.gap.noise_floor.get(signal, 0.0)
        worst = worst_moment(inputs.gap.traces, signal, "before")
        if worst is None:
            continue
        text = f"{label}, {worst.recording} at {worst.time:.1f} s: error {display.quantity(worst.before, unit, 2)}"
        if repaired:
            text += f" before, {display.quantity(worst.after, unit, 2)} after"
        found.append(captioned(moment_chart(traces[worst.recording], worst, unit, label, repaired), text))
        left = worst_moment(inputs.gap.traces, signal, "after") if repaired else None
        if left is not None:
            text = (
                f"largest error after: {display.quantity(left.after, unit, 2)} in {left.recording} at {left.time:.1f} s "
                "(grey: twice the noise floor)"
            )
            found.append(captioned(error_chart(traces[left.recording], left, unit, label, floor), text))
    return found


def _recording(item: Traces, signals: list[str], inputs: ReportInputs) -> dict[str, Any]:
    time = item.measured["time"].to_numpy(dtype=np.float64)
    assert inputs.gap is not None
    entries: dict[str, Any] = {}
    for name in signals:
        factor, unit = display.shown_unit(inputs.dataset.units.get(name, "1"))
        columns = [
            factor * table[name].to_numpy(dtype=np.float64) if name in table else np.full(len(time), np.nan)
            for table in (item.measured, item.before, item.after)
        ]
        measured, before, after = thin(columns)
        entries[name] = {
            "unit": unit,
            "floor": factor * inputs.gap.gap.noise_floor.get(name, 0.0),
            "measured": packed(measured),
            "before": packed(before),
            "after": packed(after),
        }
    commands = {
        name.removesuffix(".command"): packed(thin([item.measured[name].to_numpy(dtype=np.float64)])[0])
        for name in map(str, item.measured.columns)
        if name.endswith(".command")
    }
    return {"time": packed(thin([time])[0]), "signals": entries, "commands": commands}
