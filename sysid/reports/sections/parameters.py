"""The values that the repaired plant uses, each with its 95 % interval."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Literal, cast

from markupsafe import Markup

from sysid.datasets.recording import Dataset
from sysid.figures import ParameterFigure, Table
from sysid.gap.result import NamedEffect
from sysid.machine import KnownEffect
from sysid.plant import effects_toml
from sysid.reports import words
from sysid.reports.inputs import ReportInputs
from sysid.reports.result_figures import parameters_of


def context(inputs: ReportInputs) -> dict[str, Any] | None:
    if inputs.gap is None or not inputs.gap.effects:
        return None
    rows = [row for effect in inputs.gap.effects for row in _rows(effect, inputs.dataset)]
    header = ("Effect", "Where", "Parameter", "Value", "95 % interval", Markup('<span class="quiet">± 20 %</span>'))
    row_classes = {number: "first" for number, row in enumerate(rows) if row[0]}
    figures = Table((*header, "Simulation before"), rows, (3, 4, 6), row_classes=row_classes)
    toml = effects_toml([_as_known(effect) for effect in inputs.gap.effects])
    return {"figures": figures, "toml": toml, "difference": inputs.gap.machine_diff, "after": inputs.gap.plant_after}


def _as_known(effect: NamedEffect) -> KnownEffect:
    parameters = {name: list(value) if isinstance(value, tuple) else value for name, value in effect.parameters.items()}
    return KnownEffect(effect.name, effect.target, parameters, cast(Literal["drive", "structure"] | None, effect.side))


def _rows(effect: NamedEffect, dataset: Dataset) -> Iterator[tuple[object, ...]]:
    machine = dataset.machine
    nominal = next((k.parameters for k in machine.effects if (k.name, k.target) == (effect.name, effect.target)), {})
    place = words.effect_title(effect.name, effect.target, machine), words.owner_name(effect.target)
    for figure in parameters_of(
        effect.name, effect.target, effect.parameters, machine, dataset.units, effect.interval95, nominal
    ):
        known = figure.name not in effect.undetermined
        value = Markup("<b>{}</b>").format(figure.text if known else "not determined")
        before = "not in it" if figure.before is None else figure.before_text
        bar = _bar(figure) if known else ""
        yield (*place, figure.label, value, figure.interval, bar, Markup('<span class="quiet">{}</span>').format(before))
        place = "", ""


def _bar(figure: ParameterFigure) -> Markup:
    """The interval around the estimate on a scale of ± 20 %; none for vectors."""
    value, ends = figure.value, figure.interval95
    if isinstance(value, list | tuple) or value == 0.0 or ends is None or not math.isfinite(float(ends[0]) + float(ends[1])):
        return Markup("")
    left, right = (max(-1.0, min(1.0, (end - value) / (0.2 * abs(value)))) for end in ends)
    x = [60 + 54 * end for end in (left, right)]
    scale = '<line class="scale" x1="6" x2="114" y1="8" y2="8"/>'
    known = f'<line class="range" x1="{x[0]:.1f}" x2="{x[1]:.1f}" y1="8" y2="8"/><circle cx="60" cy="8" r="4"/>'
    return Markup(f'<svg class="interval" viewBox="0 0 120 16" aria-hidden="true">{scale}{known}</svg>')
