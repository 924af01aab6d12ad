"""Whether recordings excite an effect, counted before any fit.

An axis that does not move excites no effect, whatever else is counted: at one posture a bias, a scale and an offset are the
same, and a sensor shows no steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.chunked import Mask, Parts, Values, counted, ends, known, measured, quantiles, remembered
from sysid.datasets.quality import use
from sysid.datasets.quality.noise import is_still, noise_of
from sysid.datasets.recording import Recording
from sysid.effects import Effect, effect_named
from sysid.effects.wording import title_of
from sysid.gap.candidates import Candidate
from sysid.gap.result import Excitation
from sysid.machine import Machine
from sysid.plant import gravity_load
from sysid.plant.smooth_motion import smooth_motion
from sysid.signals import axis_signal, point_signals, split_signal

Array = npt.NDArray[np.float64]
#: (recordings, machine, target) → count.
Count = Callable[[Sequence[Recording], Machine, str], float]
#: (recording, machine, target) → (first, last + 1) → which of these rows count.
Condition = Callable[[Recording, Machine, str], Callable[[int, int], Mask]]

#: An axis moved if it covered this share of its limits [%] and this multiple of its sensor noise (standard deviation); in a
#: recording of motion this share of the outermost readings on either side does not count.
OF_LIMITS, OF_NOISE, OUTERMOST = 0.1, 20.0, 0.005
#: At this multiple of that share it moved whatever the noise estimate: fast motion at a low rate looks like noise.
CERTAIN_MOTION = 20.0
#: Share of the 95th percentile of the speed below which an axis does not count as moving in a direction.
SLOW = 0.05
#: Share of the range of a joint that static poses have to cover for the scale or bias of its sensor [%].
OF_RANGE = 10.0
#: Units of the travel of an axis that did not move.
TRAVEL_UNITS = ("% of its range", "times its noise")


def excitation_of(candidate: Candidate, recordings: Sequence[Recording], machine: Machine) -> Excitation:
    """Excitation of a candidate by the recordings."""
    return excitation_at(candidate.effect, candidate.target, recordings, machine)


def excitation_at(effect: Effect, target: str, recordings: Sequence[Recording], machine: Machine) -> Excitation:
    """Excitation of an effect at a target; for an axis that did not move, its travel."""
    axis = axis_of(target, machine)
    travel = _travel(recordings, machine, axis) if axis is not None else None
    if travel is not None and travel.short is not None:
        return Excitation(effect.name, target, False, *travel.short)
    need, place, least = effect.need.count, target, float(effect.need.least)
    if need == "signal_travel" and axis is not None and all(r.kind == "poses" for r in recordings):
        need, place, least = "joint_coverage", axis, OF_RANGE  # of a sensor that is read at rest
    count, unit = COUNTS[need]
    have = float(count(recordings, machine, place))
    return Excitation(effect.name, target, have >= least, have, least, unit)


def moved(recordings: Sequence[Recording], machine: Machine, axis: str) -> bool:
    """Whether an axis moved in the recordings beyond the noise and steps of its sensor and over some share of its limits.

    Its joint counts, else the driven signal; over all recordings together, so that static poses at several places count. An
    axis that is not measured did not move.
    """
    travel = _travel(recordings, machine, axis)
    return travel is not None and travel.short is None


def identifiable_targets(targets: Sequence[str], recordings: Sequence[Recording], machine: Machine) -> tuple[str, ...]:
    """The targets at which the recordings can excite an effect, in the same order.

    An axis, or a signal of one, if the axis moved; the machine if two axes moved; all others (base, tool, boom tip, streams)
    if any axis moved.
    """
    shown = {axis for axis in machine.axis_names if moved(recordings, machine, axis)}

    def identifiable(target: str) -> bool:
        axis = axis_of(target, machine)
        return axis in shown if axis is not None else len(shown) >= (2 if target == "machine" else 1)

    return tuple(target for target in targets if identifiable(target))


def axis_of(target: str, machine: Machine) -> str | None:
    """The axis of a target (an axis or one of its signals); None for all others."""
    owner = target if target in machine.axis_names else split_signal(target)[0]
    return owner if owner in machine.axis_names else None


def measured_signals(recordings: Sequence[Recording]) -> frozenset[str]:
    """Signals with a value in any of the recordings."""
    return frozenset(s for r in recordings for s in r.signals if measured(r.values(s)))


@dataclass(frozen=True)
class _Travel:
    """Travel of an axis.

    Args:
        span: between its outermost readings [SI]; ``limits``: between its limits, zero if unknown.
        noise: standard deviation of its sensor, steps included.
    """

    span: float
    limits: float
    noise: float

    @property
    def short(self) -> tuple[float, float, str] | None:
        """(have, need, unit) of an axis that did not move; else None."""
        share = 100.0 * self.span / self.limits if self.limits > 0.0 else OF_LIMITS
        if share < OF_LIMITS:
            return share, OF_LIMITS, TRAVEL_UNITS[0]
        times = self.span / self.noise if self.noise > 0.0 else np.inf
        return (float(times), OF_NOISE, TRAVEL_UNITS[1]) if times < OF_NOISE or self.span == 0.0 else None


def _travel(recordings: Sequence[Recording], machine: Machine, axis: str) -> _Travel | None:
    """Travel of the joint, else of the driven signal; None where neither is measured."""
    about = machine.axis(axis)
    for signal in dict.fromkeys((axis_signal(axis, "joint"), about.driven)):
        there = [(r, r.values(signal)) for r in recordings if measured(r.values(signal))]
        if not there:
            continue
        outermost = [_ends(values, OUTERMOST if r.kind == "motion" else 0.0) for r, values in there]
        span = float(max(high for _, high in outermost) - min(low for low, _ in outermost))
        limits = about.range if signal == about.driven else about.limits
        reach = float(limits[1] - limits[0]) if limits is not None and np.isfinite(limits).all() else 0.0
        span = 0.0 if is_still(np.array(outermost).ravel()) else span
        noise = machine.noise.get(signal, 0.0)
        if noise == 0.0 and (reach == 0.0 or 100.0 * span < CERTAIN_MOTION * OF_LIMITS * reach):
            levels = [noise_of(values, r.rate_hz) for r, values in there if r.kind == "motion"]
            finite = [level for level in levels if np.isfinite(level)]
            noise = float(np.median(finite)) if finite else 0.0
        return _Travel(span, reach, noise)
    return None


@remembered
def _ends(values: Array, share: float) -> tuple[float, float]:
    """The values below and above which a share of a signal (n,) lies."""
    low, high = quantiles([(len(values), lambda first, last: known(values[first:last]))], (share, 1.0 - share))
    return low, high


def advice(item: Excitation, machine: Machine) -> str:
    """The recording that would excite the effect; the same for all effects of an axis that did not move."""
    if item.unit in TRAVEL_UNITS:
        axis = split_signal(item.target)[0] or item.target
        return (
            f"{axis} did not move ({item.have:.2g} {item.unit}, at least {item.need:g} needed), so that no effect on it or on "
            f"its sensors is identifiable. Record {axis} moving over its range in both directions."
        )
    have = f"{item.have:.0f} {item.unit}, about {item.need:.0f} needed"
    return f"{_title(item.name, item.target, machine)}: {have}. {recording_for(item.name, item.target)}"


def advice_on_tie(tie: Sequence[tuple[str, str]], machine: Machine) -> str:
    """The recordings that would distinguish effects that fit equally well: those that excite each of them."""
    names = " or ".join(_title(name, target, machine) for name, target in tie)
    recordings = dict.fromkeys(recording_for(name, target) for name, target in tie)
    return f"{names} cannot be distinguished. {' '.join(recordings)}"


def _title(name: str, target: str, machine: Machine) -> str:
    """``Servo lag of pitch``: the title for actuation and drive of the axis."""
    return f"{title_of(effect_named(name), axis_of(target, machine) or target, machine)} of {target}"


def recording_for(name: str, target: str) -> str:
    """The recording that excites an effect at a target."""
    return effect_named(name).need.advice.format(axis=target)


# -- counts ---------------------------------------------------------------------------------------------------------------


def _reversals(recordings: Sequence[Recording], machine: Machine, axis: str) -> float:
    """Changes of direction of the joint (of the driven signal where no joint is measured), beyond travel and noise."""
    total = 0
    for recording in recordings:
        for signal in (axis_signal(axis, "joint"), machine.axis(axis).driven):
            values = recording.values(signal)
            if measured(values):
                total += use.reversals(values, recording.rate_hz if recording.kind == "motion" else None)
                break
    return total


def _command_changes(recordings: Sequence[Recording], machine: Machine, axis: str) -> float:
    """Starts, stops and reversals of the command, or its turning points where it never comes to rest."""
    return sum(use.command_changes(r.values(axis_signal(axis, "command"))) for r in recordings)


def _moved_both_ways(recordings: Sequence[Recording], machine: Machine, axis: str) -> float:
    """Seconds of motion in the direction with less of it: under a weight, a force keeps its sign where the motion turns."""
    signal = machine.axis(axis).driven
    moving = [r for r in recordings if r.kind == "motion" and counted(len(r), _has(r.values(signal))) >= 2]
    speeds = [smooth_motion(r.values(signal), r.rate_hz)[1] for r in moving]
    (high,) = quantiles([_part(np.abs(speed)) for speed in speeds] or [_part(np.zeros(1))], (0.95,))
    pairs = list(zip(moving, speeds, strict=True))
    return min(sum(float(np.sum(sign * speed > SLOW * high)) / r.rate_hz for r, speed in pairs) for sign in (1.0, -1.0))


def _load_change(recordings: Sequence[Recording], machine: Machine, axis: str) -> float:
    """Change of the gravity load of the axis, 5th to 95th percentile, in percent of its largest."""
    return _change([_part(load) for load in _loads(recordings, machine, axis)])


def _weight_change(recordings: Sequence[Recording], machine: Machine, axis: str) -> float:
    """Change of the magnitude of the gravity load of the axis, 5th to 95th percentile, in percent of its largest."""
    return _change([_part(np.abs(load)) for load in _loads(recordings, machine, axis)])


def _loads(recordings: Sequence[Recording], machine: Machine, axis: str) -> list[Array]:
    return [gravity_load(machine, r)[:, machine.axis_names.index(axis)] for r in recordings]


def _has(values: Array) -> Callable[[int, int], Mask]:
    return lambda first, last: ~np.isnan(values[first:last])


def _part(values: Array) -> tuple[int, Callable[[int, int], Array]]:
    """A signal (n,) for :func:`~sysid.datasets.chunked.quantiles`."""
    return len(values), lambda first, last: known(values[first:last])


def _change(parts: Parts) -> float:
    """5th to 95th percentile of values, in percent of the largest magnitude; zero where all are zero."""
    lowest, low, high, highest = quantiles(parts, (0.0, 0.05, 0.95, 1.0))
    largest = max(highest, -lowest)
    return 100.0 * (high - low) / largest if largest > 0.0 else 0.0


def _joint_coverage(recordings: Sequence[Recording], machine: Machine, axis: str) -> float:
    """Visited share of the joint's range [%]; for base and tip, the least over all axes."""
    axes = machine.axis_names if axis in ("base", "ee") else (axis,)
    shares = []
    for name in axes:
        visited = [ends(values) for values in (r.values(axis_signal(name, "joint")) for r in recordings) if measured(values)]
        limits = machine.axis(name).limits
        span = limits[1] - limits[0] if limits is not None and np.isfinite(limits).all() else 1.0
        travel = max(high for _, high in visited) - min(low for low, _ in visited) if visited else 0.0
        shares.append(100.0 * travel / span)
    return min(shares)


