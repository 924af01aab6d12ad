"""Does a dataset contain what an effect needs to be seen? Counted before anything is fitted, so that silence is explained.

An axis that does not move shows no effect at all, whatever else is counted: from one posture a bias, a scale and an offset are
the same, and a sensor that reads one value reads in no steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.quality import noise_of, use
from sysid.datasets.quality.noise import is_still
from sysid.datasets.quality.use import level_of
from sysid.datasets.recording import Recording
from sysid.effects import Effect, effect_named
from sysid.gap.candidates import Candidate
from sysid.gap.result import Excitation
from sysid.machine import Machine
from sysid.plant import gravity_load
from sysid.signals import axis_signal, point_signals, split_signal

Array = npt.NDArray[np.float64]
Count = Callable[[Sequence[Recording], Machine, str], float]


#: An axis moved where it covers this share of its limits [%] and this many standard deviations of its sensor's noise; of a
#: recording of motion the outermost readings do not count (a share on either side).
OF_LIMITS, OF_NOISE, OUTERMOST = 0.1, 20.0, 0.005
#: Over so many times that share it moved, whatever is estimated of its noise: a fast motion at a low rate looks like noise.
CLEARLY = 20.0
#: Units of what an axis that did not move lacks.
STILL = ("% of its range", "times its noise")


def excitation_of(candidate: Candidate, recordings: Sequence[Recording], machine: Machine) -> Excitation:
    """What the recordings have of what the candidate needs."""
    return excitation_at(candidate.effect, candidate.target, recordings, machine)


def excitation_at(effect: Effect, target: str, recordings: Sequence[Recording], machine: Machine) -> Excitation:
    """What the recordings have of what an effect needs at a target; on an axis that did not move, how far it moved."""
    axis = axis_of(target, machine)
    travel = _travel(recordings, machine, axis) if axis is not None else None
    if travel is not None and travel.short is not None:
        return Excitation(effect.name, target, False, *travel.short)
    need = effect.need
    count, unit = COUNTS[need.count]
    have = count(recordings, machine, target)
    return Excitation(effect.name, target, have >= need.least, float(have), float(need.least), unit)


def moved(recordings: Sequence[Recording], machine: Machine, axis: str) -> bool:
    """Whether an axis moved in the recordings: clear of its sensor's noise and steps, and over some share of its limits.

    Its joint counts, else what is driven; all recordings together, since static poses and rests at several places are postures
    of their own. An axis that nothing measures did not move.
    """
    travel = _travel(recordings, machine, axis)
    return travel is not None and travel.short is None


def identifiable_targets(targets: Sequence[str], recordings: Sequence[Recording], machine: Machine) -> tuple[str, ...]:
    """Those of some targets on which the recordings can show an effect, in the same order.

    An axis, or a signal of one, where the axis moved; the machine where two axes did, since what they share shows in both; all
    others (base, tool, boom tip, streams) where any axis did.
    """
    shown = {axis for axis in machine.axis_names if moved(recordings, machine, axis)}

    def identifiable(target: str) -> bool:
        axis = axis_of(target, machine)
        return axis in shown if axis is not None else len(shown) >= (2 if target == "machine" else 1)

    return tuple(target for target in targets if identifiable(target))


def axis_of(target: str, machine: Machine) -> str | None:
    """The axis that a target is, or whose signal it is; None for all others."""
    owner = target if target in machine.axis_names else split_signal(target)[0]
    return owner if owner in machine.axis_names else None


@dataclass(frozen=True)
class _Travel:
    """How far an axis went.

    Args:
        span: between its outermost readings [SI]; ``limits``: between its limits, zero where the description gives none.
        noise: standard deviation of its sensor, steps included.
    """

    span: float
    limits: float
    noise: float

    @property
    def short(self) -> tuple[float, float, str] | None:
        """What there is, what is needed, and in which unit, where the axis did not move."""
        share = 100.0 * self.span / self.limits if self.limits > 0.0 else OF_LIMITS
        if share < OF_LIMITS:
            return share, OF_LIMITS, STILL[0]
        times = self.span / self.noise if self.noise > 0.0 else np.inf
        return (float(times), OF_NOISE, STILL[1]) if times < OF_NOISE or self.span == 0.0 else None


def _travel(recordings: Sequence[Recording], machine: Machine, axis: str) -> _Travel | None:
    """Of the joint, else of what is driven; None where neither is measured."""
    about = machine.axis(axis)
    for signal in dict.fromkeys((axis_signal(axis, "joint"), about.driven)):
        known = [(r, values) for r in recordings if len(values := r.values(signal)[~np.isnan(r.values(signal))])]
        if not known:
            continue
        ends = [np.quantile(v, (OUTERMOST, 1.0 - OUTERMOST)) if r.kind == "motion" else (v.min(), v.max()) for r, v in known]
        span = float(max(high for _, high in ends) - min(low for low, _ in ends))
        limits = about.range if signal == about.driven else about.limits
        reach = float(limits[1] - limits[0]) if limits is not None and np.isfinite(limits).all() else 0.0
        # Rounding of floating-point numbers is no motion.
        span = 0.0 if is_still(np.array([v for pair in ends for v in pair])) else span
        noise = machine.noise.get(signal, 0.0)
        if noise == 0.0 and (reach == 0.0 or 100.0 * span < CLEARLY * OF_LIMITS * reach):
            levels = [noise_of(r.values(signal), r.rate_hz) for r, _ in known if r.kind == "motion"]
            noise = float(np.median(told)) if (told := [level for level in levels if np.isfinite(level)]) else 0.0
        return _Travel(span, reach, noise)
    return None


def advice(item: Excitation) -> str:
    """What to record so that the effect can be seen; the same for all effects of an axis that did not move."""
    if item.unit in STILL:
        axis = split_signal(item.target)[0] or item.target
        return (
            f"{axis} did not move ({item.have:.2g} {item.unit}, at least {item.need:g} needed): no effect on it or on its "
            f"sensors can be told. Record {axis} moving over its range in both directions."
        )
    return f"{item.name} on {item.target}: {_have(item)}. {_wanted(item.name, item.target)}"


def advice_on_tie(tie: Sequence[tuple[str, str]]) -> str:
    """What to record so that effects that fit equally well come apart: what shows the first, and what shows each rival."""
    names = " or ".join(f"{name} on {target}" for name, target in tie)
    wanted = dict.fromkeys(_wanted(name, target) for name, target in tie)
    return f"{names} cannot be distinguished. {' '.join(wanted)}"


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
