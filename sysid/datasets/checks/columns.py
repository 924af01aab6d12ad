"""Checks of the columns of the tables: positions that wrap, columns that are exchanged, never measured, constant while the axis
is commanded or nothing but noise, and end stops inside the described range.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.datasets.checks.figures import AxisFigures, CheckContext
from sysid.datasets.checks.finding import Cause, Evidence, Finding, exchanged_columns, interval, with_unit
from sysid.datasets.checks.measures import cost_of
from sysid.datasets.chunked import Array, Mask, copied, ends, known, longest_run, masked, measured, stretches
from sysid.datasets.quality.noise import table_noise
from sysid.datasets.quality.responses import Motion, changes, correlation, motion_of, strengths
from sysid.datasets.recording import Recording
from sysid.datasets.wrapping import WELL_SAMPLED, Wraps, is_position, one_turn, wraps_of
from sysid.machine import Axis, Machine
from sysid.scratch import computed
from sysid.signals import axis_signal, split_signal


def check_wraps(data: CheckContext) -> Iterator[Finding]:
    """Positions that wrap: their steps are no motion, so that nothing else about these axes is checked."""
    found: dict[str, Finding] = {}
    recorded = {signal for recording in data.recordings for signal in recording.signals}
    for signal in data.machine.signals:
        if signal not in recorded or not is_position(signal, data.machine):
            continue
        wrapped = {r.name: wraps for r in data.motion if (wraps := _wraps(r, signal, data.machine)) is not None}
        if wrapped:
            most = max(wrapped.values(), key=lambda wraps: wraps.count)
            unit = data.machine.expected_unit(signal) or "1"
            evidence = Evidence(f"{signal} {most.text(unit)}", "a position that continues")
            remedy = "Ingest its logs again: steps of one modulus are undone, unless the recipe says `modulus = 0`"
            cause = Cause("", (signal,), f"known only up to multiples of {most.modulus:.6g}", remedy=remedy)
            names = () if len(wrapped) == len(data.recordings) else tuple(wrapped)
            found[split_signal(signal)[0]] = Finding((f"{signal}:wrap",), "severe", (evidence,), (cause,), names)
    data.unclear |= found.keys()
    yield from found.values()


def _wraps(recording: Recording, signal: str, machine: Machine) -> Wraps | None:
    """Wraps in a table. Steps against the motion: a row that resampling has put into the middle of one is left out."""
    values = recording.values(signal)
    there = known(values)
    travel = float(np.ptp(there)) if len(there) else 0.0
    moduli = one_turn(machine.expected_unit(signal) or "1")
    moduli = [modulus for modulus in moduli if travel > (1.0 - WELL_SAMPLED) * modulus]  # no larger step without travel
    if not moduli:
        return None
    inner = max(len(values) - 2, 0)
    steps = computed(inner, lambda a, b: np.abs(values[a + 2 : b + 2] - values[a:b]))
    least = 0.5 * float(np.nanmax(steps, initial=0.0))

    def within(a: int, b: int) -> Mask:
        before, after = values[a + 1 : b + 1] - values[a:b], values[a + 2 : b + 2] - values[a + 1 : b + 1]
        return (before * after > 0.0) & (steps[a:b] > least)

    there = copied(values)
    there[1:-1][masked(inner, within)] = np.nan
    return wraps_of(recording.values("time"), there, moduli)


#: Correlation with the own command, at most, and with that of another axis, at least, for an exchange. On honest data the own
#: correlation is 0.8 and more for valves, 0.9 and more for servos.
OWN, OTHER = 0.4, 0.65
#: Difference of the costs of ranges that decides which of commands and measurements are exchanged [nats].
DECIDED = 4.0
#: Axes without a response of their own, up to which each is compared with every other.
MOST_COMPARED = 500


@dataclass(frozen=True)
class Exchange:
    """Axes whose columns are exchanged: axis → the axis whose command it follows; and how many were too many to compare."""

    follows: Mapping[str, str]
    too_many: int = 0


def check_exchanges(data: CheckContext) -> Iterator[Finding]:
    """The motion of each axis against the commands of all: two follow each other's command and not their own."""
    figures = {each.axis.name: each for each in data.clear}
    driven = _exchange(data, [f.axis for f in figures.values()], "driven")
    joints = Exchange({})
    if any(f.joint is not None for f in figures.values()):
        joints = _exchange(data, [f.axis for f in figures.values() if f.joint is not None or f.axis.drives == "joint"], "joint")
    if driven.follows:
        data.exchanged |= driven.follows.keys()
        if all(figures[axis].joint is not None for axis in driven.follows):
            with_command = all(joints.follows.get(axis) == other for axis, other in driven.follows.items())
            causes = ["command" if with_command else "driven"]
        else:
            causes = _by_ranges(driven, figures)
        yield _exchanged(driven, figures, "driven", causes)
    if joints.follows and not data.exchanged & joints.follows.keys():
        yield _exchanged(joints, figures, "joint", ["joint"])
        data.exchanged |= joints.follows.keys()
    data.unclear |= data.exchanged
    if too_many := max(driven.too_many, joints.too_many):
        found = f"{too_many} axes do not follow their own command"
        evidence = Evidence(found, f"at most {MOST_COMPARED} to search for exchanged columns")
        yield Finding(("machine:exchanged",), "notice", (evidence,))


