"""Does a dataset contain what an effect needs to be seen? Counted before anything is fitted, so that silence is explained."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.candidates import Candidate
from sysid.gap.result import Excitation
from sysid.machine import Machine
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]
Count = Callable[[Sequence[Recording], Machine, str], float]


def excitation_of(candidate: Candidate, recordings: Sequence[Recording], machine: Machine) -> Excitation:
    """What the recordings have of what the candidate needs."""
    count, need, unit = _NEEDS[candidate.effect.name]
    have = count(recordings, machine, candidate.target)
    return Excitation(candidate.effect.name, candidate.target, have >= need, float(have), float(need), unit)


def advice(item: Excitation) -> str:
    """What to record so that the effect can be seen."""
    return f"{item.name} on {item.target}: {_have(item)}. {_ADVICE[item.name].format(axis=item.target)}"


def advice_on_tie(tie: Sequence[tuple[str, str]]) -> str:
    """What to record so that effects that fit equally well come apart: what shows the first, and what shows each rival."""
    names = " or ".join(f"{name} on {target}" for name, target in tie)
    wanted = dict.fromkeys(_ADVICE[name].format(axis=target) for name, target in tie)
    return f"{names} cannot be told apart. {' '.join(wanted)}"


def _have(item: Excitation) -> str:
    return f"{item.have:.0f} {item.unit}, about {item.need:.0f} needed"


def reversals(recordings: Sequence[Recording], machine: Machine, axis: str) -> float:
    """Changes of direction of the joint (of what is driven, where no joint is measured), beyond a hundredth of its travel."""
    total = 0
    for recording in recordings:
        for signal in (axis_signal(axis, "joint"), machine.axis(axis).driven):
            values = recording.values(signal)
            values = values[~np.isnan(values)]
            if len(values):
                total += turning_points(values, 0.01 * float(np.ptp(values)))
                break
    return total


def turning_points(values: Array, least: float) -> int:
    """Reversals of a signal by more than ``least`` (so that noise does not count)."""
    if least <= 0.0:
        return 0
    count, direction, extreme = 0, 0, values[0]
    for value in values[1:]:
        if (direction >= 0 and value > extreme) or (direction <= 0 and value < extreme):
            if direction == 0 and abs(value - extreme) > least:
                direction = 1 if value > extreme else -1
                extreme = value
            elif direction != 0:
                extreme = value
        elif abs(value - extreme) > least:
            count += 1
            direction = 1 if value > extreme else -1
            extreme = value
    return count


def command_changes(recordings: Sequence[Recording], machine: Machine, axis: str) -> float:
    """Starts, stops and reversals of the command."""
    return sum(int(np.sum(np.diff(np.sign(_level(r, axis))) != 0)) for r in recordings)


def small_commands(recordings: Sequence[Recording], machine: Machine, axis: str) -> float:
    """Seconds with a command between 2 % and 40 % of full, on the side that has less of it."""
    sides = [0.0, 0.0]
    for recording in recordings:
        u = recording.values(axis_signal(axis, "command"))
        sides[0] += float(np.sum((u > 0.02) & (u < 0.4))) / recording.rate_hz
        sides[1] += float(np.sum((u < -0.02) & (u > -0.4))) / recording.rate_hz
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
    """The command as −1, 0, +1, with what is below a fiftieth of its largest value as 0."""
    u = np.nan_to_num(recording.values(axis_signal(axis, "command")))
    return np.where(np.abs(u) > 0.02 * max(float(np.max(np.abs(u), initial=0.0)), 1e-12), np.sign(u), 0.0)


_NEEDS: dict[str, tuple[Count, float, str]] = {
    "input_delay": (command_changes, 10, "command changes"),
    "first_order_lag": (command_changes, 10, "command changes"),
    "valve_deadband": (small_commands, 2, "s of small commands on each side"),
    "valve_hysteresis": (command_changes, 10, "command changes"),
    "gain_curve": (small_commands, 2, "s of small commands on each side"),
    "flow_saturation": (motion, 5, "s of motion"),
    "command_rate_limit": (command_changes, 10, "command changes"),
    "internal_leakage": (rest, 10, "s at rest"),
    "stiction": (command_changes, 10, "command changes"),
    "gain_error": (motion, 5, "s of motion"),
    "asymmetric_gain": (motion_both_ways, 3, "s of motion in each direction"),
    "coulomb_friction": (motion_both_ways, 1, "s of force in each direction"),
    "viscous_friction": (motion_both_ways, 1, "s of force in each direction"),
    "inertia_error": (command_changes, 6, "force changes"),
    "load_bias": (motion_both_ways, 1, "s of force in each direction"),
    "backlash": (reversals, 8, "reversals"),
    "joint_offset": (joint_coverage, 10, "% of the joint range"),
    "link_length_error": (joint_coverage, 10, "% of the joint range"),
    "base_misalignment": (joint_coverage, 10, "% of every joint's range"),
    "gripper_sway": (tip_stops, 5, "s of boom tip motion"),
}

_ADVICE: dict[str, str] = {
    "input_delay": "Record 20 sharp starts and stops of {axis}.",
    "first_order_lag": "Record 20 sharp starts and stops of {axis}.",
    "valve_deadband": "Record {axis} with slow commands from 0 to 30 % and back on both sides, 30 s.",
    "valve_hysteresis": "Record 20 slow reversals of the command of {axis} around three openings.",
    "gain_curve": "Record {axis} at 10, 20, 40, 70 and 100 % in both directions, 5 s each.",
    "flow_saturation": "Record {axis} alone at 60, 80 and 100 %, 5 s each.",
    "command_rate_limit": "Record 10 sudden full commands of {axis}.",
    "internal_leakage": "Leave {axis} at rest under load for 60 s.",
    "stiction": "Record 20 slow starts from rest and slow stops of {axis} on both sides.",
    "gain_error": "Record {axis} moving over half of its range, 20 s.",
    "asymmetric_gain": "Record {axis} at 30, 60 and 100 % in both directions, 5 s each.",
    "coulomb_friction": "Record {axis} moving slowly in both directions, with several stops, 20 s.",
    "viscous_friction": "Record {axis} at three speeds in both directions, 20 s.",
    "inertia_error": "Record {axis} with quick starts and stops, 20 s.",
    "load_bias": "Record {axis} moving evenly in both directions, 20 s.",
    "backlash": "Record 20 slow reversals of {axis}, with at least 5 % of its range between them.",
    "joint_offset": "Record poses over the whole range of {axis}.",
    "link_length_error": "Record poses over the whole range of {axis}.",
    "base_misalignment": "Record poses over the whole work space.",
    "gripper_sway": "Move the boom tip briskly, stop, and let the tool swing for 5 s; ten times.",
}
