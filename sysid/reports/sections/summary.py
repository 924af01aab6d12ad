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
from sysid.reports.result_figures import effect_figures, named_sentence, next_steps, point_errors, residual_sentence
from sysid.reports.sections.where import above_floor, maps_of, over_name, sentence
from sysid.reports.words import confidence, remainder_unit

#: What a dataset without a comparison lacks.
_NOTHING: dict[str, Any] = {
    **dict.fromkeys(("advice", "chart", "figures"), ""),
    **dict.fromkeys(("brief", "errors", "cards", "sure", "held_out"), ()),
    "repaired": False,
}


def context(inputs: ReportInputs) -> dict[str, Any]:
    gap, machine, units = inputs.gap, inputs.dataset.machine, inputs.dataset.units
    if gap is None:
        return {
            **_NOTHING,
            "headline": "Simulation and machine have not been compared yet.",
            "tone": "open",
            "picture": machine_picture(machine),
            "legend": _legend(machine, ""),
            "next": [("Compare", Markup("<code>sysid gap {}</code>").format(inputs.dataset.reference))],
        }
    lines, only = point_errors(gap.gap, units), bool(gap.settings.get("localise_only"))
    found = disagreeing(gap) if only else []
    marks = stage_marks(found, machine) if only else marks_of(gap, machine)
    cards = _located(found, gap, units) if only else _cards(gap, marks, inputs.dataset)
    places = [f"{words.owner_name(item.target)} ({words.stage_name(item.stage)})" for item in found]
    numbers = "Numbers mark stages with errors." if only else "Numbers mark the results."
    return {
        "headline": words.localised(places) if places else gap.headline,
        "advice": "" if only else words.ADVICE.get(gap.verdict, ""),
        "tone": "open" if only else {"named": "found", "no_gap": "good"}.get(gap.verdict, "open"),
        "picture": machine_picture(machine, marks),
        "legend": _legend(machine, numbers if marks else ""),
        "brief": cards,
        "errors": main_errors(lines),
        "next": _next(inputs, gap, only),
        "cards": [] if only else cards,
        "sure": [
            *_still_open(gap),
            *(note for note in gap.notes if note == left_out_sentence(machine.left_out)),
            *filter(None, [order_sentence(gap.order)]),
            *missing_sentences(gap.missing),
            *response_sentences(gap.responses, bool(gap.written)),
        ],
        "figures": _figures(lines),
        "chart": dumbbells(lines, repaired=gap.repaired),
        "held_out": gap.held_out_recordings,
        "repaired": gap.repaired,
    }


def main_errors(lines: Sequence[ErrorFigure]) -> list[ErrorFigure]:
    """The errors of the first screen: tool and tip; without a measured point the two largest, in noise floors."""
    measured = [line for line in lines if math.isfinite(line.before)]
    names = [f"{words.owner_name(point)} position" for point in ("tool", "ee")]
    points = [line for name in names for line in measured if line.name == name]
    return points or sorted(measured, key=lambda line: -line.before / max(line.noise_floor, 1e-300))[:2]


def _next(inputs: ReportInputs, gap: GapResult, only: bool) -> list[tuple[str, Markup]]:
    """What to do with the result, and what to record: (word, text)."""
    code, more = Markup("<code>{}</code>"), Markup(' <a href="#{}">{}</a>')
    name, found = inputs.dataset.name, list[tuple[str, Markup]]()
    if only:
        return [("Name causes", code.format(f"sysid gap {inputs.dataset.reference}"))]
    if gap.promotion is not None:
        state = "is promoted." if gap.promotion.promoted else "is stored, not promoted."
        text = Markup("{} {}{}").format(gap.promotion.version, state, more.format("proof", "conditions"))
        found.append(("Promoted" if gap.promotion.promoted else "Stored", text))
        found.append(("Export", code.format(f"sysid export {gap.promotion.version} --to mjcf --out exports")))
    elif gap.repaired:
        found.append(("Store the repair", code.format(f"sysid gap {name} --add")))
    steps = next_steps(gap, inputs.dataset) or list(gap.next_experiment)
    if steps:
        first = steps[0].removeprefix("Record ")
        others = more.format("experiments", f"{len(steps) - 1} more") if len(steps) > 1 else ""
        found.append(("Record", Markup("{}{}").format(first[:1].upper() + first[1:], others)))
    return found


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


def _located(found: Sequence[StageGap], gap: GapResult, units: Mapping[str, str]) -> list[dict[str, Any]]:
    """One card for each stage with an error."""
    cards = []
    for number, item in enumerate(found, 1):
        unit = units.get(item.signal, "1")
        error, over = display.quantity(item.stage_rmse, unit), f"{times(item.stage_rmse, item.noise_floor)} the noise floor"
        name = words.signal_name(item.signal)
        details = [sentence(maps[0], item, unit)] if (maps := maps_of(gap, item)) else []
        title = words.owner_name(item.target).capitalize()
        text = f"{name[0].upper()}{name[1:]} has an error of {error}, {over}."
        cards.append(_card(number, title, words.stage_name(item.stage), f"{error} RMS, {over}", text, details, sure=False))
    return cards


