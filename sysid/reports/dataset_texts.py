"""What a dataset shows, as text for terminal, report and site: flags of ingest, one line per event with its signals, the most
severe kinds first; what became of the samples of each signal; how many clocks are aligned; excitation verdicts in groups.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid import display
from sysid.datasets.quality.sample_counts import SampleCounts, stored_counts, together
from sysid.datasets.recording import Dataset
from sysid.display import NOTHING
from sysid.gap.experiment.excitation_verdict import ExcitationVerdict, RecordingRequest
from sysid.machine import Axis, Machine
from sysid.reports import words
from sysid.signals import axis_signal

#: Kinds with wrong values before kinds with missing values.
_ORDER = ("marker_swap", "jump", "outlier", "stuck", "saturation", "stamps", "dropout", "jitter")


@dataclass(frozen=True)
class FlagLine:
    """One event in one or more signals."""

    recording: str
    kind: str
    signals: str
    from_s: float
    to_s: float
    text: str


def flag_lines(flags: Sequence[Mapping[str, Any]]) -> list[FlagLine]:
    """``quality["flags"]`` of a dataset version as lines; an event of several signals is one line."""
    events: dict[tuple[str, str, float, float, str], list[str]] = {}
    for flag in flags:
        key = (str(flag["recording"]), str(flag["kind"]), float(flag["from_s"]), float(flag["to_s"]), str(flag["text"]))
        events.setdefault(key, []).append(words.signal_name(str(flag["signal"])))
    ordered = sorted(events.items(), key=lambda item: (_rank(item[0][1]), item[0][0], item[0][2]))
    return [
        FlagLine(recording, kind.replace("_", " "), _listed(names), begin, end, text)
        for (recording, kind, begin, end, text), names in ordered
    ]


def kinds_of(lines: Sequence[FlagLine]) -> str:
    """``4 × marker swap, 23 × dropout``."""
    return ", ".join(f"{count} × {kind}" for kind, count in Counter(line.kind for line in lines).items())


def _rank(kind: str) -> int:
    return _ORDER.index(kind) if kind in _ORDER else 0


def _listed(names: Sequence[str]) -> str:
    """All names, or the first two and the number of others."""
    unique = list(dict.fromkeys(names))
    return ", ".join(unique) if len(unique) <= 3 else f"{', '.join(unique[:2])} and {len(unique) - 2} more"


@dataclass(frozen=True)
class SampleLine:
    """One signal; ``filled``: share of the rows of its recordings that have a value, NaN for a second source."""

    name: str
    counts: SampleCounts
    filled: float

    @property
    def lost(self) -> str:
        """Why samples are not used, with their numbers."""
        counts = self.counts
        reasons = {
            "empty": counts.empty,
            "repeated": counts.repeated,
            "in guards between blocks": counts.between,
            **counts.lost,
        }
        return ", ".join(f"{count} {reason}" for reason, count in reasons.items() if count) or NOTHING


def sample_lines(dataset: Dataset) -> list[SampleLine]:
    """One line for each signal, in the order of the machine; second sources after the first."""
    found: dict[tuple[str, bool], list[SampleCounts]] = {}
    for entries in dataset.quality.get("streams", {}).values():
        for key, figures in entries.items():
            found.setdefault((key.rpartition("/")[2], figures["primary"]), []).append(stored_counts(figures))
    lines = []
    for signal in dataset.machine.signals:
        for primary in (True, False):
            if (signal, primary) in found:
                filled = _filled(dataset, signal) if primary else float("nan")
                name = signal if primary else f"{signal} (second)"
                lines.append(SampleLine(name, together(found[signal, primary]), filled))
    return lines


def _filled(dataset: Dataset, signal: str) -> float:
    own = [recording.values(signal) for recording in dataset.recordings if signal in recording.signals]
    rows = sum(map(len, own))
    return sum(int(np.count_nonzero(~np.isnan(values))) for values in own) / rows if rows else float("nan")


#: An offset whose 95 % interval is wider than this is of no use at the usual rate of 100 Hz: half a sample [s].
COARSE_S = 0.005


def clock_summary(clocks: Iterable[tuple[str, bool, float]]) -> str:
    """The sentence.

    Args:
        clocks: recording, whether its offset was applied, and half of the 95 % interval of the offset [s].
    """
    rows = list(clocks)
    fine = sum(applied and half <= COARSE_S for _, applied, half in rows)
    coarse = [name for name, applied, half in rows if applied and half > COARSE_S]
    left = [name for name, applied, _ in rows if not applied]
    parts = [f"{fine} of {len(rows)} clocks are aligned to within {1e3 * COARSE_S:.0f} ms"]
    parts += [f"{', '.join(coarse)}: known less exactly"] if coarse else []
    parts += [f"{', '.join(left)}: not aligned"] if left else []
    return "; ".join(parts) + "."


#: Side of the joint sensor → text.
SIDES = {"drive": "ahead of the sensor", "structure": "behind the sensor"}
_SHARE = re.compile(r"(?P<share>\d+ %|half) of (its|the) range")


@dataclass(frozen=True)
class VerdictGroup:
    """Verdicts with the same effect as one line."""

    title: str
    verdicts: tuple[ExcitationVerdict, ...]

    @property
    def places(self) -> str:
        """``slew, boom ahead of the sensor; boom behind the sensor``."""
        sides: dict[str, dict[str, None]] = {}
        for verdict in self.verdicts:
            sides.setdefault(SIDES.get(verdict.side or "", ""), {})[words.owner_name(verdict.target)] = None
        return "; ".join(f"{', '.join(targets)} {side}".rstrip() for side, targets in sides.items())


def place(verdict: ExcitationVerdict) -> str:
    """The target, with the side of its joint sensor if there are two."""
    return f"{words.owner_name(verdict.target)} {SIDES.get(verdict.side or '', '')}".rstrip()


def by_effect(verdicts: Sequence[ExcitationVerdict], machine: Machine) -> list[VerdictGroup]:
    """One group for each effect and title, in the order of the chain."""
    found: dict[str, list[ExcitationVerdict]] = {}
    for verdict in verdicts:
        found.setdefault(words.effect_title(verdict.name, verdict.target, machine), []).append(verdict)
    return [VerdictGroup(title, tuple(group)) for title, group in found.items()]


def by_reason(verdicts: Sequence[ExcitationVerdict], machine: Machine) -> list[tuple[str, list[VerdictGroup]]]:
    """Reason → effects that are not observable because of it, the reason with most effects first."""
    found: dict[str, list[ExcitationVerdict]] = {}
    for verdict in verdicts:
        found.setdefault(verdict.text, []).append(verdict)
    groups = [(reason, by_effect(group, machine)) for reason, group in found.items()]
    return sorted(groups, key=lambda item: -sum(len(group.verdicts) for group in item[1]))


def amount(verdict: ExcitationVerdict) -> str:
    """``39 of 60``: available of needed."""
    if verdict.have is None or verdict.need is None:
        return display.NOTHING
    return f"{_count(verdict.have, verdict.need)} of {verdict.need:g}"


def spread(group: VerdictGroup) -> str:
    """``35 to 98``: the smallest and the largest count of a group."""
    counts = sorted({v.have for v in group.verdicts if v.have is not None})
    if not counts:
        return display.NOTHING
    need = max(v.need or 0.0 for v in group.verdicts)
    ends = list(dict.fromkeys(_count(value, need) for value in (counts[0], counts[-1])))
    return " to ".join(ends)


def request_text(request: RecordingRequest, machine: Machine) -> str:
    """What to record; shares of a range are followed by their size in degrees or millimetres."""
    axes = [machine.axis(name) for name in dict.fromkeys(target for _, target in request.effects) if name in machine.axis_names]

    def sized(match: re.Match[str]) -> str:
        share = 0.5 if match["share"] == "half" else float(match["share"].split()[0]) / 100.0
        sizes = [(axis.name, size) for axis in axes if (size := _size(axis, share, machine))]
        listed = ", ".join(size if len(sizes) == 1 else f"{name} {size}" for name, size in sizes)
        return f"{match[0]} ({listed})" if sizes else match[0]

    return _SHARE.sub(sized, request.record)


def _size(axis: Axis, share: float, machine: Machine) -> str:
    """A share of the axis's joint range, else of its driven signal; empty if the range is unknown."""
    signal, ends = (axis_signal(axis.name, "joint"), axis.limits) if axis.limits is not None else (axis.driven, axis.range)
    span = ends[1] - ends[0]
    unit = machine.expected_unit(signal)
    return display.quantity(share * span, unit, 2) if 0.0 < span < float("inf") and unit is not None else ""


def _count(have: float, need: float) -> str:
    """A whole number, unless rounding would change the comparison with ``need``."""
    whole = f"{have:.0f}"
    return whole if (float(whole) >= need) == (have >= need) else display.number(have)
