"""Every candidate that was fitted, and why each one lost."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

from sysid.gap.result import Candidate, NamedEffect
from sysid.machine import Machine
from sysid.reports import display, words
from sysid.reports.effect_units import shown
from sysid.reports.inputs import ReportInputs

#: ``backlash(slew, drive)``: effect, target and whatever else tells two instances apart.
_LABEL = re.compile(r"(?P<name>\w+)\((?P<target>[\w.]+)(?:,\s*(?P<rest>[^)]*))?\)")
#: Rows shown of a stage; a search may try hundreds of combinations.
MAX_ROWS = 25


def context(inputs: ReportInputs) -> dict[str, Any] | None:
    gap = inputs.gap
    if gap is None or not (gap.candidates or any(effect.alternatives for effect in gap.effects)):
        return None
    groups: dict[tuple[str, str], list[Candidate]] = {}
    for candidate in gap.candidates:
        groups.setdefault((candidate.stage, candidate.target), []).append(candidate)
    return {
        "named": [_named(effect) for effect in gap.effects],
        "groups": [_group(stage, target, rows, inputs.dataset.machine) for (stage, target), rows in groups.items()],
    }


def _named(effect: NamedEffect) -> dict[str, Any]:
    return {
        "title": words.effect_title(effect.name),
        "target": words.owner_name(effect.target),
        "share": effect.gap_share,
        "alternatives": [
            {"title": words.effect_title(other.name), "target": words.owner_name(other.target), "why": other.rejected_by}
            for other in effect.alternatives
        ],
    }


def _group(stage: str, target: str, rows: list[Candidate], machine: Machine) -> dict[str, Any]:
    ordered = sorted(rows, key=lambda row: (not math.isfinite(row.selection_rmse), row.selection_rmse))
    return {
        "stage": words.stage_name(stage),
        "target": words.owner_name(target),
        "count": len(ordered),
        "rows": [
            {
                "effects": " + ".join(_title(label, target) for label in row.effects) or "nothing added",
                "parameters": _parameters(row, machine),
                "fit": display.fixed(row.fit_rmse, 2),
                "selection": display.fixed(row.selection_rmse, 2),
                "bic": display.fixed(row.delta_bic, 0),
                "verdict": row.verdict,
                "won": row.verdict.startswith(("named", "kept", "chosen")),
            }
            for row in ordered[:MAX_ROWS]
        ],
    }


def _title(label: str, target: str) -> str:
    """``valve_deadband(boom)`` in words; the target only where it is not the one of the table."""
    match = _LABEL.fullmatch(label)
    if match is None:
        return words.effect_title(label)
    extra = [words.owner_name(match["target"])] if match["target"] != target else []
    extra += [match["rest"]] if match["rest"] else []
    return words.effect_title(match["name"]) + (f" ({', '.join(extra)})" if extra else "")


def _parameters(row: Candidate, machine: Machine) -> str:
    """Values in words; a key is ``parameter`` or ``effect(target).parameter``, with ``[i]`` for a part of a vector."""
    groups: dict[str, list[str]] = {}
    for key, value in row.parameters.items():
        label, _, name = key.rpartition(".")
        label = label or (row.effects[0] if row.effects else "")
        match = _LABEL.fullmatch(label)
        effect, target = (match["name"], match["target"]) if match is not None else (label, row.target)
        text = shown(effect, name.partition("[")[0], target, value, machine)
        groups.setdefault(label, []).append(f"{name.replace('_', ' ')} {text}")
    return _joined(groups)


def _joined(groups: Mapping[str, list[str]]) -> str:
    return "; ".join(", ".join(parts) for parts in groups.values())