def _seconds(condition: Condition) -> Count:
    """Duration of the rows that meet a condition, over all recordings [s]."""
    return lambda recordings, machine, target: sum(
        counted(len(r), condition(r, machine, target)) / r.rate_hz for r in recordings
    )


def _longest(count: Count) -> Count:
    """The count in the recording with most of it."""
    return lambda recordings, machine, target: max((count((r,), machine, target) for r in recordings), default=0.0)


def _least(one: Count, other: Count) -> Count:
    """The smaller of two counts."""
    return lambda recordings, machine, target: min(one(recordings, machine, target), other(recordings, machine, target))


def _command(recording: Recording, axis: str) -> Array:
    return recording.values(axis_signal(axis, "command"))


def _level(recording: Recording, axis: str) -> use.Levels:
    """The command as −1, 0, +1."""
    return use.level_of(_command(recording, axis))


def _where(series: Callable[[Recording, str], Values], given: Callable[[Values], Mask]) -> Condition:
    """Whether a series of an axis is such."""

    def condition(recording: Recording, machine: Machine, axis: str) -> Callable[[int, int], Mask]:
        values = series(recording, axis)
        return lambda first, last: given(values[first:last])

    return condition


def _any_moves(recording: Recording, machine: Machine, target: str) -> Callable[[int, int], Mask]:
    """Whether any axis is commanded."""
    levels = [_level(recording, axis) for axis in machine.axis_names]
    return lambda first, last: np.asarray(np.any([level[first:last] != 0 for level in levels], axis=0))


