"""The values that the repaired plant uses, each with its 95 % interval."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal, cast

from markupsafe import Markup

from sysid import display
from sysid.effects.units import parameter_unit
from sysid.gap.result import NamedEffect
from sysid.machine import KnownEffect, Machine
from sysid.plant import effects_toml
from sysid.reports import words
from sysid.reports.inputs import ReportInputs
from sysid.reports.words import UNDETERMINED, shown


def context(inputs: ReportInputs) -> dict[str, Any] | None:
    if inputs.gap is None or not inputs.gap.effects:
        return None
    machine = inputs.dataset.machine
    rows = [row for effect in inputs.gap.effects for row in _rows(effect, machine, inputs.dataset.units)]
    toml = effects_toml([_as_known(effect) for effect in inputs.gap.effects])
    return {"rows": rows, "toml": toml, "difference": inputs.gap.machine_diff, "after": inputs.gap.plant_after}


def _as_known(effect: NamedEffect) -> KnownEffect:
    parameters = {name: list(value) if isinstance(value, tuple) else value for name, value in effect.parameters.items()}
    return KnownEffect(effect.name, effect.target, parameters, cast(Literal["drive", "structure"] | None, effect.side))


def _rows(effect: NamedEffect, machine: Machine, units: Mapping[str, str]) -> list[dict[str, Any]]:
    nominal = next((k.parameters for k in machine.effects if (k.name, k.target) == (effect.name, effect.target)), {})
    rows: list[dict[str, Any]] = []
    for name, value in effect.parameters.items():
        low, high = effect.interval95.get(name, (math.nan, math.nan))
        known = nominal.get(name)
        rows.append(
            {
                "effect": words.effect_title(effect.name, effect.target, machine) if not rows else "",
                "target": words.owner_name(effect.target) if not rows else "",
                "parameter": name.replace("_", " "),
                "value": UNDETERMINED
                if name in effect.undetermined
                else shown(effect.name, name, effect.target, value, machine, _digits(low, high), units),
                "interval": _interval(low, high, parameter_unit(effect.name, name, effect.target, machine, units)),
                "bar": Markup("") if name in effect.undetermined else _bar(value, low, high),
                "nominal": shown(effect.name, name, effect.target, known, machine, units=units)
                if known is not None
                else "not in it",
                "first": not rows,
            }
        )
    return rows


def _digits(low: Any, high: Any) -> int:
    """Digits of the value, equal to those of its interval."""
    if isinstance(low, (list, tuple)):
        return max(display.digits_for(float(a), float(b)) for a, b in zip(low, high, strict=True))
    return display.digits_for(float(low), float(high))


def _interval(low: Any, high: Any, unit: str) -> str:
    if isinstance(low, (list, tuple)):
        return ", ".join(display.interval(float(a), float(b), unit) for a, b in zip(low, high, strict=True))
    if not math.isfinite(float(low) + float(high)):
        return display.NOTHING
    return display.interval(float(low), float(high), unit)


def _bar(value: Any, low: Any, high: Any) -> Markup:
    """The interval around the estimate on a scale of ± 20 %."""
    if isinstance(value, (list, tuple)) or not math.isfinite(float(low) + float(high)) or value == 0.0:
        return Markup("")
    span = 0.2 * abs(value)
    left, right = (max(-1.0, min(1.0, (end - value) / span)) for end in (low, high))
    x = [60 + 54 * end for end in (left, right)]
    scale = '<line class="scale" x1="6" x2="114" y1="8" y2="8"/>'
    known = f'<line class="range" x1="{x[0]:.1f}" x2="{x[1]:.1f}" y1="8" y2="8"/><circle cx="60" cy="8" r="4"/>'
    return Markup(f'<svg class="interval" viewBox="0 0 120 16" aria-hidden="true">{scale}{known}</svg>')