def _exchange(data: CheckContext, axes: Sequence[Axis], quantity: str) -> Exchange:
    from scipy.optimize import linear_sum_assignment

    follows: dict[str, str] = {}
    for actuation in ("velocity", "position", "servo"):
        suspects: list[tuple[str, Motion, Array]] = []
        for axis in axes:
            if axis.actuation != actuation:
                continue
            signal = axis.driven if quantity == "driven" else axis_signal(axis.name, "joint")
            motion = motion_of(data.motion, axis, signal, data.time_scale)
            moved = motion.speed if actuation == "velocity" else motion.place
            if changes(motion.command) and changes(moved) and abs(correlation(motion.command, moved, motion.delays)) < OWN:
                suspects.append((axis.name, motion, moved))
        if len(suspects) > MOST_COMPARED:
            return Exchange({}, len(suspects))
        if len(suspects) < 2:
            continue
        strength = strengths(
            np.column_stack([motion.command for _, motion, _ in suspects]),
            np.column_stack([moved for _, _, moved in suspects]),
            suspects[0][1].delays,
        )
        for command, answer in zip(*map(np.ndarray.tolist, linear_sum_assignment(-strength)), strict=True):
            if command != answer and strength[command, answer] > OTHER:
                follows[suspects[answer][0]] = suspects[command][0]
    # An exchange is complete: each column that is missed by one axis is found at another.
    return Exchange(follows if set(follows) == set(follows.values()) else {})


def _by_ranges(exchange: Exchange, figures: Mapping[str, AxisFigures]) -> list[str]:
    """Commands or measurements: with the right one corrected, positions lie within the ends of their axes."""
    as_it_is = sum(cost_of(replace(figures[axis], response=None)) for axis in exchange.follows)
    exchanged = sum(
        cost_of(replace(figures[other], response=None, driven=figures[axis].driven, pairs=None))
        for axis, other in exchange.follows.items()
    )
    if exchanged < as_it_is - DECIDED:
        return ["driven"]
    return ["command"] if as_it_is < exchanged - DECIDED else ["command", "driven"]


def _exchanged(exchange: Exchange, figures: Mapping[str, AxisFigures], measured: str, causes: Sequence[str]) -> Finding:
    signals = {axis: figures[axis].signal(measured) for axis in exchange.follows}
    evidence = tuple(
        Evidence(f"{signals[axis]} follows {other}.command, not {axis}.command", "each axis to follow its own command")
        for axis, other in exchange.follows.items()
    )
    named = tuple(exchanged_columns(*(figures[axis].signal(cause) for axis in exchange.follows)) for cause in causes)
    return Finding(tuple(f"{signal}:exchanged" for signal in signals.values()), "severe", evidence, named)


@dataclass(frozen=True)
class RecordingTable:
    """One recording, as the checks look at it whose texts are stored with it.

    Args:
        moving: commanded axis → where it is commanded, (n,); empty for static poses.
    """

    recording: Recording
    machine: Machine
    moving: Mapping[str, Mask]


