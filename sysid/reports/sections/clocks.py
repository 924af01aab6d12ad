"""Residuals of the clock alignment, over time and over the motion."""

from __future__ import annotations

from typing import Any

from markupsafe import Markup

from sysid import display
from sysid.datasets.clocks.residual import ClockResidual, PairResidual
from sysid.datasets.recording import Dataset
from sysid.reports import words
from sysid.reports.charts import ChartCurve, chart
from sysid.reports.inputs import ReportInputs

#: Largest number of points of a curve over time.
POINTS = 300


def context(inputs: ReportInputs) -> dict[str, Any] | None:
    if not inputs.clocks:
        return None
    return {"records": [_record(item, inputs.dataset) for item in inputs.clocks]}


def _record(item: ClockResidual, dataset: Dataset) -> dict[str, Any]:
    record = item.record
    half = 0.5e3 * (record.offset_interval95[1] - record.offset_interval95[0])
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
        "offset": display.fixed(record.offset_s, 6),
        "half": display.fixed(half, 3),
        "interval": f"{display.fixed(record.offset_interval95[0], 6)} … {display.fixed(record.offset_interval95[1], 6)}",
        "skew": display.fixed(record.skew_ppm, 1),
        "reason": record.reason[:1].upper() + record.reason[1:],
        "pictures": [
            {"picture": Markup(drawn), "caption": "offset correction of every 2 s; grey: 95 % interval of the record"},
            {"picture": Markup(rest), "caption": "residual of every 2 s in standard deviations of its noise"},
            *[_pair(pair, dataset) for pair in item.pairs],
        ],
    }


def _pair(pair: PairResidual, dataset: Dataset) -> dict[str, Any]:
    ours, other = pair.name.split("~")
    across, up = (dataset.units.get(signal, dataset.machine.expected_unit(signal)) for signal in (ours, other))
    factor = display.shown_unit(up)[0]
    line = ChartCurve(factor * pair.mean, "before", dots=True, spread=factor * pair.spread)
    labels = display.with_unit(words.signal_name(ours), across), display.with_unit("residual", up)
    return {
        "picture": Markup(chart(display.shown_unit(across)[0] * pair.motion, [line], labels)),
        "caption": f"{words.signal_name(other)} against {words.signal_name(ours)}, over the motion",
    }