def _measured_moves(recording: Recording, machine: Machine, signal: str) -> Callable[[int, int], Mask]:
    """Whether any axis is commanded while the signal is measured."""
    there, moves = _has(recording.values(signal)), _any_moves(recording, machine, signal)
    return lambda first, last: there(first, last) & moves(first, last)


def _two_at_large_commands(recording: Recording, machine: Machine, target: str) -> Callable[[int, int], Mask]:
    """Whether at least two axes are commanded beyond a third of their largest command."""
    commands = [_command(recording, axis) for axis in machine.axis_names]
    least = [0.33 * np.fmax(np.abs(ends(command)).max(), 1e-12) for command in commands]

    def rows(first: int, last: int) -> Mask:
        return np.asarray(sum(np.abs(u[first:last]) > low for u, low in zip(commands, least, strict=True)) >= 2)

    return rows


def _tip_moves(recording: Recording, machine: Machine, target: str) -> Callable[[int, int], Mask]:
    """Whether the boom tip moves by more than 0.02 m/s over 0.2 s."""
    ee, stride = [recording.values(s) for s in point_signals("ee")], max(1, round(0.2 * recording.rate_hz))

    def rows(first: int, last: int) -> Mask:
        last = max(min(last, len(recording) - stride), first)
        steps = np.column_stack([values[first + stride : last + stride] - values[first:last] for values in ee])
        return np.asarray(np.linalg.norm(steps, axis=1) / 0.2 > 0.02)

    return rows


