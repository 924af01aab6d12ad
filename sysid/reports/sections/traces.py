"""Measured and simulated signals of held-out recordings."""

from __future__ import annotations

from typing import Any

import numpy as np
from markupsafe import Markup

from sysid import display
from sysid.gap.result import Traces
from sysid.reports import words
from sysid.reports.figures import embed, packed, thin
from sysid.reports.inputs import ReportInputs
from sysid.reports.moments import error_chart, largest_error_signals, moment_chart, worst_moment
from sysid.reports.replay import replay

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
    }


def _replay(inputs: ReportInputs, repaired: bool) -> dict[str, Any] | None:
    assert inputs.gap is not None
    found = replay(inputs.gap, inputs.dataset.machine, repaired)
    return {**found, "data": embed("replay-data", found)} if found is not None else None


def _moments(inputs: ReportInputs, repaired: bool) -> list[dict[str, Any]]:
    """The largest error of the signals with the largest errors, before and after the repair."""
    assert inputs.gap is not None
    traces = {trace.recording: trace for trace in inputs.gap.traces}
    found = []
    for signal in largest_error_signals(inputs.gap):
        unit, label = inputs.dataset.units.get(signal, "1"), words.signal_name(signal)
        floor = inputs.gap.gap.noise_floor.get(signal, 0.0)
        worst = worst_moment(inputs.gap.traces, signal, "before")
        if worst is None:
            continue
        text = f"{label}, {worst.recording} at {worst.time:.1f} s: error {display.quantity(worst.before, unit, 2)}"
        if repaired:
            text += f" before, {display.quantity(worst.after, unit, 2)} after"
        entry = {
            "picture": Markup(moment_chart(traces[worst.recording], worst, unit, label, repaired)),
            "caption": text,
            "left": "",
            "left_caption": "",
        }
        left = worst_moment(inputs.gap.traces, signal, "after") if repaired else None
        if left is not None:
            entry["left"] = Markup(error_chart(traces[left.recording], left, unit, label, floor))
            entry["left_caption"] = (
                f"largest error after: {display.quantity(left.after, unit, 2)} in {left.recording} at {left.time:.1f} s "
                f"(grey: twice the noise floor)"
            )
        found.append(entry)
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
