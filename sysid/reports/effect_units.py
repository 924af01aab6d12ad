"""Units of effect parameters, which depend on whether the axis is revolute or prismatic."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sysid.effects import BY_NAME
from sysid.errors import SettingsError
from sysid.machine import Machine
from sysid.reports import display

#: Text for a parameter that the recordings do not determine.
UNDETERMINED = "not determined"
_NONE: Mapping[str, str] = {}


def parameter_unit(effect: str, parameter: str, target: str, machine: Machine, units: Mapping[str, str] = _NONE) -> str:
    """SI unit of a parameter of a named effect; ``1`` if unknown.

    Args:
        units: of the measured signals; a machine without a URDF does not state whether an axis turns or slides.
    """
    if effect not in BY_NAME:
        return "1"
    for form in BY_NAME[effect].forms:
        for entry in form.parameters:
            if entry.name == parameter:
                return _resolve(entry.unit, target, machine, units)
    return "1"


def _resolve(unit: str, target: str, machine: Machine, units: Mapping[str, str]) -> str:
    """Replace ``signal``, ``drive``, ``joint`` and ``command`` by SI units; of ``N or N·m`` a prismatic axis has the first."""
    if unit == "signal":
        owner, _, _ = target.partition(".")
        return machine.expected_unit(target) or units.get(target) or _resolve("joint", owner, machine, units)
    try:
        axis = machine.axis(target)
    except SettingsError:
        return unit
    measured = machine.expected_unit(f"{target}.joint") or units.get(f"{target}.joint")
    joint = measured or ("m" if axis.actuation == "force" else "rad")
    drive = "m" if axis.drives == "cylinder" else joint
    sliding, _, turning = unit.partition(" or ")
    if turning:
        unit = sliding if drive == "m" else turning
    command = {"velocity": "1", "position": drive, "force": "N" if drive == "m" else "N·m"}[axis.actuation]
    return unit.replace("command", command).replace("drive", drive).replace("joint", joint)


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
    if target not in machine.axis_names:
        return units.get(f"{target}.x", "m")
    if stage == "force":
        return units.get(f"{target}.command", "N")
    if stage == "joint":
        return units.get(f"{target}.joint", "rad")
    return units.get(machine.axis(target).driven, "m")