_MOTION: Count = _seconds(_where(_level, lambda level: level != 0))
_FORWARD: Count = _seconds(_where(_level, lambda level: level > 0))
_BACKWARD: Count = _seconds(_where(_level, lambda level: level < 0))
_REST: Count = _seconds(_where(_level, lambda level: level == 0))
#: Whether the command on one side is between 2 % and 40 % of full.
_SMALL_FORWARD: Count = _seconds(_where(_command, lambda u: (u > use.SMALL[0]) & (u < use.SMALL[1])))
_SMALL_BACKWARD: Count = _seconds(_where(_command, lambda u: (-u > use.SMALL[0]) & (-u < use.SMALL[1])))
_ANY_MOTION: Count = _seconds(_any_moves)
_MEASURED_MOTION: Count = _seconds(_measured_moves)

#: Counts that an effect may need (:class:`sysid.effects.Need`): function and unit.
COUNTS: dict[str, tuple[Count, str]] = {
    "command_changes": (_command_changes, "command changes"),
    "force_changes": (_command_changes, "force changes"),
    "small_commands": (_least(_SMALL_FORWARD, _SMALL_BACKWARD), "s of small commands on each side"),
    "motion": (_MOTION, "s of motion"),
    "longest_motion": (_longest(_MOTION), "s of motion in one recording"),
    "any_motion": (_ANY_MOTION, "s of motion of any axis"),
    "longest_any_motion": (_longest(_ANY_MOTION), "s of motion of any axis in one recording"),
    "motion_both_ways": (_least(_FORWARD, _BACKWARD), "s of motion in each direction"),
    "force_both_ways": (_moved_both_ways, "s of motion in each direction"),
    "together": (_seconds(_two_at_large_commands), "s of two axes at large commands"),
    "rest": (_REST, "s at rest"),
    "reversals": (_reversals, "reversals"),
    "load_change": (_load_change, "% change of the gravity load"),
    "weight_change": (_weight_change, "% change of the magnitude of the gravity load"),
    "joint_coverage": (_joint_coverage, "% of the joint range"),
    "signal_travel": (_MEASURED_MOTION, "s of motion while it is measured"),
    "tip_stops": (_seconds(_tip_moves), "s of tip motion"),
}