#: A sensor that repeats one value for this long while its axis is commanded may be stuck [s].
STUCK_S = 2.0


def empty_columns(table: RecordingTable) -> Iterator[str]:
    """Columns without a value."""
    for signal in table.recording.signals:
        if np.isnan(table.recording.values(signal)).all():
            yield f"{signal}: {'constant in no pose' if table.recording.kind == 'poses' else 'nothing was measured'}"


def implausible_positions(table: RecordingTable) -> Iterator[str]:
    """Positions that repeat one value while the axis is commanded, or lie outside its range."""
    for name, moving in table.moving.items():
        driven, ends = table.machine.axis(name).driven, table.machine.axis(name).range
        values = table.recording.values(driven)
        there = known(values)
        if not len(there):
            continue
        frozen = np.zeros(len(values), dtype=bool)
        frozen[1:] = (values[1:] == values[:-1]) & moving[1:] & moving[:-1]
        stuck = longest_run(frozen) / table.recording.rate_hz
        if stuck > STUCK_S:
            yield f"{driven}: one value for {stuck:.1f} s while {name} is commanded: stuck sensor, or too small a command"
        if np.isfinite(ends).all():
            margin = 1e-3 * (ends[1] - ends[0])
            beyond = (there < ends[0] - margin) | (there > ends[1] + margin)
            if beyond.any():
                share = f"{100 * beyond.mean():.1f} %"
                yield f"{driven}: {share} of the samples are outside [{ends[0]:g}, {ends[1]:g}]: offset or unit?"


#: Least time with a command in which a working sensor shows motion [s], and what counts as a command (share of the largest).
COMMANDED_S, COMMANDED = 3.0, 0.3
#: Share of its range above which the noise of a signal is nearly all of it: pure noise ranges over eight times its deviation.
NOISE_SHARE = 0.1
#: Samples of a recording in which noise is estimated, and commands counted.
NOISE_ROWS, COMMAND_ROWS = 2**15, 2**18


def check_columns(data: CheckContext) -> Iterator[Finding]:
    """Columns without a value; constant or with nothing but noise, although the axis is commanded."""
    present = [signal for signal in data.machine.signals if any(signal in recording.signals for recording in data.recordings)]
    for signal in present:
        if not any(signal in r.signals and measured(r.values(signal)) for r in data.recordings):
            evidence = Evidence(f"{signal} has no value in any recording", "values, or no such signal in the recipe")
            yield Finding((f"{signal}:missing",), "notice", (evidence,))
    for axis in data.machine.axes:
        commanded = _commanded_s(data.motion, axis_signal(axis.name, "command"))
        if commanded < COMMANDED_S:
            continue
        for signal in dict.fromkeys((axis.driven, axis_signal(axis.name, "joint"))):
            if signal in present:
                yield from _still_sensor(data.motion, signal, commanded)


def _commanded_s(recordings: Sequence[Recording], command: str) -> float:
    """Time in which a command differs from its commonest value by :data:`COMMANDED` of its largest difference [s]."""
    total = 0.0
    for recording in recordings:
        values = recording.values(command)[:COMMAND_ROWS]
        values = values[~np.isnan(values)]
        if len(values):
            away = np.abs(values - np.median(values))
            total += float(np.count_nonzero(away > COMMANDED * away.max())) / recording.rate_hz if away.max() > 0.0 else 0.0
    return total


def _still_sensor(recordings: Sequence[Recording], signal: str, commanded: float) -> Iterator[Finding]:
    low, high, noises = np.inf, -np.inf, []
    for recording in recordings:
        values = recording.values(signal)
        if not measured(values):
            continue
        lowest, highest = ends(values)
        low, high = min(low, lowest), max(high, highest)
        noises.append(table_noise(values[:NOISE_ROWS], recording.rate_hz))
    if not noises:
        return
    expected = f"motion: the axis is commanded for {commanded:.0f} s"
    if high - low <= 1e-9 * max(abs(low), abs(high), 1e-3):
        yield Finding((f"{signal}:constant",), "severe", (Evidence(f"{signal} is {low:.4g} in every row", expected),))
    elif np.median(noises) > NOISE_SHARE * (high - low):
        share = float(np.median(noises)) / (high - low)
        found = f"the noise of {signal} is {100 * share:.0f} % of its whole range"
        yield Finding((f"{signal}:noise",), "notice", (Evidence(found, expected),))