def _cards(gap: GapResult, marks: Sequence[Mark], dataset: Dataset) -> list[dict[str, Any]]:
    """One card per number on the drawing: named effects, ambiguous sets, unnamed errors."""
    machine, units = dataset.machine, dataset.units
    cards = [_effect(number, effect, gap, dataset) for number, effect in enumerate(gap.effects, 1)]
    for tie in gap.ambiguous:
        text = f"{words.tie_text(tie, machine)}."
        why = "These recordings cannot distinguish them."
        cards.append(_card(len(cards) + 1, "Ambiguous", "", text, text, [why], sure=False))
    for item in gap.unnamed:
        mark = next(m for m in marks if m.number == len(cards) + 1)
        size = display.quantity(item.rmse, remainder_unit(item.stage, item.target, machine, units), 2)
        place = f"at the {place_text(mark.part, mark.target)}"
        place = f"of {words.signal_name(item.target)} in the free run" if item.stage == "free_run" else place
        text = f"An error {place} is not explained by any known effect ({size} RMS)."
        depends = "no measured signal" if item.depends_on.startswith("nothing") else over_name(item.depends_on)
        known = f"It depends on {depends}."
        quiet = [known, *_residual_models(gap, item, dataset)]
        value = f"{size} RMS, {known[0].lower()}{known[1:-1]}"
        cards.append(_card(len(cards) + 1, "Unnamed", words.owner_name(item.target), value, text, quiet, sure=False))
    return cards


def _residual_models(gap: GapResult, item: Unnamed, dataset: Dataset) -> list[str]:
    """Text about the residual network of an unnamed error."""
    own = [found for found in gap.carried if found.accepted and (found.stage, found.target) == (item.stage, item.target)]
    return [f"Described by a {residual_sentence(found, dataset)}" for found in own]


def _card(number: int, title: str, target: str, value: str, sentence: str, quiet: list[str], sure: bool) -> dict[str, Any]:
    own = {"number": number, "title": title, "target": target, "value": value}
    return {**own, "sentence": sentence, "quiet": quiet, "sure": sure}


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
    value = ", ".join(figure.sentence for figure in effect_figures(effect, dataset))
    return _card(number, words.effect_title(effect.name, effect.target, machine), target, value, sentence, quiet, sure=True)


def _still_open(gap: GapResult) -> list[str]:
    """Whether the repair leaves no error; what remains is in the headline. Signals that say nothing are listed."""
    if not gap.agreement:
        return []
    closed = bool(gap.effects) and not any(item.remains for item in gap.agreement)
    text = f"With the repair every signal is within {AGREES} times its noise floor in every held-out recording."
    open_ = [f"Not tested by these recordings: {item.open}." for item in gap.agreement if item.open and not item.differs]
    return [*([text] if closed else []), *open_]


def _figures(lines: Sequence[ErrorFigure]) -> Table:
    rows = []
    for line in lines:
        texts, unit = aligned((line.before, line.after, line.noise_floor), line.unit)
        rows.append((line.name, *texts, unit, display.percent(line.closed)))
    return Table(("Signal", "Before", "After", "Noise floor", "Unit", "Closed"), rows, (1, 2, 3, 5))


def dumbbells(lines: Sequence[ErrorFigure], repaired: bool) -> Markup:
    """Before and after as multiples of the noise floor on one logarithmic axis, a row for each signal with its values."""
    scored = [line for line in lines if line.noise_floor > 0.0 and math.isfinite(line.before + line.after)]
    if not scored:
        return Markup("")
    ratios = [(line.before / line.noise_floor, line.after / line.noise_floor) for line in scored]
    decades = max(1, math.ceil(math.log10(max(1.0, *map(max, ratios)) * 1.05)))

    def x(value: float) -> float:
        """Percent of the width; the axis begins at 0.56 noise floors."""
        return 100.0 * (math.log10(max(value, 0.6)) + 0.25) / (decades + 0.25)

    ticks = [f'<i class="tick" style="left:{x(10.0**decade):.1f}%"></i>' for decade in range(decades + 1)]
    band = f'<i class="noise" style="width:{x(1.5):.1f}%"></i>{"".join(ticks)}'
    rows = []
    for line, (before, after) in zip(scored, ratios, strict=True):
        left, right = sorted((x(before), x(after)))
        marks, text = f'<i class="before" style="left:{x(before):.1f}%"></i>', line.texts[0]
        if repaired:
            marks = f'<i class="bar" style="left:{left:.1f}%;width:{right - left:.1f}%"></i>{marks}'
            marks += f'<i class="after" style="left:{x(after):.1f}%"></i>'
            text += f" → {line.texts[1]}"
        rows.append(f"<li><span>{escape(line.name)}</span><b>{band}{marks}</b><small>{escape(text)}</small></li>")
    names = ["floor", *(display.ratio(10.0**decade) for decade in range(1, decades + 1))]
    places = (f'<i style="left:{x(10.0**decade):.1f}%">{name}</i>' for decade, name in enumerate(names))
    scale = f'<li class="scale" aria-hidden="true"><b>{"".join(places)}</b></li>'
    return Markup(f'<ol class="dumbbells">{"".join(rows)}{scale}</ol>')
