"""SI units of effect parameters, which depend on whether the axis is revolute or prismatic."""

from __future__ import annotations

import re
from collections.abc import Mapping

from sysid.effects.catalogue import BY_NAME
from sysid.machine import Machine

_WORD = re.compile(r"[a-z]+")
_NONE: Mapping[str, str] = {}


def parameter_unit(effect: str, parameter: str, target: str, machine: Machine, units: Mapping[str, str] = _NONE) -> str:
    """SI unit of a parameter of a named effect; ``1`` if unknown.

    Args:
        units: of the measured signals; a machine without a URDF may not state whether an axis is revolute or prismatic.
    """
    if effect not in BY_NAME:
        return "1"
    found = BY_NAME[effect]
    unit = next((p.unit for form in found.forms for p in form.parameters if p.name == parameter), "1")
    return _resolve(unit, target, machine, units, of_drive=found.stage == "force")


def _resolve(unit: str, target: str, machine: Machine, units: Mapping[str, str], of_drive: bool = False) -> str:
    """Replace ``signal``, ``drive``, ``joint`` and ``command`` by SI units; of two units a prismatic axis has the first.

    Args:
        of_drive: the force of the drive decides between two units, else the load of the joint.

    Raises:
        SettingsError: a unit that depends on an axis, of a target that is none.
    """
    if unit == "signal":
        owner, _, _ = target.partition(".")
        return machine.expected_unit(target) or units.get(target) or _resolve("joint", owner, machine, units)
    if not set(_WORD.findall(unit)) & {"command", "drive", "joint", "or"}:
        return unit
    axis = machine.axis(target)
    joint = machine.expected_unit(f"{target}.joint") or units.get(f"{target}.joint") or "rad"
    drive = "m" if axis.drives == "cylinder" else joint
    prismatic, _, revolute = unit.partition(" or ")
    if revolute:
        unit = prismatic if (drive if of_drive else joint) == "m" else revolute
    force = "N" if drive == "m" else "N·m"
    command = {"velocity": "1", "position": drive, "servo": drive, "force": force}[axis.actuation]
    named = {"command": command, "drive": drive, "joint": joint}
    return _WORD.sub(lambda word: named.get(word[0], word[0]), unit)
