"""Errors of the fitted networks on held-out recordings: figures, profiles, spikes."""

from __future__ import annotations

from typing import Any

import numpy as np

from sysid import display
from sysid.networks import PAPER_MAX
from sysid.reports import words
from sysid.reports.charts import figure, packed
from sysid.reports.inputs import ReportInputs
from sysid.validate import OutputReport, ValidationReport

TITLES = {
    "actuator": "Actuator networks",
    "history": "Actuator networks with history",
    "motion": "Command to motion",
    "forward": "Forward network",
}
ABOUT = {
    "actuator": "Cylinder displacement to joint angle and back, one network per direction.",
    "history": "Cylinder displacement to joint angle and back along a motion, depending on past motion.",
    "motion": "Commands to motion in free runs: errors some seconds after each start, and over whole recordings.",
    "forward": "Joint values to the position of the tip.",
}
ROWS = {"motion": "in motion", "poses": "static poses"}
#: Spikes listed for each report.
MAX_SPIKES = 12


def context(inputs: ReportInputs) -> dict[str, Any] | None:
    if not inputs.validations:
        return None
    return {"reports": [_report(report, number) for number, report in enumerate(inputs.validations)]}


def _report(report: ValidationReport, number: int) -> dict[str, Any]:
    spikes = sorted(((output, spike) for output in report.outputs for spike in output.spikes), key=lambda pair: -pair[1].sigmas)
    return {
        "title": TITLES[report.kind],
        "model": report.model,
        "about": ABOUT[report.kind],
        "recommendation": report.recommendation,
        "role": {"held_out": "held-out", "select": "selection", "fit": "fit"}[report.role],
        "paper": report.kind == "forward" and any(output.output in PAPER_MAX for output in report.outputs),
        "rows": [_row(output, decimals_of(report, output.unit)) for output in report.outputs],
        "round_trips": [
            f"{axis} "
            + " and ".join((display.quantity(trip.joint_rmse, "rad", 2), display.quantity(trip.cylinder_rmse, "m", 2)))
            for axis, trip in report.round_trips.items()
        ],
        "figures": [_profiles(output, f"net-{number}-{index}") for index, output in enumerate(report.outputs)],
        "spikes": [
            {
                "output": words.signal_name(output.output),
                "recording": spike.recording,
                "time": display.fixed(spike.time, 2),
                "error": display.quantity(spike.error, output.unit, 2),
                "cause": spike.cause.replace("_", " "),
            }
            for output, spike in spikes[:MAX_SPIKES]
        ],
        "more_spikes": max(0, len(spikes) - MAX_SPIKES),
    }


def decimals_of(report: ValidationReport, unit: str) -> int:
    """Common decimals of all figures of one unit, in report and console: two digits of the smallest error or noise floor."""
    factor, _ = display.shown_unit(unit)
    figures = [value for output in report.outputs if output.unit == unit for value in (output.metrics.rmse, output.noise_floor)]
    return display.decimals_for(factor * value for value in figures if value is not None)


def _row(output: OutputReport, decimals: int) -> dict[str, Any]:
    factor, unit = display.shown_unit(output.unit)
    metrics = output.metrics
    best = min(output.baselines, key=lambda name: output.baselines[name].rmse, default="")
    paper = PAPER_MAX.get(output.output) if output.rows == "poses" else None
    return {
        "output": words.signal_name(output.output),
        "rows": ROWS[output.rows],
        "unit": unit,
        "rmse": display.fixed(factor * metrics.rmse, decimals),
        "p95": display.fixed(factor * metrics.p95, decimals),
        "max": display.fixed(factor * metrics.max, decimals),
        "floor": display.NOTHING if output.noise_floor is None else display.fixed(factor * output.noise_floor, decimals),
        "baseline": f"{best}: {display.fixed(factor * output.baselines[best].rmse, decimals)}" if best else display.NOTHING,
        "paper": display.fixed(factor * paper, 1) if paper is not None else "",
    }


def _profiles(output: OutputReport, identifier: str) -> dict[str, Any]:
    """Error over each input's position, speed, direction and load: one panel per profile, one column per input."""
    signals = list(output.inputs)
    kinds = [
        kind
        for kind in ("position", "speed", "direction", "load")
        if any(_kind(p.variable)[0] == kind for p in output.profiles)
    ]
    # One input: panels in a row. Several inputs: one column each.
    alone = len(signals) == 1
    rows, columns = (1, len(kinds)) if alone else (len(kinds), len(signals))
    factor, unit = display.shown_unit(output.unit)
    label = f"error [{unit}]" if unit else "error"
    traces: list[dict[str, Any]] = []
    layout: dict[str, Any] = {
        "grid": {"rows": rows, "columns": columns, "pattern": "independent", "xgap": 0.16, "ygap": 0.36},
        "showlegend": True,
        "bargap": 0.08,
        "margin": {"l": 58, "r": 12, "t": 52, "b": 56},
    }
    for profile in output.profiles:
        kind, signal = _kind(profile.variable)
        column = kinds.index(kind) if alone else signals.index(signal)
        index = 1 + column + (0 if alone else kinds.index(kind) * columns)
        suffix = "" if index == 1 else str(index)
        x_factor, x_unit = display.shown_unit(profile.unit)
        if kind == "direction":
            x: Any = ["negative", "still", "positive"]
        else:
            edges = x_factor * np.array(profile.edges)
            x = packed(0.5 * (edges[1:] + edges[:-1]))
        title = words.signal_name(signal) if kind == "position" else kind
        common = {"x": x, "xaxis": f"x{suffix}", "yaxis": f"y{suffix}", "showlegend": index == 1}
        rmse, p95 = (packed(factor * np.array(values)) for values in (profile.rmse, profile.p95))
        if kind == "direction":
            traces.append({**common, "type": "bar", "y": p95, "name": "95 %", "marker": {"color": "$noise"}})
            traces.append({**common, "type": "bar", "y": rmse, "name": "RMS", "marker": {"color": "$link"}})
        else:
            line = {"type": "scatter", "mode": "lines"}
            traces.append(
                {**common, **line, "y": p95, "name": "95 %", "line": {"color": "$noise", "width": 1.4, "dash": "dot"}}
            )
            traces.append({**common, **line, "y": rmse, "name": "RMS", "line": {"color": "$link", "width": 2}})
        layout[f"xaxis{suffix}"] = {"title": f"{title} [{x_unit}]" if x_unit and kind != "direction" else title}
        layout[f"yaxis{suffix}"] = {"title": label if column == 0 else "", "rangemode": "tozero"}
    return {
        "title": f"{words.signal_name(output.output)}, {ROWS[output.rows]}",
        "figure": figure(identifier, traces, layout, 110 + 190 * rows) if traces else "",
    }


def _kind(variable: str) -> tuple[str, str]:
    """``speed of boom.cylinder`` → ``("speed", "boom.cylinder")``; a bare signal is a position."""
    kind, separator, signal = variable.partition(" of ")
    return (kind, signal) if separator else ("position", variable)
