"""Does a dataset contain what an effect needs to be seen? Counted before anything is fitted, so that silence is explained."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from sysid.datasets.quality import use
from sysid.datasets.quality.use import level_of
from sysid.datasets.recording import Recording
from sysid.effects import effect_named
from sysid.gap.candidates import Candidate
from sysid.gap.result import Excitation
from sysid.machine import Machine
from sysid.plant import gravity_load
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]
Count = Callable[[Sequence[Recording], Machine, str], float]


def excitation_of(candidate: Candidate, recordings: Sequence[Recording], machine: Machine) -> Excitation:
    """What the recordings have of what the candidate needs."""
    need = candidate.effect.need
    count, unit = COUNTS[need.count]
    have = count(recordings, machine, candidate.target)
    return Excitation(candidate.effect.name, candidate.target, have >= need.least, float(have), float(need.least), unit)


def advice(item: Excitation) -> str:
    """What to record so that the effect can be seen."""
    return f"{item.name} on {item.target}: {_have(item)}. {_wanted(item.name, item.target)}"


def advice_on_tie(tie: Sequence[tuple[str, str]]) -> str:
    """What to record so that effects that fit equally well come apart: what shows the first, and what shows each rival."""
    names = " or ".join(f"{name} on {target}" for name, target in tie)
    wanted = dict.fromkeys(_wanted(name, target) for name, target in tie)
    return f"{names} cannot be told apart. {' '.join(wanted)}"


def _wanted(name: str, target: str) -> str:
    return effect_named(name).need.advice.format(axis=target)


def _have(item: Excitation) -> str:
    return f"{item.have:.0f} {item.unit}, about {item.need:.0f} needed"


def reversals(recordings: Sequence[Recording], machine: Machine, axis: str) -> float:
    """Changes of direction of the joint (of what is driven, where no joint is measured), beyond travel and noise."""
    total = 0
    for recording in recordings:
        for signal in (axis_signal(axis, "joint"), machine.axis(axis).driven):
            values = recording.values(signal)
            values = values[~np.isnan(values)]
            if len(values):
                total += use.reversals(values, recording.rate_hz if recording.kind == "motion" else None)
                break
    return total


def command_changes(recordings: Sequence[Recording], machine: Machine, axis: str) -> float:
    """Starts, stops and reversals of the command, or its turning points where it never comes to rest."""
    return sum(use.command_changes(r.values(axis_signal(axis, "command"))) for r in recordings)


def small_commands(recordings: Sequence[Recording], machine: Machine, axis: str) -> float:
    """Seconds with a small command (between 2 % and 40 % of full), on the side that has less of it."""
    low, high = use.SMALL
    sides = [0.0, 0.0]
    for recording in recordings:
        u = recording.values(axis_signal(axis, "command"))
        sides[0] += float(np.sum((u > low) & (u < high))) / recording.rate_hz
        sides[1] += float(np.sum((u < -low) & (u > -high))) / recording.rate_hz
    return min(sides)


def motion_both_ways(recordings: Sequence[Recording], machine: Machine, axis: str) -> float:
    """Seconds of command on the side that has less of it."""
    sides = [0.0, 0.0]
    for recording in recordings:
        level = _level(recording, axis)
        sides[0] += float(np.sum(level > 0)) / recording.rate_hz
        sides[1] += float(np.sum(level < 0)) / recording.rate_hz
    return min(sides)


def motion(recordings: Sequence[Recording], machine: Machine, axis: str) -> float:
    """Seconds of command in either direction."""
    return sum(float(np.sum(_level(r, axis) != 0)) / r.rate_hz for r in recordings)


def longest_motion(recordings: Sequence[Recording], machine: Machine, axis: str) -> float:
    """Seconds of command in the recording that has most of it."""
    return max((motion((r,), machine, axis) for r in recordings), default=0.0)


def any_motion(recordings: Sequence[Recording], machine: Machine, target: str) -> float:
    """Seconds in which any axis is commanded."""
    return sum(_moving(r, machine) for r in recordings)


def longest_any_motion(recordings: Sequence[Recording], machine: Machine, target: str) -> float:
    """Seconds in which any axis is commanded, in the recording that has most of it."""
    return max((_moving(r, machine) for r in recordings), default=0.0)


def together(recordings: Sequence[Recording], machine: Machine, target: str) -> float:
    """Seconds in which at least two axes are commanded beyond a third of their largest command."""
    total = 0.0
    for recording in recordings:
        levels = [np.abs(np.nan_to_num(recording.values(axis_signal(a.name, "command")))) for a in machine.axes]
        high = [level > 0.33 * max(float(np.max(level, initial=0.0)), 1e-12) for level in levels]
        total += float(np.sum(np.sum(high, axis=0) >= 2)) / recording.rate_hz
    return total


def load_change(recordings: Sequence[Recording], machine: Machine, axis: str) -> float:
    """How far the gravity load of the axis changes, 5th to 95th percentile, in percent of its largest."""
    i = machine.axis_names.index(axis)
    values = np.concatenate([gravity_load(machine, r)[:, i] for r in recordings])
    values = values[~np.isnan(values)]
    largest = float(np.max(np.abs(values), initial=0.0))
    if largest == 0.0:
        return 0.0
    low, high = np.percentile(values, (5.0, 95.0))
    return 100.0 * float(high - low) / largest


def signal_travel(recordings: Sequence[Recording], machine: Machine, signal: str) -> float:
    """Seconds in which the signal is measured and its machine moves."""
    total = 0.0
    for recording in recordings:
        there = ~np.isnan(recording.values(signal))
        moving = np.any([_level(recording, a.name) != 0 for a in machine.axes], axis=0)
        total += float(np.sum(there & moving)) / recording.rate_hz
    return total


def _moving(recording: Recording, machine: Machine) -> float:
    return float(np.sum(np.any([_level(recording, a.name) != 0 for a in machine.axes], axis=0))) / recording.rate_hz


def rest(recordings: Sequence[Recording], machine: Machine, axis: str) -> float:
    """Seconds with the command at zero."""
    return sum(float(np.sum(_level(r, axis) == 0)) / r.rate_hz for r in recordings)


def joint_coverage(recordings: Sequence[Recording], machine: Machine, axis: str) -> float:
    """Share of the joint's range that was visited [%]; for the base, of the axis that visited least."""
    axes = machine.axis_names if axis == "base" else (axis,)
    shares = []
    for name in axes:
        values = np.concatenate([r.values(axis_signal(name, "joint")) for r in recordings])
        values = values[~np.isnan(values)]
        limits = machine.axis(name).limits
        span = limits[1] - limits[0] if limits is not None and np.isfinite(limits).all() else 1.0
        shares.append(100.0 * float(np.ptp(values)) / span if len(values) else 0.0)
    return min(shares)


