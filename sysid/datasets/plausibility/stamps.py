"""The time base: sample rates of the streams against ``rate_hz``, and the lengths of the recordings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sysid.datasets.plausibility.finding import Cause, Evidence, Finding, factor_text, plain
from sysid.datasets.plausibility.mistakes import TIME, UnitMistake
from sysid.datasets.recording import Recording
from sysid.names import uncut_name

#: A stream that is slower or faster than the grid by more than this is implausible: honest streams lie within 1/20 and 20.
RATE_LIMIT = 150.0
#: The same for recordings that are all shorter than this [s]: stamps that are too small make them short and fast at once.
BRIEF_S, BRIEF_LIMIT = 5.0, 30.0
#: Shortest recording of a motion [s]: no machine reacts to a command and stops in less.
SHORTEST_S = 0.5
#: Rates of loggers [Hz], to tell a wrong time unit from a wrong ``rate_hz``.
LOGGERS_HZ = (1.0, 2e4)


def rates_of(streams: Mapping[str, Mapping[str, Mapping[str, Any]]], recordings: Sequence[Recording]) -> dict[str, float]:
    """File of a stream → median rate of its signals over the recordings of motion [Hz].

    Args:
        streams: ``quality["streams"]`` of a dataset.
    """
    moving = {uncut_name(recording.name) for recording in recordings if recording.kind == "motion"}
    moving |= {recording.name for recording in recordings if recording.kind == "motion"}
    found: dict[str, list[float]] = {}
    for recording, entries in streams.items():
        if recording not in moving:
            continue
        for key, figures in entries.items():
            rate = figures.get("rate_hz")
            if rate:
                found.setdefault(key.rpartition("/")[0], []).append(float(rate))
    by_file: dict[str, list[float]] = {}
    for source, rates in found.items():
        by_file.setdefault(source.rpartition("/")[2], []).extend(rates)
    return {file: float(np.median(rates)) for file, rates in by_file.items()}


def time_findings(rates: Mapping[str, float], recordings: Sequence[Recording], rate_hz: float) -> tuple[list[Finding], float]:
    """Findings about the stamps, and stamps / true time as far as that is certain (1 where nothing is wrong)."""
    motion = [recording for recording in recordings if recording.kind == "motion"]
    longest = max((len(recording) / recording.rate_hz for recording in motion), default=math.inf)
    limit = RATE_LIMIT if longest > BRIEF_S else BRIEF_LIMIT
    wrong = {file: rate for file, rate in rates.items() if not 1.0 / RATE_LIMIT < rate / rate_hz < limit}
    certain = limit == RATE_LIMIT or longest < SHORTEST_S
    short = [recording for recording in motion if len(recording) / recording.rate_hz < SHORTEST_S]
    if wrong:
        whole = len(wrong) == len(rates)
        typical = float(np.median(list(wrong.values())))
        mistake = _nearest(rate_hz / typical)
        # A rate of the grid that no logger has is itself the mistake.
        described = LOGGERS_HZ[0] <= typical <= LOGGERS_HZ[1] and not LOGGERS_HZ[0] <= rate_hz <= LOGGERS_HZ[1]
        causes = [] if described else [_time_cause(mistake)]
        if LOGGERS_HZ[0] <= typical <= LOGGERS_HZ[1]:
            factor = rate_hz / typical
            causes.append(Cause("`rate_hz` in machine.toml", (), factor_text(factor), factor, f"Write about {plain(typical)}"))
        files = ", ".join(f"{file} has {rate:.4g} samples a second" for file, rate in list(wrong.items())[:3])
        more = f" (and {len(wrong) - 3} files more)" if len(wrong) > 3 else ""
        files += f" and the longest recording {longest:.3g} s" if longest <= BRIEF_S else ""
        evidence = Evidence(files + more, f"about rate_hz = {rate_hz:g}")
        finding = Finding(("time:rate",), "severe" if certain else "notice", (evidence,), tuple(causes))
        return [finding], 1.0 if described or not whole else mistake.factor
    if short and len(short) == len(motion):
        lengths = [len(recording) / recording.rate_hz for recording in short]
        found = f"recordings are {min(lengths):.3g} to {max(lengths):.3g} s long"
        seconds = UnitMistake(1e-3, "s", "ms")
        names = tuple(recording.name for recording in short)
        evidence = Evidence(found, f"at least {SHORTEST_S:g} s")
        return [Finding(("time:length",), "severe", (evidence,), (_time_cause(seconds),), names)], 1.0
    return [], 1.0


def likely_unit(rate: float, rate_hz: float) -> str:
    """The mistake that explains stamps at ``rate`` on a grid of ``rate_hz`` [Hz], in words; empty where they agree."""
    mistake = _nearest(rate_hz / rate) if rate > 0.0 and not 1.0 / RATE_LIMIT < rate / rate_hz < RATE_LIMIT else None
    return f"Likely cause: {_time_cause(mistake).text}" if mistake is not None else ""


def _nearest(ratio: float) -> UnitMistake:
    return min(TIME, key=lambda mistake: abs(math.log(ratio / mistake.factor)) + 0.5 * mistake.rarity)


def _time_cause(mistake: UnitMistake) -> Cause:
    says = f"in {mistake.is_}, but were read as {mistake.read_as} ({factor_text(mistake.factor)})"
    unit = {"µs": "us"}.get(mistake.is_, mistake.is_)
    return Cause("the time stamps", (), says, mistake.factor, f'Set `time_unit = "{unit}"` in the recipe')
