"""Summary: verdict, missing effects, closed share of the gap, and a drawing with their locations."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup, escape

from sysid import display
from sysid.datasets.recording import Dataset
from sysid.figures import ErrorFigure, Table, aligned, times
from sysid.gap.result import GapResult, NamedEffect, StageGap, Unnamed
from sysid.gap.statement import AGREES, left_out_sentence, missing_sentences, order_sentence, response_sentences
from sysid.machine import Machine
from sysid.reports import words
from sysid.reports.inputs import ReportInputs
from sysid.reports.picture import Mark, has_valve, machine_picture, marks_of, part_of, place_text, stage_marks
from sysid.reports.result_figures import named_sentence, point_errors, residual_sentence
from sysid.reports.sections.where import above_floor, maps_of, over_name, sentence
from sysid.reports.words import confidence, remainder_unit


def context(inputs: ReportInputs) -> dict[str, Any]:
    machine = inputs.dataset.machine
    if inputs.gap is None:
        return {
            "headline": "Simulation and machine have not been compared yet.",
            "advice": f"Run: sysid gap {inputs.dataset.reference}",
            "tone": "open",
            "sentences": [],
            "cards": [],
            "figures": None,
            "picture": Markup(machine_picture(machine)),
            "legend": _legend(machine, ""),
            "next": [],
            "sure": [],
            "chart": "",
            "held_out": [],
            "repaired": False,
        }
    gap = inputs.gap
    only = bool(gap.settings.get("localise_only"))
    lines = point_errors(gap.gap, inputs.dataset.units)
    found = disagreeing(gap) if only else []
    marks = stage_marks(found, machine) if only else marks_of(gap, machine)
    return {
        "headline": words.localised([_place(item) for item in found]) if found else gap.headline,
        "advice": f"To name causes: sysid gap {inputs.dataset.reference}" if only else words.ADVICE.get(gap.verdict, ""),
        "tone": "open" if only else {"named": "found", "no_gap": "good"}.get(gap.verdict, "open"),
        "sentences": _sentences(gap, lines),
        "cards": _located(found, gap, inputs.dataset.units) if only else _cards(gap, marks, inputs.dataset),
        "figures": _figures(lines),
        "picture": Markup(machine_picture(machine, marks)),
        "legend": _legend(
            machine, "" if not marks else "Numbers mark stages with errors." if only else "Numbers mark the results."
        ),
        "chart": Markup(dumbbells(lines, repaired=gap.repaired)),
        "held_out": gap.held_out_recordings,
        "repaired": gap.repaired,
        "next": [] if only else list(gap.next_experiment),
        "sure": [
            *_still_open(gap),
            *(note for note in gap.notes if note == left_out_sentence(machine.left_out)),
            *filter(None, [order_sentence(gap.order)]),
            *missing_sentences(gap.missing),
            *response_sentences(gap.responses, bool(gap.written)),
        ],
    }


def _legend(machine: Machine, numbers: str) -> str:
    """Legend of the drawing."""
    text = "Every axis from its drive to its joint."
    if machine.kinematics() is not None:
        cylinders = ", cylinders" if any(axis.drives == "cylinder" for axis in machine.axes) else ""
        valves = ", valves" if any(has_valve(axis, machine) for axis in machine.axes) else ""
        text = f"The machine as its URDF describes it: joints (round: revolute, square: prismatic){cylinders}{valves}."
    return f"{text} {numbers}".rstrip()


def disagreeing(gap: GapResult) -> list[StageGap]:
    """The output with the largest error of each stage above its noise floor, the largest first."""
    worst: dict[tuple[str, str], StageGap] = {}
    for item in above_floor(gap):
        worst.setdefault((item.stage, item.target), item)
    return list(worst.values())


def _place(item: StageGap) -> str:
    return f"{words.owner_name(item.target)} ({words.stage_name(item.stage)})"


def _located(found: Sequence[StageGap], gap: GapResult, units: Mapping[str, str]) -> list[dict[str, Any]]:
    """One card for each stage with an error."""
    cards = []
    for number, item in enumerate(found, 1):
        unit = units.get(item.signal, "1")
        size = f"{words.signal_name(item.signal)} has an error of {display.quantity(item.stage_rmse, unit)}, "
        details = [sentence(maps[0], item, unit)] if (maps := maps_of(gap, item)) else []
        title, text = (
            words.owner_name(item.target).capitalize(),
            f"{size}{times(item.stage_rmse, item.noise_floor)} the noise floor.",
        )
        cards.append(_card(number, title, words.stage_name(item.stage), text[0].upper() + text[1:], details, sure=False))
    return cards


def _cards(gap: GapResult, marks: Sequence[Mark], dataset: Dataset) -> list[dict[str, Any]]:
    """One card per number on the drawing: named effects, ambiguous sets, unnamed errors."""
    machine, units = dataset.machine, dataset.units
    cards = [_effect(number, effect, gap, dataset) for number, effect in enumerate(gap.effects, 1)]
    for tie in gap.ambiguous:
        text = f"{words.tie_text(tie, machine)}."
        cards.append(_card(len(cards) + 1, "Ambiguous", "", text, ["These recordings cannot distinguish them."], sure=False))
    for item in gap.unnamed:
        mark = next(m for m in marks if m.number == len(cards) + 1)
        size = display.quantity(item.rmse, remainder_unit(item.stage, item.target, machine, units), 2)
        place = f"at the {place_text(mark.part, mark.target)}"
        place = f"of {words.signal_name(item.target)} in the free run" if item.stage == "free_run" else place
        text = f"An error {place} is not explained by any known effect ({size} RMS)."
        known = (
            f"It depends on {over_name(item.depends_on)}."
            if not item.depends_on.startswith("nothing")
            else "It depends on no measured signal."
        )
        quiet = [known, *_residual_models(gap, item, dataset)]
        cards.append(_card(len(cards) + 1, "Unnamed", words.owner_name(item.target), text, quiet, sure=False))
    return cards


def _residual_models(gap: GapResult, item: Unnamed, dataset: Dataset) -> list[str]:
    """Text about the residual network of an unnamed error."""
    own = [found for found in gap.carried if found.accepted and (found.stage, found.target) == (item.stage, item.target)]
    return [f"Described by a {residual_sentence(found, dataset)}" for found in own]


def _card(number: int, title: str, target: str, sentence: str, quiet: list[str], sure: bool) -> dict[str, Any]:
    return {"number": number, "title": title, "target": target, "sentence": sentence, "quiet": quiet, "sure": sure}


def _effect(number: int, effect: NamedEffect, gap: GapResult, dataset: Dataset) -> dict[str, Any]:
    machine = dataset.machine
    where = place_text(part_of(effect.name, effect.target, machine, effect.parameters), effect.target)
    if effect.side:
        where += " (between " + ("drive and joint sensor)" if effect.side == "drive" else "joint sensor and structure)")
    quiet = [f"At the {where}. Explains {display.percent(effect.gap_share)} of the error of its stage."]
    quiet += confidence(effect, gap.candidates, machine)
    if effect.aliases:
        others = ", ".join(f"{words.effect_title(name, target, machine)} ({target})" for name, target in effect.aliases)
        quiet.append(f"Cannot be distinguished from: {others}.")
    sentence = named_sentence(effect, gap, dataset)
    target = words.signal_name(effect.target) if "." in effect.target else words.owner_name(effect.target)
    return _card(number, words.effect_title(effect.name, effect.target, machine), target, sentence, quiet, sure=True)


def _still_open(gap: GapResult) -> list[str]:
    """Whether the repair leaves no error; what remains is in the headline. Signals that say nothing are listed."""
    if not gap.agreement:
        return []
    closed = bool(gap.effects) and not any(item.remains for item in gap.agreement)
    text = f"With the repair every signal is within {AGREES} times its noise floor in every held-out recording."
    open_ = [f"Not tested by these recordings: {item.open}." for item in gap.agreement if item.open and not item.differs]
    return [*([text] if closed else []), *open_]


def _sentences(gap: GapResult, lines: list[ErrorFigure]) -> list[str]:
    """The gap of the tip position, or of the signal with the largest gap, as a sentence."""
    scored = [line for line in lines if math.isfinite(line.before) and line.noise_floor > 0.0]
    if not scored:
        return []
    worst = max(scored, key=lambda line: line.before / line.noise_floor)
    points = [line for line in scored if line.name == f"{words.owner_name('ee')} position"]
    main = points[0] if points and points[0].before > 1.5 * points[0].noise_floor else worst
    before, after, floor = main.texts
    text = f"On held-out recordings, the simulated {main.name} has an error of {before} (RMS, from the commands alone)"
    if gap.effects:
        text += f"; with the repair {after}. The noise floor is {floor}."
        if math.isfinite(main.closed):
            text += f" The repair closes {display.percent(main.closed)} of the gap above the noise floor."
    else:
        text += f"; the noise floor is {floor}."
    return [text]


def _figures(lines: Sequence[ErrorFigure]) -> Table:
    rows = []
    for line in lines:
        texts, unit = aligned((line.before, line.after, line.noise_floor), line.unit)
        rows.append((line.name, *texts, unit, display.percent(line.closed)))
    return Table(("Signal", "Before", "After", "Noise floor", "Unit", "Closed"), rows, (1, 2, 3, 5))


def dumbbells(lines: list[ErrorFigure], repaired: bool) -> str:
    """Before and after as multiples of the noise floor on one logarithmic axis (inline SVG)."""
    scored = [line for line in lines if line.noise_floor > 0.0 and math.isfinite(line.before + line.after)]
    if not scored:
        return ""
    ratios = [(line.before / line.noise_floor, line.after / line.noise_floor) for line in scored]
    decades = max(1, math.ceil(math.log10(max(1.0, *map(max, ratios)) * 1.05)))
    left, width, row = 190, 520, 28
    height = 44 + row * len(scored)

    def x(value: float) -> float:
        return left + width * (math.log10(max(value, 0.6)) + 0.25) / (decades + 0.25)

    parts = [f'<rect class="noise" x="{left}" y="8" width="{x(1.5) - left:.1f}" height="{height - 36}"/>']
    for decade in range(decades + 1):
        at = x(10.0**decade)
        parts.append(f'<line class="tick" x1="{at:.1f}" x2="{at:.1f}" y1="8" y2="{height - 28}"/>')
        label = "noise floor" if decade == 0 else display.ratio(10.0**decade)
        parts.append(f'<text class="tick" x="{at:.1f}" y="{height - 10}" text-anchor="middle">{label}</text>')
    for number, (line, (before, after)) in enumerate(zip(scored, ratios, strict=True)):
        y = 24 + row * number
        parts.append(f'<text class="row" x="{left - 12}" y="{y + 5}" text-anchor="end">{escape(line.name)}</text>')
        if not repaired:
            parts.append(f'<circle class="before" cx="{x(before):.1f}" cy="{y}" r="6"/>')
            continue
        parts.append(f'<line class="bar" x1="{x(after):.1f}" x2="{x(before):.1f}" y1="{y}" y2="{y}"/>')
        parts.append(f'<circle class="before" cx="{x(before):.1f}" cy="{y}" r="6"/>')
        parts.append(f'<circle class="after" cx="{x(after):.1f}" cy="{y}" r="6"/>')
    label = 'role="img" aria-label="Error before and after as a multiple of the noise floor"'
    return f'<svg class="dumbbells" viewBox="0 0 740 {height}" {label}>{"".join(parts)}</svg>'
