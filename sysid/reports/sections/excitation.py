"""Excitation verdict for every effect and location, and what to record: before any fit, and after a gap result."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from markupsafe import Markup

from sysid import display
from sysid.figures import Table
from sysid.gap.experiment.excitation_verdict import ExcitationReport, ExcitationVerdict
from sysid.gap.result import EXPERIMENTS, Excitation
from sysid.machine import Machine
from sysid.reports import words
from sysid.reports.dataset_texts import SIDES, amount, by_reason, request_text
from sysid.reports.inputs import ReportInputs
from sysid.signals import split_signal

#: Position of the needed amount on a bar [%].
MARK = 50.0
_ORDER = ("lacking", "ready", "hidden")


def context(inputs: ReportInputs) -> dict[str, Any] | None:
    found = inputs.excitation
    if found is None:
        return None
    machine = inputs.dataset.machine
    counted = {_column(v, machine) for v in found.verdicts if v.status != "hidden"}
    columns, others = [name for name in machine.axis_names if name in counted], "" in counted
    return {
        "ready": len(found.of("ready")),
        "lacking": len(found.of("lacking")),
        "hidden": len(found.of("hidden")),
        "total": len(found.verdicts),
        "counted": ", ".join(found.counted) if len(found.counted) <= 6 else f"{len(found.counted)} recordings",
        "notes": list(found.notes),
        "requests": [
            {
                "text": request_text(request, machine),
                "effects": ", ".join(dict.fromkeys(words.effect_title(n, t, machine) for n, t in request.effects)),
            }
            for request in found.requests
        ],
        "columns": columns,
        "others": others,
        "rows": _rows(found, machine, columns, others),
        "reasons": by_reason(found.of("hidden"), machine),
        "mark": MARK,
    }


def _rows(found: ExcitationReport, machine: Machine, columns: Sequence[str], others: bool) -> list[dict[str, Any]]:
    """One row for each effect and side of the sensor; insufficient ones first."""
    lines: dict[tuple[str, str | None], list[ExcitationVerdict]] = {}
    for verdict in found.verdicts:
        lines.setdefault((verdict.name, verdict.side), []).append(verdict)
    rows = []
    for (name, side), verdicts in lines.items():
        counted = [v for v in verdicts if v.need is not None]
        if not counted:  # not observable: listed with its reason
            continue
        names = [*columns, ""] if others else columns
        cells = [_cell([v for v in verdicts if _column(v, machine) == column], named=column == "") for column in names]
        title = words.effect_title(name, verdicts[0].target, machine)
        rows.append(
            {
                "title": title,
                "side": SIDES.get(side or "", ""),
                "need": f"{counted[0].need:g} {counted[0].unit}",
                "cells": cells,
                "lacks": any(v.status == "lacking" for v in verdicts),
            }
        )
    return sorted(rows, key=lambda row: not row["lacks"])


def _column(verdict: ExcitationVerdict, machine: Machine) -> str:
    """The axis of a verdict; empty for the machine, its base, its tool and its clocks."""
    owner = split_signal(verdict.target)[0] or verdict.target
    return owner if owner in machine.axis_names else ""


def _cell(verdicts: Sequence[ExcitationVerdict], named: bool) -> dict[str, Any] | None:
    """The worst of the verdicts of a cell (two sensors of an axis share one); None if there is none.

    Args:
        named: include the location, which the column does not state.
    """
    if not verdicts:
        return None
    worst = min(verdicts, key=lambda v: (_ORDER.index(v.status), (v.have or 0.0) / (v.need or 1.0)))
    share = 0.0 if worst.have is None or not worst.need else worst.have / worst.need
    return {
        "status": worst.status,
        "have": display.NOTHING if worst.have is None else amount(worst).split(" of ")[0],
        "width": round(min(MARK * share, 100.0), 1),
        "place": words.owner_name(worst.target) if named else "",
        "title": "; ".join(v.text for v in verdicts),
    }


# -- what to record next ------------------------------------------------------------------------------------------------


def experiments(inputs: ReportInputs) -> dict[str, Any] | None:
    """Context of the section about recordings that a gap result suggests."""
    gap, machine, units = inputs.gap, inputs.dataset.machine, inputs.dataset.units
    if gap is None or not (gap.next_experiment or gap.excitation or gap.ambiguous or gap.unnamed):
        return None
    counted = sorted(gap.excitation, key=lambda item: (item.target, item.name))
    unnamed = [
        (
            words.stage_name(item.stage),
            words.owner_name(item.target),
            display.quantity(item.rmse, words.remainder_unit(item.stage, item.target, machine, units)),
            words.signal_name(item.depends_on) if item.depends_on in units else item.depends_on,
            Markup("<code>{}</code>").format(words.with_titles(item.form, machine)),
        )
        for item in gap.unnamed
    ]
    return {
        "steps": gap.next_experiment,
        "planned": [(item.words, f"{EXPERIMENTS}/{item.name}.toml") for item in gap.experiments],
        "lacking": _amounts([item for item in counted if not item.sufficient], machine),
        "enough": _amounts([item for item in counted if item.sufficient], machine),
        "ties": [words.tie_text(tie, machine) for tie in gap.ambiguous],
        "unnamed": Table(("Stage", "Where", "Size (RMS)", "Depends on", "Form"), unnamed, (2,)),
    }


def _amounts(found: Sequence[Excitation], machine: Machine) -> Table:
    rows = [
        (
            words.effect_title(item.name, item.target, machine),
            words.owner_name(item.target),
            f"{display.number(item.have)} {item.unit}".strip(),
            f"{display.number(item.need)} {item.unit}".strip(),
        )
        for item in found
    ]
    return Table(("Effect", "Where", "Recorded", "Needed"), rows, (2, 3))