#: Least command that pushes, beyond most dead-bands; least duration of a visit and of all [s]; least number of visits.
PUSHED, VISIT_S, TOTAL_S, VISITS = 0.3, 0.3, 1.0, 2
#: Places of a stop agree to this many standard deviations of the noise, or to this share of the range.
NOISES, SHARE = 6.0, 1e-3
#: Least distance to the described end, and least way back between two visits, as shares of the range.
INSIDE, AWAY = 0.01, 0.05
#: The nominal speed would leave the place by this multiple of its tolerance during the visits.
MOVED = 20.0


@dataclass(frozen=True)
class EndStop:
    """A place where an axis stays although the command pushes it further, and for how long."""

    place: float
    seconds: float
    visits: int


def check_end_stops(data: CheckContext) -> Iterator[Finding]:
    """A notice for each valve axis that stops inside its stroke or limits although it is commanded further."""
    for axis in data.machine.axes:
        low, high = axis.range
        if axis.actuation != "velocity" or not math.isfinite(high - low) or axis.name in data.unclear:
            continue
        inside = {side: stop for side in (-1, 1) if (stop := _stop(data.motion, axis, side)) is not None}
        if not inside:
            continue
        unit = data.machine.expected_unit(axis.driven)
        first, last = (inside[side].place if side in inside else end for side, end in ((-1, low), (1, high)))
        name = "stroke" if axis.drives == "cylinder" else "limits"
        evidence = tuple(
            Evidence(
                f"{axis.driven} stays at {with_unit(stop.place, unit)} {stop.visits} times, {stop.seconds:.1f} s in all, "
                f"although {axis.name}.command pushes it further",
                f"motion up to {name} = {interval(low, high, unit)}",
            )
            for stop in inside.values()
        )
        remedy = f"Set {name} = {interval(first, last)} in machine.toml (or in the URDF, where it has them)"
        cause = Cause(f"`{name}` of axis", (axis.name,), "wider than the machine's end stops", remedy=remedy)
        yield Finding((f"{axis.name}:end_stop",), "notice", evidence, (cause,))


def _stop(motion: Sequence[Recording], axis: Axis, side: int) -> EndStop | None:
    """The stop at one end of the motion; None without one, or at the described end."""
    low, high = axis.range
    width = high - low
    moving = [r for r in motion if measured(r.values(axis.driven))]
    if not moving:
        return None
    furthest = max(high if side > 0 else -low for low, high in (ends(r.values(axis.driven)) for r in moving))
    noise = max(table_noise(r.values(axis.driven)[:NOISE_ROWS], r.rate_hz) for r in moving)
    tolerance = max(NOISES * noise, SHARE * width)
    end = high if side > 0 else -low
    if end - furthest < max(INSIDE * width, tolerance):
        return None
    places, seconds, visits, would_move = list[Array](), 0.0, 0, 0.0
    for recording in moving:
        y, u, rate = recording.values(axis.driven), recording.values(axis_signal(axis.name, "command")), recording.rate_hz

        def pushed(first: int, last: int, y: Array = y, u: Array = u) -> Mask:
            return (side * y[first:last] > furthest - 2.0 * tolerance) & (side * u[first:last] > PUSHED)

        left = True
        previous = 0
        for first, last in zip(*stretches(masked(len(y), pushed)), strict=True):
            since = y[previous:first]
            back = np.nanmin(since, initial=np.inf) if side > 0 else -np.nanmax(since, initial=-np.inf)
            left, previous = left or bool(back < furthest - AWAY * width), last
            settled = slice(first + round(VISIT_S * rate / 2), last)
            if last - first < VISIT_S * rate or np.ptp(y[settled]) > tolerance:
                continue
            visits += left
            left = False
            places.append(side * y[settled])
            seconds += (last - first) / rate
            would_move += axis.gain * float(np.sum(side * u[settled])) / rate
    if visits < VISITS or seconds < TOTAL_S or would_move < MOVED * tolerance:
        return None
    return EndStop(side * float(np.median(np.concatenate(places))), seconds, visits)
