"""The answer in plain words: verdict, what is missing, how much of the gap goes away, and a picture of where."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from sysid.gap.result import GapResult, NamedEffect
from sysid.machine import Machine
from sysid.reports import display, words
from sysid.reports.effect_units import shown_parameters
from sysid.reports.inputs import ReportInputs
from sysid.reports.picture import Callout, machine_picture
from sysid.signals import point_signals


@dataclass(frozen=True)
class Closing:
    """One line of the before/after table: a signal, or the position of a point (its coordinates taken together)."""

    name: str
    unit: str
    before: float
    after: float
    noise_floor: float

    @property
    def closed(self) -> float:
        closable = self.before - self.noise_floor
        return (self.before - self.after) / closable if closable > 0.05 * self.noise_floor else math.nan


def context(inputs: ReportInputs) -> dict[str, Any]:
    machine = inputs.dataset.machine
    if inputs.gap is None:
        return {
            "headline": "The recordings are in; simulation and machine have not been compared yet.",
            "advice": f"Run: sysid gap {inputs.dataset.reference}",
            "tone": "open",
            "sentences": [],
            "effects": [],
            "lines": [],
            "picture": Markup(machine_picture(machine, [])),
            "chart": "",
            "held_out": [],
        }
    gap = inputs.gap
    lines = closings(gap.gap.before, gap.gap.after, gap.gap.noise_floor, inputs.dataset.units)
    effects = [_effect(effect, machine) for effect in gap.effects]
    return {
        "headline": words.headline(gap.verdict, len(gap.effects)),
        "advice": words.ADVICE.get(gap.verdict, ""),
        "tone": {"named": "found", "no_gap": "good"}.get(gap.verdict, "open"),
        "sentences": _sentences(gap, lines),
        "effects": effects,
        "lines": [_row(line) for line in lines],
        "picture": Markup(machine_picture(machine, _callouts(gap, effects))),
        "chart": Markup(dumbbells(lines)),
        "held_out": gap.held_out_recordings,
    }


def closings(
    before: Mapping[str, float], after: Mapping[str, float], noise_floor: Mapping[str, float], units: Mapping[str, str]
) -> list[Closing]:
    """Signals in their order, with the coordinates of each point joined to one distance."""
    lines: list[Closing] = []
    for signal in before:
        owner = signal.rpartition(".")[0]
        if owner in ("ee", "tool"):
            if signal == next(name for name in point_signals(owner) if name in before):
                names = [name for name in point_signals(owner) if name in before]
                values = [
                    math.sqrt(sum(source.get(n, math.nan) ** 2 for n in names)) for source in (before, after, noise_floor)
                ]
                lines.append(Closing(f"{words.owner_name(owner)} position", "m", *values))
            continue
        numbers = [source.get(signal, math.nan) for source in (before, after, noise_floor)]
        lines.append(Closing(words.signal_name(signal), units.get(signal, "1"), *numbers))
    return lines


def _effect(effect: NamedEffect, machine: Machine) -> dict[str, Any]:
    shown = shown_parameters(effect.name, effect.target, effect.parameters, machine)
    return {
        "title": words.effect_title(effect.name),
        "name": effect.name,
        "target": effect.target,
        "sentence": words.effect_sentence(effect.name, effect.target, shown),
        "share": effect.gap_share,
        "aliases": [f"{words.effect_title(name)} ({target})" for name, target in effect.aliases],
        "side": effect.side,
    }


def _sentences(gap: GapResult, lines: list[Closing]) -> list[str]:
    """What the figures say, about the position of the tip where it is measured, else about the signal that was worst."""
    judged = [line for line in lines if math.isfinite(line.before) and line.noise_floor > 0.0]
    if not judged:
        return []
    worst = max(judged, key=lambda line: line.before / line.noise_floor)
    points = [line for line in judged if line.name == f"{words.owner_name('ee')} position"]
    main = points[0] if points and points[0].before > 1.5 * points[0].noise_floor else worst
    before, after, floor = (display.quantity(value, main.unit) for value in (main.before, main.after, main.noise_floor))
    text = f"On recordings that no fit has seen, the simulated {main.name} is off by {before} (RMS, from the commands alone)"
    if gap.effects:
        text += f"; with the repair by {after}. Sensor noise alone would give {floor}."
        if math.isfinite(main.closed):
            text += f" {display.percent(main.closed)} of what can be closed is closed."
    else:
        text += f"; sensor noise alone would give {floor}."
    return [text]


def _row(line: Closing) -> dict[str, Any]:
    factor, unit = display.shown_unit(line.unit)
    values = [factor * value for value in (line.before, line.after, line.noise_floor)]
    decimals = display.decimals_for(values)
    before, after, floor = (display.fixed(value, decimals) for value in values)
    return {"name": line.name, "unit": unit, "before": before, "after": after, "noise_floor": floor, "closed": line.closed}


def _callouts(gap: GapResult, effects: list[dict[str, Any]]) -> list[Callout]:
    """One call-out a place; several effects on one axis share it."""
    by_target: dict[str, list[str]] = {}
    for effect in effects:
        by_target.setdefault(effect["target"].rpartition(".")[0] or effect["target"], []).append(effect["title"])
    for tie in gap.ambiguous:
        for name, target in tie:
            by_target.setdefault(target, []).append(f"{words.effect_title(name)}?")
    for item in gap.unnamed:
        by_target.setdefault(item.target, []).append("Unexplained")
    return [Callout(target, tuple(dict.fromkeys(titles)), words.owner_name(target)) for target, titles in by_target.items()]


def dumbbells(lines: list[Closing]) -> str:
    """Before and after as multiples of the noise floor on one logarithmic axis (inline SVG)."""
    judged = [line for line in lines if line.noise_floor > 0.0 and math.isfinite(line.before + line.after)]
    if not judged:
        return ""
    ratios = [(line.before / line.noise_floor, line.after / line.noise_floor) for line in judged]
    decades = max(1, math.ceil(math.log10(max(max(pair) for pair in ratios) * 1.05)))
    left, width, row = 190, 520, 28
    height = 44 + row * len(judged)

    def x(value: float) -> float:
        return left + width * (math.log10(max(value, 0.6)) + 0.25) / (decades + 0.25)

    parts = [f'<rect class="noise" x="{left}" y="8" width="{x(1.5) - left:.1f}" height="{height - 36}"/>']
    for decade in range(decades + 1):
        at = x(10.0**decade)
        parts.append(f'<line class="tick" x1="{at:.1f}" x2="{at:.1f}" y1="8" y2="{height - 28}"/>')
        label = "noise floor" if decade == 0 else display.ratio(10.0**decade)
        parts.append(f'<text class="tick" x="{at:.1f}" y="{height - 10}" text-anchor="middle">{label}</text>')
    for number, (line, (before, after)) in enumerate(zip(judged, ratios, strict=True)):
        y = 24 + row * number
        parts.append(f'<text class="row" x="{left - 12}" y="{y + 5}" text-anchor="end">{line.name}</text>')
        parts.append(f'<line class="bar" x1="{x(after):.1f}" x2="{x(before):.1f}" y1="{y}" y2="{y}"/>')
        parts.append(f'<circle class="before" cx="{x(before):.1f}" cy="{y}" r="6"/>')
        parts.append(f'<circle class="after" cx="{x(after):.1f}" cy="{y}" r="6"/>')
    label = 'role="img" aria-label="Error before and after as a multiple of the noise floor"'
    return f'<svg class="dumbbells" viewBox="0 0 740 {height}" {label}>{"".join(parts)}</svg>'
