"""Tables of a fleet result, the same on the console and on the page; and the page, with every parameter over the recordings of
each machine.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from sysid.display import NOTHING, number, quantity, shown_unit, with_unit
from sysid.figures import Table
from sysid.fleet.differences import Difference
from sysid.fleet.drift import Drift
from sysid.fleet.effects import FleetEffect, ParameterHistory
from sysid.fleet.result import FleetResult
from sysid.machine import Machine
from sysid.reports.charts import ChartCurve, captioned, chart
from sysid.reports.pages import page
from sysid.reports.words import effect_place


def tables(result: FleetResult, machine: Machine) -> tuple[Table, ...]:
    """Named effects, differences between the machines, drifts.

    Args:
        machine: the description of one of the machines, for titles by actuation.
    """
    count = len(result.machines)
    named = tuple((place_of(e, machine), f"{len(result.named_on(e))} of {count}") for e in result.effects)
    return (
        Table(("Effect", "Named on"), named, (1,), "Named effects", "No effect is named on any machine."),
        Table(
            ("Effect", "Parameter", "Mean", "SD between machines", "p", "Machines"),
            tuple(_difference(item, machine) for item in result.differences),
            (2, 3, 4),
            "Differences between machines",
            "No parameter is determined on two machines.",
        ),
        drift_table(result, machine),
    )


def drift_table(result: FleetResult, machine: Machine) -> Table:
    """The parameters that changed."""
    header = ("Machine", "Effect", "Parameter", "Before", "After", "Since", "Noticed")
    return Table(header, tuple(_drift(item, machine) for item in result.drifts), (3, 4), "Drifts", "No parameter drifts.")


def place_of(effect: FleetEffect, machine: Machine) -> str:
    """``Valve dead-band of boom``."""
    return effect_place(effect.name, effect.target, machine)


def _difference(item: Difference, machine: Machine) -> tuple[str, ...]:
    p = NOTHING if item.p_value is None else f"{item.p_value:.2g}" if item.p_value >= 1e-4 else "< 0.0001"
    if item.p_value is None:
        verdict = "one machine" if item.machines else "not determined"
    elif not item.differs:
        verdict = "no difference"
    else:
        verdict = f"differ: {', '.join(item.deviating)}" if item.deviating else "differ"
    return (
        place_of(item.effect, machine), item.parameter, quantity(item.mean, item.unit), quantity(item.between, item.unit), p,
        verdict,
    )  # fmt: skip


def _drift(item: Drift, machine: Machine) -> tuple[str, ...]:
    noticed = f"{item.noticed}, after {quantity(3600.0 * item.noticed_hours, 's')} of motion"
    return (
        item.machine, place_of(item.effect, machine), item.parameter, quantity(item.before, item.unit),
        quantity(item.after, item.unit), item.since, noticed,
    )  # fmt: skip


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
            yield {"title": title, "charts": [captioned(_chart(h, own), h.machine) for h in own]}


def _chart(history: ParameterHistory, together: list[ParameterHistory]) -> Markup:
    """Values with their intervals over hours of motion; the hidden second curve gives all machines one scale."""
    factor, _ = shown_unit(history.unit)
    hours, values = np.array(history.ends), factor * np.array(history.values)
    spread = factor * _Z * np.array(history.deviations)
    ends = factor * np.array([[min(h.values), max(h.values)] for h in together])
    scale = np.full(len(hours), np.nan)
    scale[0], scale[-1] = ends.min(), ends.max()
    lines = [ChartCurve(scale, "scale"), ChartCurve(values, "after", dots=True, spread=spread)]
    return chart(60.0 * hours, lines, ("motion [min]", with_unit(history.parameter, history.unit)), include_zero=False)
