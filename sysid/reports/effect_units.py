"""Effect parameters and remaining errors as text with their units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sysid import display
from sysid.effects.units import parameter_unit
from sysid.machine import Machine

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
