"""The proof: promotion conditions, share of the gap that each effect closes, gap in the PyBullet world; what was added; and all
fitted candidates, with why each was rejected.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Literal, cast

from markupsafe import Markup

from sysid import display
from sysid.datasets.recording import Dataset
from sysid.figures import ParameterFigure, Table, aligned
from sysid.gap.result import ComparedModel, EffectEvidence, GapResult, NamedEffect, WorldGap
from sysid.machine import KnownEffect, Machine
from sysid.plant import effects_toml
from sysid.reports import words
from sysid.reports.inputs import ReportInputs
from sysid.reports.result_figures import parameters_of, point_errors
from sysid.reports.sections.summary import dumbbells
from sysid.reports.words import RejectedEffect, label_of, least_error, outcome, rejected

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


def context(inputs: ReportInputs) -> dict[str, Any] | None:
    gap = inputs.gap
    if gap is None or not (gap.effects or gap.promotion or gap.world_gap):
        return None
    return {
        "held_out": gap.held_out_recordings,
        "promotion": gap.promotion,
        "conditions": CONDITIONS,
        "plant_before": gap.plant_before,
        "effects": _effects(gap, inputs.dataset.machine),
        "evidence": _evidence(gap, inputs.dataset.machine),
        "world": _world(gap.world_gap, inputs) if gap.world_gap is not None else None,
        "dataset": gap.dataset.partition("@")[0],
    }


def _effects(gap: GapResult, machine: Machine) -> Table:
    rows = [
        (*_place(effect, machine), Markup("<b>{}</b>").format(display.percent(effect.gap_share)), display.ratio(without))
        for effect in gap.effects
        for without in [effect.evidence.ratio if effect.evidence else math.nan]
    ]
    return Table(("Effect", "Where", "Closes of its stage's gap", "Error without it"), rows, (2, 3))


def _evidence(gap: GapResult, machine: Machine) -> Table:
    rows = [(*_place(effect, machine), *_support(effect.evidence)) for effect in gap.effects]
    return Table(("Effect", "Where", "2 Δ log evidence", "Nats", "p-value"), rows, (2, 3, 4))


def _place(effect: NamedEffect, machine: Machine) -> tuple[str, str]:
    return words.effect_title(effect.name, effect.target, machine), words.owner_name(effect.target)


def _support(found: EffectEvidence | None) -> tuple[str, str, str]:
    """Log evidence, nats and p-value."""
    if found is None:
        return display.NOTHING, display.NOTHING, display.NOTHING
    chance = f"≤ {display.number(found.p_value, 1)}" if math.isfinite(found.p_value) else display.NOTHING
    return display.number(found.delta_bic), display.number(found.nats), chance


def _world(found: WorldGap, inputs: ReportInputs) -> dict[str, Any]:
    there, plain = (point_errors(gap, inputs.dataset.units) for gap in (found.world, found.compiled))
    rows = []
    for world, compiled in zip(there, plain, strict=True):
        values = (world.before, compiled.before, world.after, compiled.after, world.noise_floor)
        texts, unit = aligned(values, world.unit)
        rows.append((world.name, *texts, unit))
    header = ("Signal", "Before", "compiled", "After", "compiled", "Noise floor", "Unit")
    return {
        "figures": Table(header, rows, (1, 2, 3, 4, 5)),
        "apart": [w.name for w, c in zip(there, plain, strict=True) if w.after > WORLD_RATIO * max(c.after, c.noise_floor)],
        "chart": dumbbells(there, repaired=found.world.after != found.world.before),
        "recordings": found.recordings,
        "skipped": found.skipped,
    }


# -- what was added -----------------------------------------------------------------------------------------------------


def parameters(inputs: ReportInputs) -> dict[str, Any] | None:
    """The values that the repaired plant uses, each with its 95 % interval."""
    if inputs.gap is None or not inputs.gap.effects:
        return None
    rows = [row for effect in inputs.gap.effects for row in _parameter_rows(effect, inputs.dataset)]
    header = ("Effect", "Where", "Parameter", "Value", "95 % interval", Markup('<span class="quiet">± 20 %</span>'))
    row_classes = {number: "first" for number, row in enumerate(rows) if row[0]}
    figures = Table((*header, "Simulation before"), rows, (3, 4, 6), row_classes=row_classes)
    toml = effects_toml([_as_known(effect) for effect in inputs.gap.effects])
    return {"figures": figures, "toml": toml, "difference": inputs.gap.machine_diff, "after": inputs.gap.plant_after}


def _as_known(effect: NamedEffect) -> KnownEffect:
    parameters = {name: list(value) if isinstance(value, tuple) else value for name, value in effect.parameters.items()}
    return KnownEffect(effect.name, effect.target, parameters, cast(Literal["drive", "structure"] | None, effect.side))


def _parameter_rows(effect: NamedEffect, dataset: Dataset) -> Iterator[tuple[object, ...]]:
    machine = dataset.machine
    nominal = next((k.parameters for k in machine.effects if (k.name, k.target) == (effect.name, effect.target)), {})
    place = words.effect_title(effect.name, effect.target, machine), words.owner_name(effect.target)
    for figure in parameters_of(
        effect.name, effect.target, effect.parameters, machine, dataset.units, effect.interval95, nominal
    ):
        known = figure.name not in effect.undetermined
        value = Markup("<b>{}</b>").format(figure.text if known else "not determined")
        before = "not in it" if figure.before is None else figure.before_text
        bar = _interval_bar(figure) if known else ""
        yield (*place, figure.label, value, figure.interval, bar, Markup('<span class="quiet">{}</span>').format(before))
        place = "", ""


def _interval_bar(figure: ParameterFigure) -> Markup:
    """The interval around the estimate on a scale of ± 20 %; none for vectors."""
    value, ends = figure.value, figure.interval95
    if isinstance(value, list | tuple) or value == 0.0 or ends is None or not math.isfinite(float(ends[0]) + float(ends[1])):
        return Markup("")
    left, right = (max(-1.0, min(1.0, (end - value) / (0.2 * abs(value)))) for end in ends)
    x = [60 + 54 * end for end in (left, right)]
    scale = '<line class="scale" x1="6" x2="114" y1="8" y2="8"/>'
    known = f'<line class="range" x1="{x[0]:.1f}" x2="{x[1]:.1f}" y1="8" y2="8"/><circle cx="60" cy="8" r="4"/>'
    return Markup(f'<svg class="interval" viewBox="0 0 120 16" aria-hidden="true">{scale}{known}</svg>')


# -- candidates ---------------------------------------------------------------------------------------------------------

#: Largest number of shown rows of a stage.
MAX_ROWS = 25


def candidates(inputs: ReportInputs) -> dict[str, Any] | None:
    """All fitted candidates, and why each was rejected."""
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
        shown.append((_titles(row, target, dataset.machine), _values(row, dataset), *figures, why))
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


def _values(row: ComparedModel, dataset: Dataset) -> str:
    """Values as text; a key is ``parameter`` or ``effect(target).parameter``, with ``[i]`` for a vector component."""
    groups: dict[str, list[str]] = {}
    for key, value in row.parameters.items():
        label, _, name = key.rpartition(".")
        label = label or (row.effects[0] if row.effects else "")
        effect, target, _ = label_of(label)
        figures = parameters_of(effect, target or row.target, {name: value}, dataset.machine, dataset.units)
        groups.setdefault(label, []).extend(figure.sentence for figure in figures)
    return "; ".join(", ".join(parts) for parts in groups.values())
