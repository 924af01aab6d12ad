"""Tables of a fleet result, the same on the console and on the page."""

from __future__ import annotations

from dataclasses import dataclass

from sysid.display import NOTHING, quantity
from sysid.fleet.differences import Difference
from sysid.fleet.drift import Drift
from sysid.fleet.effects import FleetEffect
from sysid.fleet.result import FleetResult
from sysid.machine import Machine
from sysid.reports.words import effect_place


@dataclass(frozen=True)
class Table:
    """Text cells; ``right`` numbers the columns that are aligned right."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    right: tuple[int, ...]
    empty: str


def tables(result: FleetResult, machine: Machine) -> tuple[Table, ...]:
    """Named effects, differences between the machines, drifts.

    Args:
        machine: the description of one of the machines, for titles by actuation.
    """
    count = len(result.machines)
    named = tuple((place_of(e, machine), f"{len(result.named_on(e))} of {count}") for e in result.effects)
    return (
        Table("Named effects", ("Effect", "Named on"), named, (1,), "No effect is named on any machine."),
        Table(
            "Differences between machines",
            ("Effect", "Parameter", "Mean", "SD between machines", "p", "Machines"),
            tuple(_difference(item, machine) for item in result.differences),
            (2, 3, 4),
            "No parameter is determined on two machines.",
        ),
        drift_table(result, machine),
    )


def drift_table(result: FleetResult, machine: Machine) -> Table:
    """The parameters that changed."""
    return Table(
        "Drifts",
        ("Machine", "Effect", "Parameter", "Before", "After", "Since", "Noticed"),
        tuple(_drift(item, machine) for item in result.drifts),
        (3, 4),
        "No parameter drifts.",
    )


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
