"""Texts of stages, verdicts, signals and named effects with their parameters and units, for reports and the console."""

from __future__ import annotations

import string
from collections.abc import Collection, Mapping
from typing import Any

from sysid import display
from sysid.effects import BY_NAME
from sysid.effects.units import parameter_unit
from sysid.effects.wording import sentences_of, title_of
from sysid.machine import Machine

#: Stage → what is compared, in the order of the signal chain.
STAGES: dict[str, tuple[str, str]] = {
    "command": ("Command → actuator", "driven by the recorded command"),
    "force": ("Force → motion", "force that the measured motion needs"),
    "joint": ("Actuator → joint", "driven by the measured actuator"),
    "end_effector": ("Joints → tip", "driven by the measured joints"),
    "tool": ("Tip → tool", "driven by the measured tip"),
}

OWNERS = {"ee": "tip", "tool": "tool", "machine": "whole machine", "base": "base"}

ADVICE = {
    "no_gap": "No effect was added. Effects that the recordings do not excite may still be present; they are listed below.",
    "unnamed": "No effect was named. The properties of the remaining error are listed below.",
    "ambiguous": "No effect was selected. A recording that distinguishes them is described under “What to record next”.",
    "insufficient_excitation": "The recordings that are needed are described under “What to record next”.",
}


def effect_title(name: str, target: str = "", machine: Machine | None = None) -> str:
    """The title of an effect, as its file gives it for actuation and drive of the axis ``target``."""
    if name not in BY_NAME:
        return name.replace("_", " ").capitalize()
    return title_of(BY_NAME[name], target, machine)


def effect_place(name: str, target: str, machine: Machine) -> str:
    """``Dead time of boom``; ``Sensor bias of boom.joint``."""
    return f"{effect_title(name, target, machine)} of {OWNERS.get(target, target)}"


def effect_sentence(
    name: str, target: str, parameters: Mapping[str, str], beside: Collection[str] = (), machine: Machine | None = None
) -> str:
    """One sentence about a named effect.

    Args:
        parameters: already formatted with their units.
        beside: other effects named on the same target.
    """
    values = {"target": owner_name(target), **parameters}
    effect = BY_NAME.get(name)
    special = [text for other, text in effect.beside.items() if other in beside] if effect else []
    for template in (*special, *(sentences_of(effect, target, machine) if effect else ())):
        if {field for _, field, _, _ in string.Formatter().parse(template) if field} <= set(values):
            return template.format(**values)
    listed = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in parameters.items())
    return f"{effect_title(name, target, machine)} of the {values['target']}: {listed}."


def owner_name(target: str) -> str:
    return OWNERS.get(target, target)


def signal_name(signal: str) -> str:
    """``boom.cylinder`` → ``boom cylinder``; ``ee.x`` → ``tip x``."""
    owner, _, quantity = signal.rpartition(".")
    return f"{owner_name(owner)} {quantity}"


def stage_name(stage: str) -> str:
    return STAGES[stage][0] if stage in STAGES else stage.replace("_", " ").capitalize()


def localised(places: list[str]) -> str:
    """The places of the stages with errors, as a sentence."""
    listed = ", ".join(places[:4]) + (f" and {len(places) - 4} more" if len(places) > 4 else "")
    return f"Simulation and machine disagree at: {listed}."


#: Text for a parameter that the recordings do not determine.
UNDETERMINED = "not determined"
_NONE: Mapping[str, str] = {}


def shown(
    effect: str,
    parameter: str,
    target: str,
    value: Any,
    machine: Machine,
    digits: int = 3,
    units: Mapping[str, str] = _NONE,
) -> str:
    """A parameter's value with its unit as text; vectors component by component."""
    unit = parameter_unit(effect, parameter, target, machine, units)
    if isinstance(value, (list, tuple)):
        return "(" + ", ".join(display.quantity(float(item), unit, digits) for item in value) + ")"
    return display.quantity(float(value), unit, digits)


def shown_parameters(
    effect: str, target: str, parameters: Mapping[str, Any], machine: Machine, units: Mapping[str, str] = _NONE
) -> dict[str, str]:
    """All parameters of an effect as text."""
    return {name: shown(effect, name, target, value, machine, units=units) for name, value in parameters.items()}


def remainder_unit(stage: str, target: str, machine: Machine, units: Mapping[str, str]) -> str:
    """Unit of the unnamed error of a stage: that of the signal that the stage predicts."""
    if stage == "free_run":
        return units.get(target) or machine.expected_unit(target) or "1"
    if target not in machine.axis_names:
        return units.get(f"{target}.x", "m")
    if stage == "force":
        return units.get(f"{target}.command", "N")
    if stage == "joint":
        return units.get(f"{target}.joint", "rad")
    return units.get(machine.axis(target).driven, "m")
