"""Effects that the recordings do not excite, and what to record."""

from __future__ import annotations

from typing import Any

from sysid import display
from sysid.gap.result import EXPERIMENTS
from sysid.reports import words
from sysid.reports.inputs import ReportInputs
from sysid.reports.words import remainder_unit, with_titles


def context(inputs: ReportInputs) -> dict[str, Any] | None:
    gap = inputs.gap
    if gap is None or not (gap.next_experiment or gap.excitation or gap.ambiguous or gap.unnamed):
        return None
    rows = [
        {
            "effect": words.effect_title(item.name, item.target, inputs.dataset.machine),
            "target": words.owner_name(item.target),
            "have": f"{display.number(item.have)} {item.unit}".strip(),
            "need": f"{display.number(item.need)} {item.unit}".strip(),
            "sufficient": item.sufficient,
        }
        for item in sorted(gap.excitation, key=lambda item: (item.sufficient, item.target, item.name))
    ]
    units = inputs.dataset.units
    return {
        "steps": gap.next_experiment,
        "planned": [{"words": item.words, "file": f"{EXPERIMENTS}/{item.name}.toml"} for item in gap.experiments],
        "lacking": [row for row in rows if not row["sufficient"]],
        "enough": [row for row in rows if row["sufficient"]],
        "ties": [
            " or ".join(
                f"{words.effect_title(name, target, inputs.dataset.machine)} ({words.owner_name(target)})"
                for name, target in tie
            )
            for tie in gap.ambiguous
        ],
        "unnamed": [
            {
                "stage": words.stage_name(item.stage),
                "target": words.owner_name(item.target),
                "rmse": display.quantity(item.rmse, remainder_unit(item.stage, item.target, inputs.dataset.machine, units)),
                "depends_on": words.signal_name(item.depends_on) if item.depends_on in units else item.depends_on,
                "form": with_titles(item.form, inputs.dataset.machine),
            }
            for item in gap.unnamed
        ],
    }
