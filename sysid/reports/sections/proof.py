"""The proof: promotion conditions, share of the gap that each effect closes, gap in the PyBullet world."""

from __future__ import annotations

import math
from typing import Any

from markupsafe import Markup

from sysid import display
from sysid.gap.result import GapResult, NamedEffect, Promotion, WorldGap
from sysid.machine import Machine
from sysid.reports import words
from sysid.reports.inputs import ReportInputs
from sysid.reports.sections.summary import dumbbells, signal_gaps

#: Name of a condition → text.
CONDITIONS = {
    "names": "Every added effect is named",
    "stages": "The error of the repaired stages is smaller",
    "free run": "No signal of the whole chain has a larger error",
    "promoted until now": "No error is larger than with the promoted version",
    "world": "No error is larger in the PyBullet world",
}
#: Ratio of the gap in the world to that of the compiled plant from which it is reported.
WORLD_RATIO = 1.5
MARKS = {"passed": "✓", "failed": "✗", "left out": "–"}


def context(inputs: ReportInputs) -> dict[str, Any] | None:
    gap = inputs.gap
    if gap is None or not (gap.effects or gap.promotion or gap.world_gap):
        return None
    return {
        "held_out": gap.held_out_recordings,
        "promotion": _promotion(gap.promotion, gap) if gap.promotion is not None else None,
        "effects": [_effect(effect, inputs.dataset.machine) for effect in gap.effects],
        "world": _world(gap.world_gap, inputs) if gap.world_gap is not None else None,
        "dataset": gap.dataset.partition("@")[0],
    }


def _promotion(found: Promotion, gap: GapResult) -> dict[str, Any]:
    name = found.version.partition("@")[0]
    back = found.previous if found.previous not in ("", found.version) else gap.plant_before
    return {
        "promoted": found.promoted,
        "version": found.version,
        "name": name,
        "current": found.current,
        "back": back if found.promoted else found.version,
        "reason": found.reason,
        "checks": [
            {
                "mark": MARKS[c.status],
                "status": c.status.replace(" ", "-"),
                "condition": CONDITIONS.get(c.name, c.name),
                "text": c.text,
            }
            for c in found.checks
        ],
    }


def _effect(effect: NamedEffect, machine: Machine) -> dict[str, Any]:
    found = effect.evidence
    return {
        "title": words.effect_title(effect.name, effect.target, machine),
        "target": words.owner_name(effect.target),
        "share": effect.gap_share,
        "without": display.ratio(found.ratio) if found is not None else display.NOTHING,
        "bic": display.number(found.delta_bic) if found is not None else display.NOTHING,
        "nats": display.number(found.nats) if found is not None else display.NOTHING,
        "chance": _chance(found.p_value) if found is not None else display.NOTHING,
    }


def _chance(value: float) -> str:
    return f"≤ {display.number(value, 1)}" if math.isfinite(value) else display.NOTHING


def _world(found: WorldGap, inputs: ReportInputs) -> dict[str, Any]:
    units = inputs.dataset.units
    there, plain = (signal_gaps(g.before, g.after, g.noise_floor, units) for g in (found.world, found.compiled))
    rows = []
    for world, compiled in zip(there, plain, strict=True):
        factor, unit = display.shown_unit(world.unit)
        values = [factor * v for v in (world.before, compiled.before, world.after, compiled.after, world.noise_floor)]
        decimals = display.decimals_for(values)
        rows.append({"name": world.name, "unit": unit, "values": [display.fixed(value, decimals) for value in values]})
    return {
        "rows": rows,
        "apart": [w.name for w, c in zip(there, plain, strict=True) if w.after > WORLD_RATIO * max(c.after, c.noise_floor)],
        "chart": Markup(dumbbells(there, repaired=found.world.after != found.world.before)),
        "recordings": found.recordings,
        "skipped": found.skipped,
    }
