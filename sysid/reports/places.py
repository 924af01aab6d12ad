"""Location of effects on the machine: valve, cylinder, joint, link, sensor, tool …"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from sysid.effects import BY_NAME
from sysid.gap.result import GapResult, StageGap
from sysid.machine import Axis, Machine
from sysid.reports import words
from sysid.signals import split_signal

#: Stage → part at its end, for unnamed errors.
_OF_STAGE = {
    "command": "valve",
    "force": "cylinder",
    "joint": "joint",
    "end_effector": "link",
    "tool": "tool",
    "free_run": "sensor",
}


@dataclass(frozen=True)
class Mark:
    """A numbered place on the drawing.

    Args:
        number: shown in the mark and beside the text about it.
        part: ``valve``, ``cylinder``, ``joint``, ``link``, ``sensor``, ``tool``, ``base``, ``pump`` or ``clock``.
        target: axis, signal or stream that the part belongs to.
        sure: False for open hypotheses, which are drawn hollow.
    """

    number: int
    part: str
    target: str
    sure: bool = True


def part_of(effect: str, target: str, machine: Machine, parameters: Collection[str] = ()) -> str:
    """The part of the machine that has an effect; without hydraulics a drive instead of valve and cylinder.

    Args:
        parameters: names of its parameters, since forms of an effect may have different places.
    """
    part: str = BY_NAME[effect].part_of(frozenset(parameters)) if effect in BY_NAME else "valve"
    if part in ("valve", "cylinder") and target in machine.axis_names:
        axis = machine.axis(target)
        if not has_valve(axis, machine) or (part == "cylinder" and axis.drives == "joint"):
            return "drive"
    return part


def has_valve(axis: Axis, machine: Machine) -> bool:
    """Whether the command of an axis moves a hydraulic valve."""
    return axis.actuation == "velocity" and machine.drive_of(axis.name) == "hydraulic"


def place_text(part: str, target: str) -> str:
    """``valve of the boom``; parts that exist once have no owner."""
    if part == "sensor":
        return f"sensor {words.signal_name(target)}"
    if part == "clock":
        return f"clock of {target}"
    if part in ("tool", "base", "pump"):
        return part
    if part == "link" and target == "ee":
        return "links up to the tip"
    return f"{part} of the {words.owner_name(target)}"


def marks_of(gap: GapResult, machine: Machine) -> tuple[Mark, ...]:
    """Marks of the effects, then of ambiguous sets (one number per set), then of unnamed errors."""
    marks = [Mark(k, part_of(e.name, e.target, machine, e.parameters), e.target) for k, e in enumerate(gap.effects, 1)]
    number = len(marks)
    for tie in gap.ambiguous:
        number += 1
        places = dict.fromkeys((part_of(name, target, machine), target) for name, target in tie)
        marks += [Mark(number, part, target, sure=False) for part, target in places]
    for item in gap.unnamed:
        number += 1
        marks.append(Mark(number, _of_stage(item.stage, item.target, machine), item.target, sure=False))
    return tuple(marks)


def stage_marks(found: Sequence[StageGap], machine: Machine) -> tuple[Mark, ...]:
    """A hollow mark for each stage with an error, in their order."""
    return tuple(Mark(k, _of_stage(i.stage, i.target, machine), i.target, sure=False) for k, i in enumerate(found, 1))


def _of_stage(stage: str, target: str, machine: Machine) -> str:
    part = _OF_STAGE.get(stage, "valve")
    if part in ("valve", "cylinder") and target in machine.axis_names and not has_valve(machine.axis(target), machine):
        return "drive"
    return part


def axis_of(mark: Mark, names: Sequence[str]) -> str | None:
    """The axis that a mark belongs to; of ``boom.joint`` it is the boom."""
    owner = mark.target if mark.target in names else split_signal(mark.target)[0]
    return owner if owner in names else None
