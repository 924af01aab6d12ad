"""Checks of the streams in the files: their time base, numbers that stand for "no value", and samples that are not used."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from sysid.datasets.checks.figures import CheckContext
from sysid.datasets.checks.finding import MOST_NAMES, Cause, Evidence, Finding, factor_text, plain
from sysid.datasets.checks.mistakes import TIME, UnitMistake
from sysid.datasets.quality.sample_counts import SampleCounts, stored_counts, together
from sysid.datasets.recording import Recording
from sysid.names import listed, uncut_name
from sysid.signals import split_signal

#: A stream that is slower or faster than the grid by more than this is implausible: honest streams lie within 1/20 and 20.
RATE_LIMIT = 150.0
#: The same for recordings that are all shorter than this [s]: stamps that are too small make them short and fast at once.
BRIEF_S, BRIEF_LIMIT = 5.0, 30.0
#: Shortest recording of a motion [s]: no machine reacts to a command and stops in less.
SHORTEST_S = 0.5
#: Rates of loggers [Hz], to tell a wrong time unit from a wrong ``rate_hz``.
LOGGERS_HZ = (1.0, 2e4)


def check_stamps(data: CheckContext) -> list[Finding]:
    """Sample rates of the streams against ``rate_hz``, and the lengths of the recordings."""
    rate_hz, lengths = data.machine.rate_hz, {r.name: len(r) / r.rate_hz for r in data.motion}
    rates = _rates(data.streams, data.motion)
    longest = max(lengths.values(), default=math.inf)
    limit = RATE_LIMIT if longest > BRIEF_S else BRIEF_LIMIT
    wrong = {file: rate for file, rate in rates.items() if not 1.0 / RATE_LIMIT < rate / rate_hz < limit}
    if wrong:
        certain = limit == RATE_LIMIT or longest < SHORTEST_S
        typical = float(np.median(list(wrong.values())))
        mistake, recorded = _nearest(rate_hz / typical), LOGGERS_HZ[0] <= typical <= LOGGERS_HZ[1]
        # A rate of the grid that no logger has is itself the mistake.
        described = recorded and not LOGGERS_HZ[0] <= rate_hz <= LOGGERS_HZ[1]
        causes = [] if described else [mistake.time_cause]
        if recorded:
            factor = rate_hz / typical
            causes.append(Cause("`rate_hz` in machine.toml", (), factor_text(factor), factor, f"Write about {plain(typical)}"))
        found = ", ".join(f"{file} has {rate:.4g} samples a second" for file, rate in list(wrong.items())[:3])
        found += f" (and {len(wrong) - 3} files more)" if len(wrong) > 3 else ""
        found += f" and the longest recording {longest:.3g} s" if longest <= BRIEF_S else ""
        data.time_scale = mistake.factor if len(wrong) == len(rates) and not described else 1.0
        evidence = Evidence(found, f"about rate_hz = {rate_hz:g}")
        return [Finding(("time:rate",), "severe" if certain else "notice", (evidence,), tuple(causes))]
    if lengths and longest < SHORTEST_S:
        found = f"recordings are {min(lengths.values()):.3g} to {longest:.3g} s long"
        evidence = Evidence(found, f"at least {SHORTEST_S:g} s")
        seconds = UnitMistake(1e-3, "s", "ms")
        return [Finding(("time:length",), "severe", (evidence,), (seconds.time_cause,), tuple(lengths))]
    data.rate_ratio = float(np.median(list(rates.values()))) / rate_hz if rates else None
    return []


def likely_unit(rate: float, rate_hz: float) -> str:
    """The mistake that explains stamps at ``rate`` on a grid of ``rate_hz`` [Hz], in words; empty where they agree."""
    if not rate > 0.0 or 1.0 / RATE_LIMIT < rate / rate_hz < RATE_LIMIT:
        return ""
    return f"Likely cause: {_nearest(rate_hz / rate).time_cause.text}"


def _nearest(ratio: float) -> UnitMistake:
    return min(TIME, key=lambda mistake: mistake.distance(ratio, 0.5))


def _rates(streams: Mapping[str, Mapping[str, Mapping[str, Any]]], motion: Sequence[Recording]) -> dict[str, float]:
    """File of a stream → median rate of its signals over the recordings of motion [Hz]."""
    moving = {name for recording in motion for name in (recording.name, uncut_name(recording.name))}
    by_source: dict[str, list[float]] = {}
    for recording, entries in streams.items():
        for key, figures in entries.items() if recording in moving else ():
            if figures.get("rate_hz"):
                by_source.setdefault(key.rpartition("/")[0], []).append(float(figures["rate_hz"]))
    by_file: dict[str, list[float]] = {}
    for source, rates in by_source.items():
        by_file.setdefault(source.rpartition("/")[2], []).extend(rates)
    return {file: float(np.median(rates)) for file, rates in by_file.items()}


_MISSING = (
    "Where it means that there is no value, write `missing = [{}]` into the entry of the signal in the recipe; without a "
    "recipe, `sysid ingest --inspect PATH --draft recipe.toml` writes one. Then ingest again"
)


def check_sentinels(data: CheckContext) -> Iterator[Finding]:
    """Axes and points with a ``sentinel`` flag; nothing else about them is checked."""
    found: dict[str, list[Mapping[str, Any]]] = {}
    for flag in data.dataset.quality.get("flags", ()):
        if flag["kind"] == "sentinel":
            found.setdefault(split_signal(flag["signal"])[0], []).append(flag)
    data.unclear |= found.keys()
    for flags in found.values():
        signals = tuple(dict.fromkeys(flag["signal"] for flag in flags))
        evidence = tuple(Evidence(f"{flag['signal']}: {flag['text']}", "measured values") for flag in flags[:MOST_NAMES])
        numbers = dict.fromkeys(flag["text"].partition(" ")[0] for flag in flags)
        remedy = _MISSING.format(", ".join(numbers))
        cause = Cause(listed([*numbers], MOST_NAMES) + " in", signals, "no measurement", remedy=remedy)
        recordings = tuple(dict.fromkeys(flag["recording"] for flag in flags))
        yield Finding(tuple(f"{signal}:sentinel" for signal in signals), "severe", evidence, (cause,), recordings)


#: Share of the samples of a signal that is used below which it is said, and below which the signal is not what was recorded.
COMPLETE, HALF = 0.95, 0.5


def check_samples(data: CheckContext) -> Iterator[Finding]:
    """Samples in the files against those in the dataset: a recording uses less than :data:`COMPLETE` of a signal."""
    found: dict[str, dict[str, SampleCounts]] = {}
    for recording, entries in data.streams.items():
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
        cause = _lost(whole, signal)
        yield Finding((f"{signal}:samples",), "severe" if lost else "notice", (evidence,), (cause,), tuple(own))


def _lost(counts: SampleCounts, signal: str) -> Cause:
    """The commonest reason why samples of a signal are not used, with its remedy."""
    bridged = f"Set `max_gap_s` in the recipe to the longest gap that may be bridged, for example {2.0 * counts.limit_s:.3g}"
    finer = "Choose a finer clock in the recipe, or state `rate_hz` there in place of `time`"
    wrapped = "wrapped, with a gap in which it may have made several numbers of turns"
    elsewhere = "recorded at other times than the machine"
    causes = {
        "alone between gaps": Cause("samples", (), f"further apart than {counts.limit_s:.3g} s", remedy=bridged),
        "with the stamp of another": Cause("stamps", (), "coarser than the rows", remedy=finer),
        "beyond any number": Cause(
            "", (signal,), "damaged or read in a wrong unit", remedy="Correct `unit` or `scale` in the recipe"
        ),
        "in an unknown turn": Cause("", (signal,), wrapped, remedy="Cut the log at the gap into recordings of their own"),
        "outside the recording": Cause("", (signal,), elsewhere, remedy="Correct the clock in the recipe, or cut the file"),
    }
    return causes[max(counts.lost, key=lambda reason: counts.lost[reason])]
