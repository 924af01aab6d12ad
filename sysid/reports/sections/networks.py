"""Errors of the fitted networks on held-out recordings: figures, profiles, spikes."""

from __future__ import annotations

from typing import Any

import numpy as np

from sysid import display
from sysid.figures import ROWS, Table
from sysid.networks import PAPER_MAX
from sysid.reports import words
from sysid.reports.charts import figure, packed
from sysid.reports.inputs import ReportInputs
from sysid.reports.result_figures import cause, largest_spikes, network_rows, spike_error
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
#: Curves over a variable; bars over a direction have their colours.
NOISE_LINE: dict[str, Any] = {"color": "$noise", "width": 1.4, "dash": "dot"}
ERROR_LINE: dict[str, Any] = {"color": "$link", "width": 2}
#: Spikes listed for each report.
MAX_SPIKES = 12


def context(inputs: ReportInputs) -> dict[str, Any] | None:
    if not inputs.validations:
        return None
    return {"reports": [_report(report, number) for number, report in enumerate(inputs.validations)]}


def _report(report: ValidationReport, number: int) -> dict[str, Any]:
    spikes = largest_spikes(report)
    paper = PAPER_MAX if report.kind == "forward" and any(output.output in PAPER_MAX for output in report.outputs) else None
    beside = [] if paper is None else ["Paper, largest"]
    header = ("Output", "Rows", "RMS", "95 %", "Largest", *beside, "Sensor noise", "Unit", "Best simple model (RMS)")
    rows = [(row[0], ROWS[row[1]], *row[2:]) for row in network_rows(report, paper, words.signal_name)]
    shown = [
        (
            words.signal_name(output.output),
            spike.recording,
            display.fixed(spike.time, 2),
            spike_error(output, spike),
            cause(spike),
        )
        for output, spike in spikes[:MAX_SPIKES]
    ]
    return {
        "title": TITLES[report.kind],
        "model": report.model,
        "about": ABOUT[report.kind],
        "recommendation": report.recommendation,
        "paper": paper is not None,
        "figures": Table(header, rows, (*range(2, 6 + len(beside)), 7 + len(beside))),
        "round_trips": [
            f"{axis} "
            + " and ".join((display.quantity(trip.joint_rmse, "rad", 2), display.quantity(trip.cylinder_rmse, "m", 2)))
            for axis, trip in report.round_trips.items()
        ],
        "profiles": [_profiles(output, f"net-{number}-{index}") for index, output in enumerate(report.outputs)],
        "spikes": Table(("Output", "Recording", "Time [s]", "Error", "Nearest cause"), shown, (2, 3)),
        "more_spikes": max(0, len(spikes) - MAX_SPIKES),
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
    factor, label = display.shown_unit(output.unit)[0], display.with_unit("error", output.unit)
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
        x_factor, _ = display.shown_unit(profile.unit)
        if kind == "direction":
            x: Any = ["negative", "still", "positive"]
        else:
            edges = x_factor * np.array(profile.edges)
            x = packed(0.5 * (edges[1:] + edges[:-1]))
        title = words.signal_name(signal) if kind == "position" else kind
        common = {"x": x, "xaxis": f"x{suffix}", "yaxis": f"y{suffix}", "showlegend": index == 1}
        for name, values, line in (("95 %", profile.p95, NOISE_LINE), ("RMS", profile.rmse, ERROR_LINE)):
            own = {"type": "bar"} if kind == "direction" else {"type": "scatter", "mode": "lines"}
            look = {"marker": {"color": line["color"]}} if kind == "direction" else {"line": line}
            traces.append({**common, **own, "y": packed(factor * np.array(values)), "name": name, **look})
        layout[f"xaxis{suffix}"] = {"title": title if kind == "direction" else display.with_unit(title, profile.unit)}
        layout[f"yaxis{suffix}"] = {"title": label if column == 0 else "", "rangemode": "tozero"}
    return {
        "title": f"{words.signal_name(output.output)}, {ROWS[output.rows]}",
        "figure": figure(identifier, traces, layout, 110 + 190 * rows) if traces else "",
    }


def _kind(variable: str) -> tuple[str, str]:
    """``speed of boom.cylinder`` → ``("speed", "boom.cylinder")``; a bare signal is a position."""
    kind, separator, signal = variable.partition(" of ")
    return (kind, signal) if separator else ("position", variable)
