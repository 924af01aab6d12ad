"""The page of a fleet: tables, and every parameter over the recordings of each machine."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from sysid.display import number, shown_unit
from sysid.fleet.effects import ParameterHistory
from sysid.fleet.result import FleetResult
from sysid.fleet.tables import place_of, tables
from sysid.machine import Machine
from sysid.reports.charts import ChartCurve, chart
from sysid.reports.pages import page

#: Half width of the band around a value: 95 % of its recording alone.
_Z = 1.96


def fleet_page(result: FleetResult, machine: Machine) -> str:
    """The page as HTML text.

    Args:
        machine: the description of one of the machines.
    """
    return page(
        "fleet.html",
        ("page.css", "models.css"),
        Path(__file__).parent,
        title=f"{len(result.machines)} machines",
        kind="Fleet",
        facts=" · ".join(machine.dataset for machine in result.machines),
        verdict=_verdict(result),
        tables=tables(result, machine),
        notes=result.notes,
        groups=list(_groups(result, machine)),
        false_alarms=number(result.false_alarms_per_1000_hours),
    )


def _verdict(result: FleetResult) -> str:
    differing = sum(item.differs for item in result.differences)
    drifting = len({drift.machine for drift in result.drifts})
    return (
        f"{_count(len(result.effects), 'effect')} named; {_count(differing, 'parameter')} with a difference between machines; "
        f"drift on {_count(drifting, 'machine')}."
    )


def _count(count: int, what: str) -> str:
    return f"{count or 'no'} {what}{'' if count == 1 else 's'}"


def _groups(result: FleetResult, machine: Machine) -> Iterator[dict[str, Any]]:
    """Charts by parameter, one for each machine, on a common scale of values."""
    for item in result.differences:
        own = [h for h in result.histories if (h.effect, h.parameter) == (item.effect, item.parameter) and h.values]
        if own:
            title = f"{place_of(item.effect, machine)}: {item.parameter}"
            yield {"title": title, "charts": [{"machine": h.machine, "svg": Markup(_chart(h, own))} for h in own]}


def _chart(history: ParameterHistory, together: list[ParameterHistory]) -> str:
    """Values with their intervals over hours of motion; the hidden second curve gives all machines one scale."""
    factor, unit = shown_unit(history.unit)
    hours, values = np.array(history.ends), factor * np.array(history.values)
    spread = factor * _Z * np.array(history.deviations)
    ends = factor * np.array([[min(h.values), max(h.values)] for h in together])
    scale = np.full(len(hours), np.nan)
    scale[0], scale[-1] = ends.min(), ends.max()
    label = f"{history.parameter} [{unit}]" if unit else history.parameter
    lines = [ChartCurve(scale, "scale"), ChartCurve(values, "after", dots=True, spread=spread)]
    return chart(60.0 * hours, lines, ("motion [min]", label), include_zero=False)
