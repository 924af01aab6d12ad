"""Titles and sentences of effects on a machine, by actuation and drive of the axis."""

from __future__ import annotations

from sysid.effects.effect import Actuation, Drive, Effect
from sysid.machine import Machine


def title_of(effect: Effect, target: str, machine: Machine | None) -> str:
    """``Servo lag`` on a servo, ``Valve lag`` on a cylinder; without a machine the general title."""
    own = (effect.titles[key] for key in _actuated(target, machine) if key in effect.titles)
    return next(own, effect.title)


def sentences_of(effect: Effect, target: str, machine: Machine | None) -> tuple[str, ...]:
    """Templates of its sentences, the most specific first."""
    own = (effect.sentences_by[key] for key in _actuated(target, machine) if key in effect.sentences_by)
    return (*(sentence for sentences in own for sentence in sentences), *effect.sentences)


def _actuated(target: str, machine: Machine | None) -> tuple[Actuation | Drive, ...]:
    """Actuation and drive of an axis; the drive of a machine."""
    if machine is not None and target in machine.axis_names:
        return machine.axis(target).actuation, machine.drive_of(target)
    if machine is not None and target == "machine":
        hydraulic = any(machine.drive_of(name) == "hydraulic" for name in machine.axis_names)
        return ("hydraulic" if hydraulic else "unknown",)
    return ()
