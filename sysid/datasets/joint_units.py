"""Units of the signals of an axis for which logs, recipe and machine description state none."""

from __future__ import annotations

from collections.abc import Mapping

from sysid.machine import Axis, Machine
from sysid.signals import axis_signal

#: Units of signals of a prismatic and of a revolute joint.
_PRISMATIC, _REVOLUTE = frozenset({"m", "m/s", "N"}), frozenset({"rad", "rad/s", "N·m"})


def with_joint_units(units: Mapping[str, str], machine: Machine) -> tuple[dict[str, str], tuple[str, ...]]:
    """Units with those of the joints filled in, and a note on axes that nothing describes.

    An axis has one kind of joint: the unit of one of its signals determines the others. An axis without any is revolute.

    Args:
        units: signal → SI unit; ``1`` for a signal that has none.
    """
    found, assumed = dict(units), []
    for axis in machine.axes:
        open_ = [signal for signal in _of_joint(axis) if found.get(signal) == "1" and machine.expected_unit(signal) is None]
        if not open_:
            continue
        stated = {found[signal] for signal in _of_joint(axis) if signal in found}
        joint = "m" if stated & _PRISMATIC else "rad"
        found |= {signal: _unit(axis, signal, joint) for signal in open_}
        if not stated & (_PRISMATIC | _REVOLUTE):
            assumed.append(axis.name)
    if not assumed:
        return found, ()
    one = len(assumed) == 1
    return found, (
        f"{', '.join(assumed)}: neither logs nor machine.toml state a unit, so the joint{'' if one else 's'} "
        f'{"is" if one else "are"} taken as revolute [rad]. A prismatic axis needs joint_type = "prismatic" in machine.toml.',
    )


def _of_joint(axis: Axis) -> tuple[str, ...]:
    """The signals of an axis whose unit depends on the kind of its joint."""
    if axis.drives == "cylinder":
        return (axis_signal(axis.name, "joint"),)
    names = ("joint", "speed") if axis.actuation == "velocity" else ("joint", "speed", "command")
    return tuple(axis_signal(axis.name, name) for name in names)


def _unit(axis: Axis, signal: str, joint: str) -> str:
    if signal.endswith(".speed"):
        return f"{joint}/s"
    if signal.endswith(".command") and axis.actuation == "force":
        return "N" if joint == "m" else "N·m"
    return joint
