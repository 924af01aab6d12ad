"""Single columns: numbers that stand for "no value", never measured, constant while the axis is commanded, nothing but noise,
positions that wrap, end stops inside the described range, and samples that are in the files and not in the dataset.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.datasets.chunked import Mask, copied, known, masked, stretches
from sysid.datasets.plausibility.finding import MOST, Cause, Evidence, Finding, interval, value
from sysid.datasets.quality.describe import SampleCounts, stored_counts, together
from sysid.datasets.quality.noise import table_noise
from sysid.datasets.recording import Recording
from sysid.datasets.wrapping import WELL_SAMPLED, Wraps, is_position, one_turn, wraps_of
from sysid.machine import Axis, Machine
from sysid.names import listed
from sysid.scratch import computed
from sysid.signals import axis_signal, split_signal

Array = npt.NDArray[np.float64]

_REMEDY = (
    "Where it means that there is no value, write `missing = [{}]` into the entry of the signal in the recipe; without a "
    "recipe, `sysid ingest --inspect PATH --draft recipe.toml` writes one. Then ingest again"
)


def sentinel_findings(flags: Sequence[Mapping[str, Any]]) -> dict[str, Finding]:
    """Axis or point → finding, for each with a ``sentinel`` flag.

    Args:
        flags: ``quality["flags"]`` of a dataset.
    """
    found: dict[str, list[Mapping[str, Any]]] = {}
    for flag in flags:
        if flag["kind"] == "sentinel":
            found.setdefault(split_signal(flag["signal"])[0], []).append(flag)
    return {owner: _finding(own) for owner, own in found.items()}


def _finding(flags: Sequence[Mapping[str, Any]]) -> Finding:
    signals = tuple(dict.fromkeys(flag["signal"] for flag in flags))
    evidence = [Evidence(f"{flag['signal']}: {flag['text']}", "measured values") for flag in flags]
    numbers = dict.fromkeys(flag["text"].partition(" ")[0] for flag in flags)
    cause = Cause(listed([*numbers], MOST) + " in", signals, "no measurement", remedy=_REMEDY.format(", ".join(numbers)))
    recordings = tuple(dict.fromkeys(flag["recording"] for flag in flags))
    return Finding(tuple(f"{signal}:sentinel" for signal in signals), "severe", tuple(evidence[:MOST]), (cause,), recordings)


#: Least time with a command in which a working sensor shows motion [s], and what counts as a command (share of the largest).
COMMANDED_S, COMMANDED = 3.0, 0.3
#: Share of its range above which the noise of a signal is nearly all of it: pure noise ranges over eight times its deviation.
NOISE_SHARE = 0.1
#: Samples of a recording in which noise is estimated.
NOISE_ROWS = 2**15


def column_findings(recordings: Sequence[Recording], machine: Machine) -> Iterator[Finding]:
    """Findings about single columns."""
    present = [signal for signal in machine.signals if any(signal in recording.signals for recording in recordings)]
    for signal in present:
        if all(signal not in r.signals or np.isnan(r.values(signal)).all() for r in recordings):
            evidence = Evidence(f"{signal} has no value in any recording", "values, or no such signal in the recipe")
            yield Finding((f"{signal}:missing",), "notice", (evidence,))
    motion = [recording for recording in recordings if recording.kind == "motion"]
    for axis in machine.axes:
        commanded = _commanded_s(motion, axis_signal(axis.name, "command"))
        if commanded < COMMANDED_S:
            continue
        for signal in dict.fromkeys((axis.driven, axis_signal(axis.name, "joint"))):
            if signal in present:
                yield from _still_sensor(motion, signal, commanded)


def wrap_findings(recordings: Sequence[Recording], machine: Machine) -> dict[str, Finding]:
    """Axis → finding, for each axis with a position that wraps: its steps are no motion, so that nothing else is checked."""
    found = {}
    recorded = {signal for recording in recordings for signal in recording.signals}
    for signal in machine.signals:
        if signal not in recorded or not is_position(signal, machine):
            continue
        wrapped = {r.name: wraps for r in recordings if r.kind == "motion" if (wraps := _wraps(r, signal, machine)) is not None}
        if wrapped:
            most = max(wrapped.values(), key=lambda wraps: wraps.count)
            unit = machine.expected_unit(signal) or "1"
            evidence = Evidence(f"{signal} {most.text(unit)}", "a position that continues")
            remedy = "Ingest its logs again: steps of one modulus are undone, unless the recipe says `modulus = 0`"
            cause = Cause("", (signal,), f"known only up to multiples of {most.modulus:.6g}", remedy=remedy)
            names = () if len(wrapped) == len(recordings) else tuple(wrapped)
            found[split_signal(signal)[0]] = Finding((f"{signal}:wrap",), "severe", (evidence,), (cause,), names)
    return found


def _wraps(recording: Recording, signal: str, machine: Machine) -> Wraps | None:
    """Wraps in a table. Steps against the motion: a row that resampling has put into the middle of one is left out."""
    values = recording.values(signal)
    moduli = one_turn(machine.expected_unit(signal) or "1")
    there = known(values)
    travel = float(np.ptp(there)) if len(there) else 0.0
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


def _commanded_s(recordings: Sequence[Recording], command: str) -> float:
    """Time in which a command differs from its commonest value by :data:`COMMANDED` of its largest difference [s]."""
    total = 0.0
    for recording in recordings:
        values = recording.values(command)[: 2**18]
        values = values[~np.isnan(values)]
        if len(values):
            away = np.abs(values - np.median(values))
            total += float(np.count_nonzero(away > COMMANDED * away.max())) / recording.rate_hz if away.max() > 0.0 else 0.0
    return total


def _still_sensor(recordings: Sequence[Recording], signal: str, commanded: float) -> Iterator[Finding]:
    low, high, noises = np.inf, -np.inf, []
    for recording in recordings:
        values = recording.values(signal)
        if np.isnan(values).all():
            continue
        low, high = min(low, float(np.nanmin(values))), max(high, float(np.nanmax(values)))
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


def end_stop_findings(recordings: Sequence[Recording], machine: Machine) -> Iterator[Finding]:
    """A notice for each valve axis that stops inside its stroke or limits."""
    for axis in machine.axes:
        low, high = axis.range
        if axis.actuation != "velocity" or not math.isfinite(high - low):
            continue
        stops = {side: _stop(recordings, axis, side) for side in (-1, 1)}
        inside = {side: stop for side, stop in stops.items() if stop is not None}
        if not inside:
            continue
        unit = machine.expected_unit(axis.driven)
        first, last = (inside[side].place if side in inside else end for side, end in ((-1, low), (1, high)))
        name = "stroke" if axis.drives == "cylinder" else "limits"
        evidence = tuple(
            Evidence(
                f"{axis.driven} stays at {value(stop.place, unit)} {stop.visits} times, {stop.seconds:.1f} s in all, although "
                f"{axis.name}.command pushes it further",
                f"motion up to {name} = {interval(low, high, unit)}",
            )
            for stop in inside.values()
        )
        remedy = f"Set {name} = {interval(first, last)} in machine.toml (or in the URDF, where it has them)"
        cause = Cause(f"`{name}` of axis", (axis.name,), "wider than the machine's end stops", remedy=remedy)
        yield Finding((f"{axis.name}:end_stop",), "notice", evidence, (cause,))


def _stop(recordings: Sequence[Recording], axis: Axis, side: int) -> EndStop | None:
    """The stop at one end of the motion; None without one, or at the described end."""
    low, high = axis.range
    width = high - low
    moving = [r for r in recordings if r.kind == "motion" and not np.isnan(r.values(axis.driven)).all()]
    if not moving:
        return None
    furthest = max(float(np.nanmax(y) if side > 0 else -np.nanmin(y)) for y in (r.values(axis.driven) for r in moving))
    noise = max(table_noise(r.values(axis.driven)[:NOISE_ROWS], r.rate_hz) for r in moving)
    tolerance = max(NOISES * noise, SHARE * width)
    end = high if side > 0 else -low
    if end - furthest < max(INSIDE * width, tolerance):
        return None
    places, seconds, visits, would_move = list[Array](), 0.0, 0, 0.0
    for recording in moving:
        y, u = side * recording.values(axis.driven), side * recording.values(axis_signal(axis.name, "command"))
        rate = recording.rate_hz
        left = True
        starts, ends = stretches((y > furthest - 2.0 * tolerance) & (u > PUSHED))
        previous = 0
        for first, last in zip(starts, ends, strict=True):
            left = left or bool(np.nanmin(y[previous:first], initial=np.inf) < furthest - AWAY * width)
            previous = last
            settled = slice(first + round(VISIT_S * rate / 2), last)
            if last - first < VISIT_S * rate or np.ptp(y[settled]) > tolerance:
                continue
            visits += left
            left = False
            places.append(y[settled])
            seconds += (last - first) / rate
            would_move += axis.gain * float(np.sum(u[settled])) / rate
    if visits < VISITS or seconds < TOTAL_S or would_move < MOVED * tolerance:
        return None
    return EndStop(side * float(np.median(np.concatenate(places))), seconds, visits)


#: Share of the samples of a signal that is used below which it is said, and below which the signal is not what was recorded.
COMPLETE, HALF = 0.95, 0.5


def _cause(counts: SampleCounts, signal: str) -> Cause:
    """The commonest reason, with its remedy."""
    most = max(counts.lost, key=lambda reason: counts.lost[reason])
    if most == "alone between gaps":
        remedy = f"Set `max_gap_s` in the recipe to the longest gap that may be bridged, for example {2.0 * counts.limit_s:.3g}"
        return Cause("samples", (), f"further apart than {counts.limit_s:.3g} s", remedy=remedy)
    if most == "with the stamp of another":
        remedy = "Choose a finer clock in the recipe, or state `rate_hz` there in place of `time`"
        return Cause("stamps", (), "coarser than the rows", remedy=remedy)
    if most == "beyond any number":
        return Cause("", (signal,), "damaged or read in a wrong unit", remedy="Correct `unit` or `scale` in the recipe")
    if most == "in an unknown turn":
        remedy = "Cut the log at the gap into recordings of their own"
        return Cause("", (signal,), "wrapped, with a gap in which it may have made several numbers of turns", remedy=remedy)
    remedy = "Correct the clock in the recipe, or cut the file"
    return Cause("", (signal,), "recorded at other times than the machine", remedy=remedy)


def sample_findings(streams: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> Iterator[Finding]:
    """A finding for each signal of which a recording uses less than :data:`COMPLETE` of the samples.

    Args:
        streams: recording → file/signal → figures, ``quality["streams"]`` of a dataset.
    """
    found: dict[str, dict[str, SampleCounts]] = {}
    for recording, entries in streams.items():
        for key, figures in entries.items():
            counts = stored_counts(figures)
            within = counts.samples - counts.between
            if within > 0 and counts.used < COMPLETE * within:
                found.setdefault(key, {})[recording] = counts
    for key, own in found.items():
        file, _, signal = key.rpartition("/")
        whole = together(list(own.values()))
        reasons = ", ".join(f"{count} {reason}" for reason, count in whole.lost.items())
        evidence = Evidence(f"{whole.used} of {whole.samples} samples of {signal} in {file} are used: {reasons}", "all of them")
        lost = any(counts.kept < HALF for counts in own.values())
        yield Finding((f"{signal}:samples",), "severe" if lost else "notice", (evidence,), (_cause(whole, signal),), tuple(own))
