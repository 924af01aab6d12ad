"""All fitted candidates, and why each was rejected."""

from __future__ import annotations

import math
from typing import Any

from sysid import display
from sysid.datasets.recording import Dataset
from sysid.figures import Table
from sysid.gap.result import ComparedModel, GapResult, NamedEffect
from sysid.machine import Machine
from sysid.reports import words
from sysid.reports.inputs import ReportInputs
from sysid.reports.result_figures import parameters_of
from sysid.reports.words import RejectedEffect, label_of, least_error, outcome, rejected

#: Largest number of shown rows of a stage.
MAX_ROWS = 25


def context(inputs: ReportInputs) -> dict[str, Any] | None:
    gap = inputs.gap
    if gap is None or not (gap.candidates or any(effect.alternatives for effect in gap.effects)):
        return None
    groups: dict[tuple[str, str], list[ComparedModel]] = {}
    for candidate in gap.candidates:
        groups.setdefault((candidate.stage, candidate.target), []).append(candidate)
    return {
        "named": [_named(effect, gap, inputs.dataset.machine) for effect in gap.effects],
        "groups": [_group(stage, target, rows, gap, inputs.dataset) for (stage, target), rows in groups.items()],
    }


def _named(effect: NamedEffect, gap: GapResult, machine: Machine) -> dict[str, Any]:
    found = rejected(effect, gap.candidates, machine)
    largest = max((item.times for item in found if math.isfinite(item.times)), default=math.nan)
    target = words.owner_name(effect.target)
    by_reason: dict[str, list[RejectedEffect]] = {}
    for item in found:  # alternatives with the same reason share a line
        by_reason.setdefault(item.why, []).append(item)
    return {
        "title": words.effect_title(effect.name, effect.target, machine),
        "target": target,
        "alternatives": [
            {
                "titles": ", ".join(item.title if item.target == target else f"{item.title} ({item.target})" for item in group),
                "why": why,
                "bar": _bar(group[0].times, largest),
            }
            for why, group in by_reason.items()
        ],
    }


def _bar(times: float, largest: float) -> int | None:
    """Length of the bar of an error [%], on a logarithmic scale from that of the named effect."""
    if not math.isfinite(times) or largest <= 1.0:
        return None
    return round(100.0 * max(0.0, math.log(max(times, 1.0))) / math.log(max(largest, 1.1)))


def _group(stage: str, target: str, rows: list[ComparedModel], gap: GapResult, dataset: Dataset) -> dict[str, Any]:
    ordered = sorted(rows, key=lambda row: (not math.isfinite(row.selection_rmse), row.selection_rmse))
    best, named = least_error(ordered), [(effect.name, effect.target) for effect in gap.effects]
    shown: list[tuple[object, ...]] = []
    row_classes = {}
    for row in ordered[:MAX_ROWS]:
        why, won = outcome(row, best, named)
        if won:
            row_classes[len(shown)] = "won"
        figures = display.fixed(row.fit_rmse, 2), display.fixed(row.delta_bic, 0)
        shown.append((_titles(row, target, dataset.machine), _parameters(row, dataset), *figures, why))
    header = ("Added", "Fitted values", "Error", "2 Δ log evidence", "Result")
    return {
        "stage": words.stage_name(stage),
        "target": words.owner_name(target),
        "count": len(ordered),
        "figures": Table(header, shown, (2, 3), row_classes=row_classes),
    }


def _titles(row: ComparedModel, target: str, machine: Machine) -> str:
    """Titles of the added effects."""
    added = []
    for text in row.effects:
        name, of, rest = label_of(text)
        extra = [words.owner_name(of)] if of and of != target else []
        extra += [rest] if rest else []
        added.append(words.effect_title(name, of or target, machine) + (f" ({', '.join(extra)})" if extra else ""))
    return " + ".join(added) or "nothing added"


def _parameters(row: ComparedModel, dataset: Dataset) -> str:
    """Values as text; a key is ``parameter`` or ``effect(target).parameter``, with ``[i]`` for a vector component."""
    groups: dict[str, list[str]] = {}
    for key, value in row.parameters.items():
        label, _, name = key.rpartition(".")
        label = label or (row.effects[0] if row.effects else "")
        effect, target, _ = label_of(label)
        figures = parameters_of(effect, target or row.target, {name: value}, dataset.machine, dataset.units)
        groups.setdefault(label, []).extend(figure.sentence for figure in figures)
    return "; ".join(", ".join(parts) for parts in groups.values())
