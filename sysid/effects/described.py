"""Effects that a description of a machine names: name, target, side and parameters against the catalogue."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from sysid.effects.catalogue import effect_named, form_for
from sysid.effects.effect import Effect, Parameter
from sysid.errors import SettingsError, nearest
from sysid.machine import KnownEffect, Machine
from sysid.signals import axis_signal, point_signals


def check_described(machine: Machine) -> None:
    """Check the ``[[effects]]`` of ``machine.toml``. Streams, the targets of clock effects, are known once logs are read.

    Raises:
        SettingsError: an effect, target, side or parameter does not exist or does not fit, with the nearest valid name.
    """
    for item in machine.effects:
        check_known_effect(machine, item, None)


def check_known_effect(machine: Machine, item: KnownEffect, streams: Collection[str] | None) -> None:
    """Check one instance.

    Args:
        streams: valid targets of clock effects; None: not known yet.

    Raises:
        SettingsError: any of its parts does not exist or does not fit.
    """
    where = f"machine {machine.name}: effect"
    effect = effect_named(item.name, where)
    form = form_for(effect, frozenset(item.parameters), where)
    side_of(effect, item.side)
    _check_target(machine, effect, item.target, streams)
    for parameter in form.parameters:
        _check_value(item, parameter, where)


def side_of(effect: Effect, side: str | None) -> str | None:
    """The side, checked; the first admissible one where none is given."""
    if not effect.sides:
        if side is not None:
            raise SettingsError(f"effect {effect.name}", f"side {side!r}", "no side: this effect has one place only")
        return None
    if side is None:
        return effect.sides[0]
    if side not in effect.sides:
        raise SettingsError(f"effect {effect.name}", f"side {side!r}", nearest(side, effect.sides))
    return side


def predicted_signals(machine: Machine) -> tuple[str, ...]:
    """Signals that a plant of this machine may predict and a sensor may measure."""
    drives = (axis.driven for axis in machine.axes)
    joints = (axis_signal(name, "joint") for name in machine.axis_names)
    speeds = (axis_signal(name, "speed") for name in machine.axis_names)
    return tuple(dict.fromkeys((*drives, *joints, *point_signals("ee"), *point_signals("tool"), *speeds)))


def _check_target(machine: Machine, effect: Effect, target: str, streams: Collection[str] | None) -> None:
    where = f"effect {effect.name}"
    if effect.target == "axis":
        if target not in machine.axis_names:
            raise SettingsError(where, f"unknown axis {target!r}", nearest(target, machine.axis_names))
        actuation = machine.axis(target).actuation
        if effect.actuations and actuation not in effect.actuations:
            found, expected = f"target {target!r} is {actuation}-actuated", " or ".join(effect.actuations)
            raise SettingsError(f"machine {machine.name}: effect {effect.name}", found, expected)
    elif effect.target == "signal":
        valid = predicted_signals(machine)
        if target not in valid:
            raise SettingsError(where, f"unknown target {target!r}", nearest(target, valid))
    elif effect.target == "stream":
        if streams is not None and target not in streams:
            raise SettingsError(
                where, f"unknown target {target!r}", nearest(target, streams) if streams else "no stream is known"
            )
    elif target != effect.target:
        raise SettingsError(where, f"target {target!r}", repr(effect.target))
    elif effect.of_links and any(axis.actuation == "servo" for axis in machine.axes):
        expected, remedy = "masses of a servo arm in its URDF", "Add the mass to the last link of the URDF."
        raise SettingsError(f"machine {machine.name}: effect {effect.name}", "an arm of servo axes", expected, remedy)


def _check_value(item: KnownEffect, parameter: Parameter, where: str) -> None:
    value = np.atleast_1d(np.asarray(item.parameters[parameter.name], dtype=np.float64))
    (low, high), count = parameter.bounds, len(parameter.components)
    if value.shape != (count,) or not np.all((value >= low) & (value <= high)):
        raise SettingsError(
            f"{where} {item.name} on {item.target}",
            f"{parameter.name} = {item.parameters[parameter.name]}",
            f"{'a number' if count == 1 else f'{count} numbers'} in [{low}, {high}] {parameter.unit}",
        )
