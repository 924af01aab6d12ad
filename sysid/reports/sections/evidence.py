"""Every candidate that was fitted, and why each one lost."""

from __future__ import annotations

import math
import re
from typing import Any

from sysid.gap.result import Candidate, GapResult
from sysid.reports import display, words
from sysid.reports.effect_units import shown
from sysid.reports.inputs import ReportInputs


def context(inputs: ReportInputs) -> dict[str, Any] | None:
    if inputs.gap is None or not (inputs.gap.candidates or any(effect.alternatives for effect in inputs.gap.effects)):
        return None
    groups: dict[tuple[str, str], list[Candidate]] = {}
    for candidate in inputs.gap.candidates:
        groups.setdefault((candidate.stage, candidate.target), []).append(candidate)
    return {
        "named": [_named(effect.name, effect.target, inputs.gap) for effect in inputs.gap.effects],
        "groups": [_group(stage, target, rows, inputs) for (stage, target), rows in groups.items()],
    }


def _named(name: str, target: str, gap: GapResult) -> dict[str, Any]:
    effect = next(effect for effect in gap.effects if (effect.name, effect.target) == (name, target))
    return {
        "title": words.effect_title(name),
        "target": words.owner_name(target),
        "share": effect.gap_share,
        "alternatives": [
            {"title": words.effect_title(other.name), "target": words.owner_name(other.target), "why": other.rejected_by}
            for other in effect.alternatives
        ],
    }


def _group(stage: str, target: str, rows: list[Candidate], inputs: ReportInputs) -> dict[str, Any]:
    unit = _unit(stage, target, inputs)
    factor, label = display.shown_unit(unit)
    decimals = display.decimals_for([factor * row.selection_rmse for row in rows])
    best = min((row.selection_rmse for row in rows if math.isfinite(row.selection_rmse)), default=math.nan)
    ordered = sorted(rows, key=lambda row: (not math.isfinite(row.selection_rmse), row.selection_rmse))
    return {
        "stage": words.stage_name(stage),
        "target": words.owner_name(target),
        "unit": label,
        "rows": [
            {
                "effects": " + ".join(_title(effect) for effect in row.effects) or "no effect added",
                "parameters": ", ".join(_parameter(row, name, value, inputs) for name, value in row.parameters.items()),
                "fit": display.fixed(factor * row.fit_rmse, decimals),
                "selection": display.fixed(factor * row.selection_rmse, decimals),
                "bic": display.fixed(row.delta_bic, 0),
                "verdict": row.verdict,
                "won": row.verdict.startswith("named") or (row.selection_rmse == best and row.verdict.startswith("best")),
            }
            for row in ordered
        ],
    }


def _title(effect: str) -> str:
    """``valve_deadband`` or ``valve_deadband(boom)`` / ``boom.valve_deadband`` in words."""
    words_in = [word for word in re.split(r"[^\w#]+", effect) if word]
    names = [word for word in words_in if word in words.EFFECTS]
    rest = [words.owner_name(word) for word in words_in if word not in words.EFFECTS]
    title = words.effect_title(names[0]) if names else effect.replace("_", " ")
    return f"{title} ({', '.join(rest)})" if names and rest else title


def _parameter(row: Candidate, key: str, value: float, inputs: ReportInputs) -> str:
    """``key`` may carry its effect and target (``boom.valve_deadband.positive``); the parameter is its last word."""
    parts = key.split(".")
    name = parts[-1]
    known = [re.split(r"[^\w]+", effect) for effect in row.effects]
    candidates = [word for group in known for word in group if word in words.EFFECTS]
    effect = next((part for part in parts if part in words.EFFECTS), candidates[0] if candidates else "")
    return f"{name.replace('_', ' ')} {shown(effect, name, row.target, value, inputs.dataset.machine)}"


def _unit(stage: str, target: str, inputs: ReportInputs) -> str:
    """Unit of the output that a stage is judged by."""
    machine = inputs.dataset.machine
    if target in machine.axis_names and stage != "joint":
        return inputs.dataset.units.get(machine.axis(target).driven, "m")
    return inputs.dataset.units.get(f"{target}.joint", "m")
