"""Units that nobody stated: of the signals of an axis, from the machine, and of time, from the rates of logs beside the
machine's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sysid.datasets.channels import ReadRecording
from sysid.datasets.discover import RecordingFiles
from sysid.logs import reader_for
from sysid.logs.time_unit import NEAR, SECONDS
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


#: Rate of commands over that of the grid from which a note says so: about twice.
FASTER = 1.9


def rate_notes(found: Sequence[RecordingFiles], readings: Mapping[str, ReadRecording], rate_hz: float) -> tuple[str, ...]:
    """A note for each table without ``time_unit``, read in seconds, whose rate fits the machine's in another unit only.

    Args:
        found: the recordings with their files.
        readings: recording → what was read.
        rate_hz: rate of the machine [Hz].
    """
    notes = []
    for files in found:
        rates: dict[str, float] = {}
        for channel in readings[files.name].channels:
            if channel.period_s > 0.0:
                rates.setdefault(channel.source, 1.0 / channel.period_s)
        for path, mapping in files.streams:
            stated = mapping is not None and (mapping.time_unit is not None or mapping.rate_hz is not None)
            rate = rates.get(path.name)
            if stated or rate is None or 1.0 / (2.0 * NEAR) <= rate / rate_hz <= 2.0 * NEAR:
                continue
            if (mapping is not None and mapping.reader not in (None, "csv")) or reader_for(path).clocks != ("time",):
                continue
            likely = [unit for unit, factor in SECONDS.items() if 1.0 / NEAR <= rate / factor / rate_hz <= NEAR]
            notes += [
                f"{files.name}/{path.name}: {rate:.4g} samples a second, machine.toml states {rate_hz:g} Hz. Are the stamps in "
                f"{unit}? Then state `time_unit` in the recipe"
                for unit in likely[:1]
            ]
    return tuple(notes)


def command_notes(readings: Mapping[str, ReadRecording], rate_hz: float) -> tuple[str, ...]:
    """A note for each log file whose commands come faster than the grid has rows: those between two rows act later.

    Args:
        readings: recording → what was read.
        rate_hz: rate of the machine [Hz].
    """
    rates: dict[str, list[float]] = {}
    for reading in readings.values():
        for source, period in {c.source: c.period_s for c in reading.channels if c.signal.endswith(".command")}.items():
            if period > 0.0 and 1.0 / period > FASTER * rate_hz:
                rates.setdefault(source, []).append(1.0 / period)
    return tuple(
        f"{source}: commands at {max(found):.4g} Hz{f' in {len(found)} recordings' if len(found) > 1 else ''}, the grid has "
        f"{rate_hz:g} Hz: a command between two rows acts up to {1e3 / rate_hz:.3g} ms later. "
        f"State rate_hz = {max(found):.4g} in machine.toml"
        for source, found in rates.items()
    )