def tip_stops(recordings: Sequence[Recording], machine: Machine, axis: str) -> float:
    """Seconds in which the boom tip moves."""
    total = 0.0
    for recording in recordings:
        ee = np.column_stack([recording.values(s) for s in point_signals("ee")])
        stride = max(1, round(0.2 * recording.rate_hz))
        speed = np.linalg.norm(ee[stride:] - ee[:-stride], axis=1) / 0.2
        total += float(np.sum(speed > 0.02)) / recording.rate_hz
    return total


def _level(recording: Recording, axis: str) -> Array:
    """The command as −1, 0, +1."""
    return level_of(recording.values(axis_signal(axis, "command")))


#: What an effect may need (:class:`sysid.effects.Need`): how it is counted, and in what.
COUNTS: dict[str, tuple[Count, str]] = {
    "command_changes": (command_changes, "command changes"),
    "force_changes": (command_changes, "force changes"),
    "small_commands": (small_commands, "s of small commands on each side"),
    "motion": (motion, "s of motion"),
    "longest_motion": (longest_motion, "s of motion in one recording"),
    "any_motion": (any_motion, "s of motion of any axis"),
    "longest_any_motion": (longest_any_motion, "s of motion of any axis in one recording"),
    "motion_both_ways": (motion_both_ways, "s of motion in each direction"),
    "force_both_ways": (motion_both_ways, "s of force in each direction"),
    "together": (together, "s of two axes at large commands"),
    "rest": (rest, "s at rest"),
    "reversals": (reversals, "reversals"),
    "load_change": (load_change, "% change of the gravity load"),
    "joint_coverage": (joint_coverage, "% of the joint range"),
    "signal_travel": (signal_travel, "s of motion while it is measured"),
    "tip_stops": (tip_stops, "s of boom tip motion"),
}
