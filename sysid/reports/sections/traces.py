"""Measured and simulated signals of held-out recordings, to look at closely."""

from __future__ import annotations

from typing import Any

import numpy as np

from sysid.gap.result import Traces
from sysid.reports import display, words
from sysid.reports.figures import embed, packed, thin
from sysid.reports.inputs import ReportInputs

#: A page with more recordings than this would be too heavy to open.
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
    worst = max(signals, key=lambda name: before.get(name, 0.0) / max(floor.get(name, np.inf), 1e-12))
    return {
        "data": embed("traces-data", {"recordings": {item.recording: _recording(item, signals, inputs) for item in shown}}),
        "recordings": [item.recording for item in shown],
        "left_out": len(inputs.gap.traces) - len(shown),
        "signals": [{"name": name, "label": words.signal_name(name)} for name in signals],
        "selected": worst,
        "repaired": any(not item.after.equals(item.before) for item in shown),
    }


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
