"""Positions that wrap: a sensor of one turn or a counter of n bits reports a position only up to multiples of its modulus.

A wrapped value is ``y = c + ((x − c) mod M)`` of a position ``x``, with modulus ``M`` and lower end ``c``. Where ``x`` crosses
an end, ``y`` steps by ``M`` against the motion, and without these steps it moves on as before. :func:`find_wraps` takes nothing
else for a wrap: a reset, a slipped encoder and a demanded step change the position, and a fast motion has steps of similar
size beside its largest. :func:`unwrapped` undoes the steps; :func:`open_gaps` are those in which several numbers of turns are
possible; :func:`in_range` then chooses the multiple of ``M`` by the range of the axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.datasets.channel import Channel, seconds
from sysid.datasets.checks.finding import with_unit
from sysid.datasets.checks.sensors import AROUND, GAP_PERIODS, STEPS_OF_SENSOR, sensor_step
from sysid.datasets.chunked import Array, Mask, Rows, counted, differences, known, masked, median_step
from sysid.datasets.recipe import SignalMap
from sysid.errors import InputError
from sysid.machine import Machine
from sysid.names import listed
from sysid.scratch import computed
from sysid.signals import axis_signal, split_signal
from sysid.units import si_factor

#: Names of one turn; a wrong unit in the recipe does not hide that the numbers wrap.
TURN = ("rad", "deg", "turn")
#: Bits of counters.
BITS = range(8, 49)
#: Steps of a motion that is sampled well enough to be unwrapped, as a share of the modulus; steps of a wrap are larger than
#: the rest to one.
WELL_SAMPLED = 0.25
#: Largest ratio of the motion in a wrap to the steps beside it: what is left of any other step is not like its neighbours.
CONTINUES = 3.0
#: Largest share of the changes of a signal that are wraps: noise at an end makes every second one, a demanded square wave all.
MOST_WRAPS = 0.75
#: Steps longer than this many periods have missing rows.
MISSING_PERIODS = 1.5
#: Share of the samples that may lie outside of one modulus about the middle, and the margin there as a share of the modulus.
STRAY, MARGIN = 0.01, 1.0 / 16.0
#: Wraps that are compared with their neighbours.
_MOST = 2**14


@dataclass(frozen=True)
class Wraps:
    """Steps of one modulus in a signal, in its unit: they occur at ``end`` and at ``end − modulus``."""

    modulus: float
    count: int
    end: float

    def text(self, unit: str) -> str:
        times = "once" if self.count == 1 else f"{self.count} times"
        return f"wraps at {with_unit(self.end, unit)}, {times}, by {with_unit(self.modulus, unit)}"


def wraps_of(times: Array, values: Array, moduli: Sequence[float]) -> Wraps | None:
    """The wraps by the modulus that explains most steps; None where no step is a wrap.

    Args:
        times: increasing, (n,) [s].
        values: (n,); NaN is skipped.
    """
    found = [wraps for modulus in moduli if (wraps := find_wraps(times, values, modulus)) is not None]
    return max(found, key=lambda wraps: wraps.count, default=None)


def find_wraps(times: Array, values: Array, modulus: float) -> Wraps | None:
    """The wraps of ``values`` (n,) by ``modulus``, as :func:`wraps_of`; None where its large steps are something else."""
    there = ~np.isnan(values)
    if not there.all():
        times, values = times[there], values[there]
    if len(values) < 2 * AROUND:
        return None
    large = (1.0 - WELL_SAMPLED) * modulus
    steps = differences(values)
    rows = np.flatnonzero(masked(len(steps), lambda first, last: np.abs(steps[first:last]) > large))
    if not len(rows):
        return None
    middle = float(np.median(0.5 * (values[rows] + values[rows + 1])))
    half = (0.5 + MARGIN) * modulus
    if counted(len(values), lambda first, last: np.abs(values[first:last] - middle) > half) > STRAY * len(values):
        return None
    motion = computed(len(steps), lambda first, last: _within(steps[first:last], modulus))
    if len(rows) > MOST_WRAPS * counted(len(motion), lambda first, last: np.abs(steps[first:last]) > 0.0):
        return None
    spans = np.maximum(differences(times) / median_step(times), 1.0)
    used = rows[:: math.ceil(len(rows) / _MOST)]
    floor = STEPS_OF_SENSOR * sensor_step(values)
    share = float(np.mean(_continues(used, motion, spans, modulus, floor)))
    others = counted(len(motion), lambda first, last: np.abs(motion[first:last]) > WELL_SAMPLED * modulus)
    count = round(share * len(rows))
    end = float(np.maximum(values[rows], values[rows + 1]).max())
    return Wraps(modulus, count, end) if count > max(others, len(rows) - count) else None


def _continues(rows: Rows, motion: Array, spans: Array, modulus: float, floor: float) -> Mask:
    """Whether the motion in each of ``rows`` is like that of the well-sampled steps beside it, (m,)."""
    sides = np.concatenate([np.arange(-AROUND, 0), np.arange(1, AROUND + 1)])
    beside = rows[:, None] + sides
    inside = (beside >= 0) & (beside < len(motion))
    beside = np.clip(beside, 0, len(motion) - 1)
    inside &= spans[beside] <= GAP_PERIODS
    around = np.where(inside, np.abs(motion[beside]) / spans[beside], 0.0).max(axis=1)
    own = np.abs(motion[rows]) / spans[rows]
    return np.asarray(
        (spans[rows] <= GAP_PERIODS) & (around <= WELL_SAMPLED * modulus) & (own <= np.maximum(CONTINUES * around, floor))
    )


def _within(steps: Array, modulus: float) -> Array:
    """Steps up to multiples of ``modulus``, between −M/2 and M/2."""
    return np.asarray(steps - modulus * np.round(steps / modulus))


def unwrapped(times: Array, values: Array, modulus: float) -> Array:
    """``values`` (n,) with every step as small as multiples of ``modulus`` make it; NaN stays.

    Where rows are missing, the step is the one nearest to the motion at the mean of the speeds on both sides.
    """
    there = np.flatnonzero(~np.isnan(values))
    if len(there) < 2:
        return values
    at, kept = times[there], values[there]
    steps, spans = np.diff(kept), np.diff(at)
    speeds = _within(steps, modulus) / spans
    expected = np.zeros(len(steps))
    gaps = np.flatnonzero(spans > MISSING_PERIODS * median_step(at))
    expected[gaps] = _predicted(speeds, spans, gaps)
    turns = np.concatenate([[0.0], np.cumsum(np.round((expected - steps) / modulus))])
    result = values.copy()
    result[there] = kept + modulus * turns
    return result


def open_gaps(times: Array, values: Array, modulus: float) -> Rows:
    """The rows before gaps in which an unwrapped position (n,) without NaN may have made several numbers of turns.

    The motion in a gap is predicted as :func:`unwrapped` does it. The same prediction where samples are there shows how far
    the motion is from it: another number of turns is possible up to twice that far (the largest of a few errors is not the
    largest possible one) and a quarter of the modulus (:data:`WELL_SAMPLED`). An error is that of the longest stretch without a
    gap, times the square of the ratio of the times, where none is as long as the gap.
    """
    usual = median_step(times) if len(times) > 1 else 0.0
    if not usual:
        return np.empty(0, np.intp)
    steps, spans = differences(values), differences(times)
    lags = np.maximum(np.rint(spans / usual), 1.0).astype(np.int64)
    fastest = float(np.max(np.abs(steps[lags == 1]) / spans[lags == 1], initial=0.0))
    margin = WELL_SAMPLED * modulus
    rows = np.flatnonzero((lags > 1) & (2.0 * fastest * spans + margin > 0.5 * modulus))
    if not len(rows):
        return rows
    missed = steps[rows] - _predicted(steps / spans, spans, rows)
    ends = np.flatnonzero(np.concatenate([[True], lags > 1, [True]]))
    longest = max(int(np.diff(ends).max()) - 3, 1)  # a step beside it on both sides
    open_ = np.zeros(len(rows), dtype=bool)
    for lag in np.unique(lags[rows]).tolist():
        width = min(lag, longest)
        low, high = 2.0 * _errors(times, values, width, usual) * (lag / width) ** 2
        own = lags[rows] == lag
        for turn in (-modulus, modulus):
            open_ |= own & (missed + turn > low - margin) & (missed + turn < high + margin)
    return rows[open_]


def _predicted(speeds: Array, spans: Array, gaps: Rows) -> Array:
    """The motion in the steps ``gaps`` at the mean of the speeds on both sides."""
    before, after = np.maximum(gaps - 1, 0), np.minimum(gaps + 1, len(speeds) - 1)
    return np.asarray(0.5 * (speeds[before] + speeds[after]) * spans[gaps])


def _errors(times: Array, values: Array, lag: int, usual: float) -> Array:
    """Least and largest difference between the motion in ``lag`` periods and its prediction, where no sample is missing."""
    first, last = slice(1, len(values) - 1 - lag), slice(1 + lag, len(values) - 1)
    there = np.abs(times[2 + lag :] - times[: -2 - lag] - (lag + 2) * usual) < 0.5 * usual
    speeds = 0.5 * (values[first] - values[: -2 - lag] + values[2 + lag :] - values[last])
    missed = (values[last] - values[first] - lag * speeds)[there]
    return np.array([np.min(missed, initial=0.0), np.max(missed, initial=0.0)])


def _in_one_turn(channel: Channel) -> tuple[Channel, str]:
    """An unwrapped channel without the samples beside its longest part in which the number of turns is known, and why."""
    there = np.flatnonzero(~np.isnan(channel.values))
    times = seconds(channel.stamps[there], int(channel.stamps[0]))
    gaps = open_gaps(times, channel.values[there], _modulus(channel))
    if not len(gaps):
        return channel, ""
    edges = np.concatenate([[0], gaps + 1, [len(there)]])
    longest = int(np.argmax(np.diff(edges)))
    left = np.delete(there, np.s_[edges[longest] : edges[longest + 1]])
    values = channel.values.copy()
    values[left] = np.nan
    each = [f"the gap of {times[gap + 1] - times[gap]:.3g} s after {times[gap]:.4g} s" for gap in gaps.tolist()]
    text = (
        f"{channel.signal} may have made several numbers of turns in {listed(each, 3)}: {len(left)} samples beside the longest "
        "part taken as missing; make a recording of each part to use them all"
    )
    return replace(channel, values=values, counts=replace(channel.counts, turns=len(left))), text


def continuous(channel: Channel, mapping: SignalMap, per_raw: float, machine: Machine) -> tuple[Channel, str]:
    """The channel without its wraps, and what was undone where the recipe does not state it ("" if nothing).

    Args:
        mapping: of its signal; ``modulus`` states the period of the raw values.
        per_raw: change of the value [SI] per raw one.

    Raises:
        InputError: the values exceed the stated modulus.
    """
    if mapping.modulus == 0.0 or not len(channel.stamps):
        return channel, ""
    times = seconds(channel.stamps, int(channel.stamps[0]))
    if mapping.modulus is not None:
        modulus = mapping.modulus * abs(per_raw)
        there = known(channel.values)
        width = float(np.ptp(there)) if len(there) else 0.0
        if width > (1.0 + 2.0 * MARGIN) * modulus:
            found = f"values over a range of {width / abs(per_raw):.6g} with `modulus = {mapping.modulus:g}`"
            remedy = "Correct `modulus`, the period of the raw values."
            raise InputError(f"{channel.source}: {channel.signal}", found, "a range of one modulus at most", remedy)
        return _in_one_turn(replace(channel, values=unwrapped(times, channel.values, modulus), modulus=modulus))
    if not is_position(channel.signal, machine):
        return channel, ""
    wraps = wraps_of(times, channel.values, _moduli(channel, mapping, per_raw))
    if wraps is None:
        return channel, ""
    text = (
        f"{channel.signal} {wraps.text(channel.unit)}: unwrapped. `modulus = {wraps.modulus / abs(per_raw):.9g}` in the recipe "
        "puts recordings without such a step into the same turn, `modulus = 0` keeps the steps"
    )
    values = unwrapped(times, channel.values, wraps.modulus)
    whole, said = _in_one_turn(replace(channel, values=values, modulus=wraps.modulus))
    return whole, "; ".join(filter(None, (text, said)))


def _moduli(channel: Channel, mapping: SignalMap, per_raw: float) -> list[float]:
    """Moduli of a signal in its SI unit: one turn, and the counter that just holds the raw values if these are integers."""
    moduli = one_turn(channel.unit)
    moduli += [modulus * abs(per_raw) for modulus in moduli]
    values = known(channel.values)
    width = float(np.ptp(values)) / abs(per_raw) if len(values) else 0.0
    bits = next((bits for bits in BITS if 2**bits > width), None)
    if bits is not None and not counted(len(values), lambda first, last: ~_whole(values[first:last], mapping, per_raw)):
        moduli.append(2**bits * abs(per_raw))
    return sorted(set(moduli))


def _whole(values: Array, mapping: SignalMap, per_raw: float) -> Mask:
    counts = (values - mapping.offset) / per_raw + mapping.zero
    return np.asarray(np.abs(counts - np.round(counts)) < 1e-3)


def one_turn(unit: str) -> list[float]:
    """One turn in the numbers of a signal [``unit``]: in rad, or as it is read where its unit is wrong."""
    return [] if unit == "m" else [2.0 * math.pi / si_factor(name)[0] for name in TURN]


def is_position(signal: str, machine: Machine) -> bool:
    """Whether a signal is a position of an axis, measured or demanded."""
    owner, quantity = split_signal(signal)
    if not machine.has_axis(owner):
        return False
    return quantity in ("joint", "cylinder") or (quantity == "command" and machine.axis(owner).follows_positions)


def in_range(channels: Sequence[Channel], machine: Machine) -> list[Channel]:
    """Unwrapped channels shifted by the multiple of their modulus with which they leave the range of their axis least.

    Parts of a signal on one clock continue each other. Where the range is unbounded, a position axis stays near its command.
    """
    groups: dict[tuple[str, str, bool], list[int]] = {}
    for index, channel in enumerate(channels):
        if channel.modulus is not None:
            groups.setdefault((channel.signal, channel.clock, channel.primary), []).append(index)
    result = list(channels)
    for indices in groups.values():
        indices.sort(key=lambda index: int(channels[index].stamps[0]))
        last = math.nan
        for index in indices:
            channel = result[index]
            values = known(channel.values)
            if not len(values):
                continue
            if not math.isnan(last):
                result[index] = _shifted(channel, round((last - float(values[0])) / _modulus(channel)))
            last = float(known(result[index].values)[-1])
        turns = _turns([result[index] for index in indices], channels, machine)
        for index in indices:
            result[index] = _shifted(result[index], turns)
    return result


def _modulus(channel: Channel) -> float:
    assert channel.modulus is not None
    return channel.modulus


def _shifted(channel: Channel, turns: int) -> Channel:
    return channel if turns == 0 else replace(channel, values=channel.values + turns * _modulus(channel))


def _turns(parts: Sequence[Channel], channels: Sequence[Channel], machine: Machine) -> int:
    values = np.concatenate([known(part.values) for part in parts])
    owner, quantity = split_signal(parts[0].signal)
    axis = next((axis for axis in machine.axes if axis.name == owner), None)
    if axis is None or not len(values):
        return 0
    modulus = _modulus(parts[0])
    low, high = float(values.min()), float(values.max())
    ends = axis.limits if quantity == "joint" else axis.range
    if ends is not None and all(map(math.isfinite, ends)):
        nearest = round((0.5 * (ends[0] + ends[1]) - 0.5 * (low + high)) / modulus)
        options = range(min(nearest, 0) - 1, max(nearest, 0) + 2) if abs(nearest) < 1000 else range(nearest, nearest + 1)

        def beyond(turns: int) -> float:
            return max(ends[0] - low - turns * modulus, high + turns * modulus - ends[1], 0.0)

        return min(options, key=lambda turns: (beyond(turns), abs(turns)))
    commands = [known(c.values) for c in channels if c.signal == axis_signal(owner, "command")]
    if axis.follows_positions and parts[0].signal == axis.driven and commands and len(commands[0]):
        return round((float(np.median(commands[0])) - float(np.median(values))) / modulus)
    return 0
