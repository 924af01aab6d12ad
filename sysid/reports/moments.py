"""The largest errors on held-out recordings, before and after the repair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid import display
from sysid.gap.disagreement import worst_row
from sysid.gap.result import GapResult, Traces
from sysid.reports.charts import WIDE, ChartCurve, chart

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


def moment_chart(trace: Traces, moment: Moment, unit: str, label: str, repaired: bool) -> str:
    """Measured, before and after around a moment; errors instead if the curves could not be distinguished."""
    factor, shown = display.shown_unit(unit)
    time = _column(trace.measured["time"])
    there = _around(time, moment.time, POINTS)
    values = {v: factor * _column(getattr(trace, v)[moment.signal])[there] for v in ("measured", "before", "after")}
    measured, unit_text = values["measured"], f" [{shown}]" if shown else ""
    apart = np.nanmax(np.abs(values["before"] - measured)) > MIN_DIFFERENCE * np.ptp(measured[np.isfinite(measured)])
    shift, what = (0.0 * measured, label) if apart else (measured, f"{label} error")
    lines = [
        ChartCurve(values["before"] - shift, "before"),
        *([ChartCurve(values["after"] - shift, "after")] if repaired else []),
    ]
    if apart:
        lines.append(ChartCurve(measured, "measured dotted"))
    return chart(time[there], lines, ("time [s]", what + unit_text), include_zero=not apart, size=WIDE)


def error_chart(trace: Traces, moment: Moment, unit: str, label: str, noise: float) -> str:
    """The error after the repair around its maximum, with the noise floor."""
    factor, shown = display.shown_unit(unit)
    time = _column(trace.measured["time"])
    there = _around(time, moment.time, 2 * POINTS)
    error = factor * (_column(trace.after[moment.signal]) - _column(trace.measured[moment.signal]))[there]
    return chart(
        time[there],
        [ChartCurve(error, "after")],
        ("time [s]", f"{label} error [{shown}]"),
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
